"""Proposed robot file: values estimated from a log, and placeholders for the rest."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.lag import Lag, NoLag
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_toml import toml_value
from icreckon.replay.inspection.fix_wander import FixWanderEstimate
from icreckon.replay.inspection.gyro_bias import GyroBias
from icreckon.replay.inspection.imu_mounting import ABSURD, Mounting
from icreckon.replay.inspection.latency import objection
from icreckon.replay.inspection.wheels import NO_WHEELS, WheelEstimates, heading_offset
from icreckon.replay.mapping.columns import ColumnMap
from icreckon.replay.mapping.topics import TopicMap
from icreckon.replay.reading.clocks import Choice

FIRST_WORDS = "# Proposed by inspecting"
USUAL_SCALE_SIGMA, LEAST_SCALE_SIGMA = 0.02, 0.01
"""Standard deviation of an effective radius of which a log shows nothing, and the least that one log
shows, since the ground changes it [-]."""
USUAL_DIFFERENCE_SIGMA = 0.02
"""Standard deviation of the difference of the radii of a robot that nobody has measured [-]."""
STANDING_BIAS_SIGMA = 0.002
"""Standard deviation of a gyro bias that a standstill has shown, for other logs [rad/s]."""
FILL_IN = "# not in the log: fill in"
CHECKED = ("unit", "wrap", "rate_unit", "acceleration_unit", "yaw_unit")
"""Keys that are guessed from names and sizes."""
CLEAR_SIGN = 0.3
"""Correlation of the tracks' turning with the gyro from which its sign is shown [-]."""
MARGIN = 1.2
"""Highest speed of a robot over the fastest in a log [-]."""


class Sizes(NamedTuple):
    """Lengths [m] and streams of a robot that a person filled in; None if unknown."""

    gauge: float | None = None  # track gauge
    radius: float | None = None  # sprocket radius
    # gauge of the controller whose odometry gives the track speeds
    of_controller: float | None = None
    log: Mapping[str, Mapping[str, Any]] = {}  # keys of its [log] tables, by table


NO_SIZES = Sizes()


@dataclass(frozen=True)
class LogEstimates:
    """Estimates from a log, for findings and a robot file; None if not observable."""

    mapping: TopicMap  # the guessed topics
    clocks: Mapping[str, Choice]  # clock of each stream and the reason of its choice, by purpose
    # the log read by that mapping with a sprocket radius of 1 m; None if it cannot be read
    log: Log | None
    sizes: Sizes  # lengths of the robot that a person filled in
    mounting: Mounting | None = None  # estimated mounting of the IMU
    vertical: Floats | None = None  # (n,) rate about the vertical at the IMU's stamps [rad/s]
    wheels: WheelEstimates = NO_WHEELS  # estimated effective radius and track
    # latencies of tracks and truth against the gyro, by purpose
    latencies: Mapping[str, Lag | NoLag] = field(default_factory=dict)
    bias: GyroBias | None = None  # bias of the gyro
    # error of the fixes, or the reason why it is not observable
    wander: FixWanderEstimate | str | None = None

    @property
    def from_twist(self) -> bool:
        """True for track speeds from a twist, which are read with a gauge of 1 m."""
        return self.mapping.tracks is not None and not self.mapping.tracks.left

    @property
    def effective_track(self) -> float | None:
        """Effective track by the gyro [m]; None without radius or gauge of a controller."""
        scale: float | None = 1.0
        if self.from_twist:
            scale = self.sizes.of_controller
        elif self.mapping.in_rates:
            scale = self.sizes.radius or self.wheels.way_ratio
        if self.wheels.track_ratio is None or scale is None:
            return None
        return self.wheels.track_ratio * scale


def robot_file_text(path: Path, seen: LogEstimates) -> str:
    """Format a robot file for `load_robot` and `topic_map`, named after the bag."""
    late, wandering = _latency_lines(seen.latencies.get("tracks")), _wander_lines(seen.wander)
    columns = seen.mapping.columns
    lines = [
        f"{FIRST_WORDS} {toml_value(path.name)[1:-1]}: check every line.",
        f"name = {toml_value(path.stem)}",
        "format = 1",
        "",
        *_vehicle(seen),
        "",
        *_imu(seen),
        *_tracks(seen),
        *_log(seen, late, wandering),
        *(columns_text(columns, late, wandering) if columns else []),
    ]
    return "\n".join(lines) + "\n"


def _vehicle(seen: LogEstimates) -> list[str]:
    fastest, log = None, seen.log
    if log is not None and len(log.tracks.speeds) and not seen.mapping.lacks_counts_per_turn:
        fastest = float(np.abs(log.tracks.speeds).max())
    # Not a number, so that an incomplete robot file is refused.
    lines = [
        "[vehicle]",
        f"mass = nan               {FILL_IN} (kg, with load)",
        _gauge(seen.effective_track),
        _radius(seen),
    ]
    size = (seen.sizes.radius or seen.wheels.way_ratio) if seen.mapping.in_rates else 1.0
    if fastest and size is not None and fastest < ABSURD:
        top = MARGIN * fastest * size
        lines.append(
            f"max_track_speed = {top:.2g}    # m/s; the fastest in the log is {fastest * size:.2f}"
        )
    else:
        lines.append(f"max_track_speed = 2.0    {FILL_IN} (m/s)")
        if fastest:
            lines.append(f"# Fastest in the log: {fastest:.1f} rad/s, times sprocket_radius.")
    if seen.mapping.track_keys is None:
        lines.append("# Nothing in the log looks like track speeds: no track speeds, no replay.")
    return lines + _indices(seen)


def _radius(seen: LogEstimates) -> str:
    if seen.mapping.track_keys is not None and not seen.mapping.in_rates:
        return "sprocket_radius = 0.1    # not used for this log"
    radius, sigma = seen.wheels.way_ratio, seen.wheels.way_sigma
    if radius is None:
        return f"sprocket_radius = nan    {FILL_IN} (m, effective)"
    error = "" if sigma is None else f" ± {sigma:.2g}"
    return (
        f"sprocket_radius = {radius:.4g}    # m{error}, effective, by the {seen.wheels.way_source} "
        "where it hardly turned"
    )


def _gauge(track: float | None) -> str:
    if track is None:
        return f"track_gauge = nan        {FILL_IN} (m, between the track or wheel centrelines)"
    return (
        f"track_gauge = {track:.3g}    # m, the effective track ({track:.3g}): fill in the distance "
        "between the centrelines of tracks or wheels"
    )


def _indices(seen: LogEstimates) -> list[str]:
    """Steering efficiency of constant ICRs by the gyro."""
    ratio, track = seen.wheels.track_ratio, seen.effective_track
    if ratio is None and not seen.mapping.lacks_counts_per_turn:
        return []
    if track is not None:
        eta0 = max(1.0, track / (seen.sizes.gauge or track))
        line = (
            f"eta0 = {eta0:.3g}    # effective track by the gyro, {track:.3g} m, over track_gauge"
        )
    elif ratio is not None and seen.from_twist:
        line = (
            f"eta0 = {max(1.0, ratio):.2f}    # effective track by the gyro: {ratio:.2f} times the "
            "controller's gauge ([log.tracks]), over track_gauge"
        )
    else:
        shown = f"{ratio:.3g} sprocket_radius / track_gauge, by the gyro; " if ratio else ""
        line = f"eta0 = nan    {FILL_IN} ({shown}or fill in the rest, and inspect again with --overwrite)"
    return ["", "[indices]", line]


def _imu(seen: LogEstimates) -> list[str]:
    mounting, log, found = seen.mounting, seen.log, seen.bias
    if mounting is None:
        if log is None or log.imu is None:
            return [
                "# No IMU found: name its topic in [log.imu], its columns in [log.columns.imu].",
                "",
            ]
        return ["# The IMU's readings are absurd, and show nothing.", ""]
    driven = log is not None and len(log.tracks.stamps)
    lines = [*_mounting(mounting), "[imu]"]
    roll, pitch, yaw = mounting.rotation_rpy_deg
    lines.append(f"rotation_rpy_deg = [{_round(roll)}, {_round(pitch)}, {_round(yaw)}]")
    if mounting.up_shown_by == "gravity":
        lines.append(
            f"position = [0.0, 0.0, 0.0]    {FILL_IN} (m forward, left, up); "
            "leave 0 if not measured: a wrong value shifts zeta0"
        )
    if mounting.gyro_axes == "z":
        lines.append('gyro_axes = "z"    # the x and y gyros read zero all the time')
    if mounting.gyro_bias is not None:
        bias = mounting.gyro_bias
        lines.append(
            f"# Gyro bias at standstill ({mounting.still_seconds:.0f} s): "
            f"({bias[0]:.5f}, {bias[1]:.5f}, {bias[2]:.5f}) rad/s in the IMU's axes."
        )
    if found is not None and (found.source == "standstill" or found.differs(0.0)):
        error = (
            "" if found.source == "standstill" else f" ± {found.sigma:.2g}, by the {found.source}"
        )
        sigma = float(np.hypot(STANDING_BIAS_SIGMA, found.sigma))
        lines += [
            f"gyro_bias = {found.value:.5f}    # rad/s{error} about the vertical, of this log",
            f"gyro_bias_sigma = {sigma:.2g}    # rad/s; a later log's may differ",
        ]
    else:
        none = "no standstill of three seconds, and driving cannot show it"
        lines.append(
            f"# Gyro bias: {none if driven else 'no track speeds to find a standstill by'}."
        )
    if mounting.gyro_noise_density:
        lines.append(
            f"gyro_noise_density = {mounting.gyro_noise_density:.2g}"
            "    # rad/s/√Hz, at standstill; vibration while driving adds to it"
        )
    if mounting.accelerometer_noise_density:
        seen_by = (
            "while driving, over 0.5 s, what the tracks do not explain"
            if driven
            else "fast vibration; slow disturbances add to it"
        )
        lines.append(
            f"accelerometer_noise_density = {mounting.accelerometer_noise_density:.2g}"
            f"    # m/s²/√Hz, {seen_by}"
        )
    return [*lines, ""]


def _mounting(mounting: Mounting) -> list[str]:
    """Comments on what shows the mounting of an IMU."""
    by_gravity, lines = mounting.up_shown_by == "gravity", ["# The IMU has no accelerometer."]
    if mounting.specific_force is not None:
        x, y, z = mounting.specific_force
        end = "; roll and pitch turn it upright." if by_gravity else "."
        lines = [f"# Mean specific force ({x:.2f}, {y:.2f}, {z:.2f}) m/s²{end}"]
    if by_gravity:
        lines.append(
            "# Yaw: accelerations follow the track speeds with it."
            if mounting.yaw_shown
            else f"# Yaw {FILL_IN.removeprefix('# ')}; 0 is right if the IMU's x axis points forward."
        )
    elif mounting.up_shown_by == "turning":
        lines.append(
            "# Roll and pitch turn that axis up about which the gyro turns as the tracks do (correlation "
            f"{mounting.turning_correlation:.2f}), if left and right are not swapped."
        )
        return lines
    else:
        lines.append("# Nothing shows how it is mounted: this is for its z axis upward.")
    return [*lines, _turning_comment(mounting.turning_correlation)]


def _tracks(seen: LogEstimates) -> list[str]:
    """Uncertainty of the effective radius, or of speeds that need none."""
    if seen.mapping.track_keys is None:
        return []
    estimates, rates = seen.wheels, seen.mapping.in_rates
    sigma, remark = USUAL_SCALE_SIGMA, "what is usually not known of an effective radius"
    if (
        estimates.way_ratio is not None
        and estimates.way_sigma is not None
        and not seen.sizes.radius
    ):
        if rates:
            shown, of = estimates.way_sigma / estimates.way_ratio, "the effective radius above"
        else:
            shown = float(np.hypot(estimates.way_ratio - 1.0, estimates.way_sigma))
            of = "the speeds"
        if shown < sigma:
            sigma = max(shown, LEAST_SCALE_SIGMA)
            remark = f"of {of}, by the {estimates.way_source}"
            remark += f"; {USUAL_SCALE_SIGMA:g} for another" if rates else ""
    return [
        "[tracks]",
        f"scale_sigma = {sigma:.2g}    # relative, {remark}",
        f"difference_sigma = {USUAL_DIFFERENCE_SIGMA:g}    # of the right radius less the left, relative",
        "",
    ]


def _turning_comment(correlation: float | None) -> str:
    if correlation is None:
        return "# No track speeds to check the sign of turning with."
    text = f"# Track speeds and the rate about the vertical have a correlation of {correlation:.2f}"
    if correlation > CLEAR_SIGN:
        return f"{text}: the sign of turning is right."
    if correlation < -CLEAR_SIGN:
        return f"{text}: TURNS THE WRONG WAY, left and right may be swapped."
    return f"{text}: too little to check the sign of turning."


def _latency_lines(latency: Lag | NoLag | None) -> list[str]:
    if not isinstance(latency, Lag):
        return []
    if why := objection(latency):
        return [
            f"# Latency against the gyro: {latency.seconds:.3f} ± {latency.sigma:.1g} s, {why}: not "
            "written."
        ]
    lags = "lags" if latency.seconds > 0.0 else "leads"
    return [f"latency = {latency.seconds:.2f}    # s, ± {latency.sigma:.1g}: {lags} the gyro"]


def _log(seen: LogEstimates, track_latency: list[str], wander: list[str]) -> list[str]:
    mapping = seen.mapping

    def table(purpose: str, topic: str, *lines: str, late: Sequence[str] = ()) -> list[str]:
        choice = seen.clocks.get(purpose)
        time = []
        if choice is not None and choice.clock == "recording":
            time = [f'time = "recording"    # {choice.reason}']
        return ["", f"[log.{purpose}]", f"topic = {toml_value(topic)}", *lines, *time, *late]

    lines: list[str] = []
    if tracks := mapping.tracks:
        sides = [f"{side} = {toml_value(getattr(tracks, side))}" for side in ("left", "right")]
        if not tracks.left:
            sides = [f"# gauge = 0.5    {FILL_IN} (m, the controller's own; else track_gauge)"]
        if tracks.right_topic:
            sides.insert(0, f"right_topic = {toml_value(tracks.right_topic)}")
        if tracks.right_topic or tracks.unit != "rad/s":
            sides.append(f"unit = {toml_value(tracks.unit)}    # check it")
        if tracks.counts_per_turn:
            sides.append(f"counts_per_turn = nan    {FILL_IN} (of the wheel)")
            sides += [f"wrap = {tracks.wrap}"] if tracks.wrap else []
        lines += table("tracks", tracks.topic, *sides, late=track_latency)
    if imu := mapping.imu:
        units = ("rate_unit", "rad/s"), ("acceleration_unit", "m/s2")
        own = [f'{key} = "{unit}"' for key, usual in units if (unit := getattr(imu, key)) != usual]
        lines += table("imu", imu.topic, *own)
    if fixes := mapping.fixes:
        errors = wander
        if fixes.position_sigma is not None and not wander:
            errors = [f"position_sigma = {fixes.position_sigma}    {FILL_IN} (m)"]
        hint = "# Where they are a truth, as of a lidar map: [log.truth], with the topic alone."
        lines += table("fixes", fixes.topic, hint, *errors)
    if heading := mapping.heading:
        sigma = [] if heading.sigma is None else [f"sigma = {heading.sigma}    {FILL_IN} (rad)"]
        offset = f"offset_deg = 0.0    {FILL_IN} (to the direction of driving)"
        if seen.log is not None and (degrees := heading_offset(seen.log)) is not None:
            offset = (
                f"offset_deg = {_round(degrees)}    # course over ground less heading, if it "
                "drives forward"
            )
        lines += table("heading", heading.topic, *sigma, offset)
    if truth := mapping.truth:
        others = {name: getattr(truth, name) for name in ("twist", "tracks", "source_topic")}
        named = [f"{name} = {toml_value(topic)}" for name, topic in others.items() if topic]
        lines += table("truth", truth.topic, *named)
    return lines[1:]


def _wander_lines(wander: FixWanderEstimate | str | None) -> list[str]:
    """Error of the fixes: its white part, and that which wanders."""
    if not isinstance(wander, FixWanderEstimate) or wander.reason:
        return []
    shortest, longest = wander.times
    white = f"position_sigma = {wander.white:.2g}    # m, what is new in each fix, against odometry"
    return [
        # Where odometry does not tell the parts apart, what the fixes state stays.
        *([white] if wander.stated is None else []),
        f"wander_sigma = {wander.sigma:.2g}    # m, the part that changes slowly",
        f"wander_time = {wander.time:g}    # s; {shortest:g} to {longest:g} s fit as well",
    ]


def columns_text(
    columns: ColumnMap, track_latency: Sequence[str] = (), wander: Sequence[str] = ()
) -> list[str]:
    """Format a column map, with lines on the tracks' latency and the fixes' error."""
    lines = ["[log.columns]", f"time = {toml_value(columns.time)}"]
    lines.append(f"time_unit = {toml_value(columns.time_unit)}    # check it")
    for purpose in ("tracks", "imu", "fixes", "truth"):
        spec = getattr(columns, purpose)
        if spec is None:
            continue
        lines += ["", f"[log.columns.{purpose}]"]
        own = {"latency", "scale", "wander_sigma", "wander_time"}
        own |= {"position_sigma"} if wander else set()
        for name in spec.__struct_fields__:
            value = getattr(spec, name)
            if value in (None, (), "", (0.0, 0.0)) or name in own:
                continue
            if name == "yaw_unit" and not spec.yaw:
                continue
            text = "nan" if name == "counts_per_turn" else toml_value(value)
            filled = f"    {FILL_IN}" if name in ("position_sigma", "counts_per_turn") else ""
            lines.append(f"{name} = {text}{'    # check it' if name in CHECKED else filled}")
        lines += track_latency if purpose == "tracks" else []
        lines += wander if purpose == "fixes" else []
    return lines


def _round(degrees: float) -> float:
    return round(degrees, 1) + 0.0
