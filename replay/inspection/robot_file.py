"""Proposed robot file: values estimated from a log, and placeholders for the rest."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from icreckon.estimator.log.lag import Lag, NoLag
from icreckon.estimator.robot.robot_toml import toml_value
from icreckon.replay.estimates.fix_wander import FixFit, FixWanderEstimate
from icreckon.replay.estimates.gyro_bias import GyroBias
from icreckon.replay.estimates.imu_mounting import ABSURD, Mounting
from icreckon.replay.estimates.latency import objection
from icreckon.replay.estimates.wheels import CLEAR_SIGN, heading_offset
from icreckon.replay.inspection.log_estimates import LogEstimates
from icreckon.replay.inspection.static_frames import STATIC
from icreckon.replay.mapping.columns import ColumnMap
from icreckon.replay.mapping.naming import PLACEHOLDER_SIGMA
from icreckon.replay.mapping.topics import HeadingTopic, TrackTopic

FIRST_WORDS = "# Proposed by inspecting"
ROUGH_RADIUS = 0.1  # relative standard error from which on a radius is not proposed [-]
USUAL_SCALE_SIGMA, LEAST_SCALE_SIGMA = 0.02, 0.01
"""Standard deviation of an effective radius of which a log shows nothing, and the least that one log
shows, since the ground changes it [-]."""
USUAL_DIFFERENCE_SIGMA = 0.02  # sigma of an unmeasured difference of the radii [-]
USUAL_GYRO_SCALE_SIGMA = 0.005  # scale error of a MEMS gyro without a data sheet [-]
STANDING_BIAS_SIGMA = 0.002  # sigma of a standstill's gyro bias, for other logs [rad/s]
FILL_IN = "# not in the log: fill in"
GAUGE_LINE = f"# gauge = 0.5    {FILL_IN} (m, the controller's own; else track_gauge)"
CHECKED = ("unit", "wrap", "time_unit", "rate_unit", "acceleration_unit", "yaw_unit")
"""Guessed keys."""
MARGIN = 1.2  # highest speed of a robot over the fastest in a log [-]


def robot_file_text(path: Path, estimates: LogEstimates) -> str:
    """Format a robot file for `load_robot` and `topic_map`, named after the bag."""
    latency = _latency_lines(estimates.latencies.get("tracks"))
    wander = _wander_lines(estimates.wander, estimates.states_fix_sigma)
    columns = estimates.mapping.columns
    lines = [
        f"{FIRST_WORDS} {toml_value(path.name)[1:-1]}: check every line.",
        f"name = {toml_value(path.stem)}",
        "format = 1",
        "",
        *_vehicle_lines(estimates),
        "",
        *_imu_lines(estimates),
        *_tracks_lines(estimates),
        *_topic_lines(estimates, latency, wander),
        *(_column_lines(columns, latency, wander, estimates.fix_fit) if columns else []),
    ]
    return "\n".join(lines) + "\n"


def _vehicle_lines(estimates: LogEstimates) -> list[str]:
    """Tables [vehicle] and [indices]; `load_robot` refuses the NaN of the unknown."""
    fastest, log = None, estimates.log
    if log is not None and len(log.tracks.speeds) and not estimates.mapping.lacks_counts_per_turn:
        fastest = float(np.abs(log.tracks.speeds).max())
    gauge = f"track_gauge = nan        {FILL_IN} (m, between the track or wheel centrelines)"
    if (track := estimates.effective_track) is not None:
        gauge = (
            f"track_gauge = {track:.3g}    # m, the effective track ({track:.3g}): fill in the distance "
            "between the centrelines of tracks or wheels"
        )
    mass = f"mass = nan               {FILL_IN} (kg, with load)"
    centre = f"centre_of_mass = [0.0, 0.0, 0.2]    {FILL_IN} (m forward, left, 0.3 gauges up)"
    lines = ["[vehicle]", mass, gauge, _radius_line(estimates), centre]
    # Metres per unit of the log's track speeds, which were read with a radius of 1 m.
    radius = estimates.sizes.radius or estimates.wheels.distance_ratio
    scale = radius if estimates.mapping.in_rates else 1.0
    if fastest and scale is not None and fastest < ABSURD:
        remark = f"m/s; the fastest in the log is {fastest * scale:.2f}"
        lines.append(f"max_track_speed = {MARGIN * fastest * scale:.2g}    # {remark}")
    else:
        lines.append(f"max_track_speed = 2.0    {FILL_IN} (m/s)")
        if fastest:
            lines.append(f"# Fastest in the log: {fastest:.1f} rad/s, times sprocket_radius.")
    if estimates.mapping.track_keys is None:
        lines.append("# Nothing in the log looks like track speeds: no track speeds, no replay.")
    return lines + _index_lines(estimates)


def _radius_line(estimates: LogEstimates) -> str:
    """Line of the key sprocket_radius: the effective radius, for tracks in rates."""
    if estimates.mapping.track_keys is not None and not estimates.mapping.in_rates:
        return "sprocket_radius = 0.1    # not used for this log"
    wheels = estimates.wheels
    if wheels.distance_ratio is None:
        return f"sprocket_radius = nan    {FILL_IN} (m, effective)"
    radius, sigma = wheels.distance_ratio, wheels.distance_sigma
    error = "" if sigma is None else f" ± {sigma:.2g}"
    by_source = "by the fixes"
    if wheels.distance_source == "truth":
        by_source = "by the truth where it hardly turned"
    if sigma is not None and sigma > ROUGH_RADIUS * radius:
        return f"sprocket_radius = nan    {FILL_IN} (m, effective; {radius:.2g}{error} {by_source})"
    return f"sprocket_radius = {radius:.4g}    # m{error}, effective, {by_source}"


def _index_lines(estimates: LogEstimates) -> list[str]:
    """Table [indices]: steering efficiency eta0 of constant ICRs, by the gyro."""
    ratio, track = estimates.wheels.track_ratio, estimates.effective_track
    if ratio is None and not estimates.mapping.lacks_counts_per_turn:
        return []
    if track is not None:
        eta0 = max(1.0, track / (estimates.sizes.gauge or track))
        remark = f"effective track by the gyro, {track:.3g} m, over track_gauge"
        line = f"eta0 = {eta0:.3g}    # {remark}"
    elif ratio is not None and estimates.mapping.from_twist:
        line = (
            f"eta0 = {max(1.0, ratio):.2f}    # effective track by the gyro: {ratio:.2f} times the "
            "controller's gauge ([log.tracks]), over track_gauge"
        )
    else:
        formula = f"{ratio:.3g} sprocket_radius / track_gauge, by the gyro; " if ratio else ""
        advice = "or fill in the rest, and inspect again with --overwrite"
        line = f"eta0 = nan    {FILL_IN} ({formula}{advice})"
    return ["", "[indices]", line]


def _imu_lines(estimates: LogEstimates) -> list[str]:
    """Table [imu]: mounting, gyro bias and noise densities."""
    mounting, log = estimates.mounting, estimates.log
    if log is None or log.imu is None:
        advice = "name its topic in [log.imu], its columns in [log.columns.imu]"
        return [f"# No IMU found: {advice}.", ""]
    if mounting is None:
        return ["# The IMU's readings are absurd, and show nothing.", ""]
    has_tracks = len(log.tracks.stamps) > 0
    angles = ", ".join(str(_to_tenth(angle)) for angle in mounting.rotation_rpy_deg)
    lines = [*_mounting_comments(mounting), "[imu]", f"rotation_rpy_deg = [{angles}]"]
    if (mount := estimates.imu_mount) is not None:
        lines.append(f"position = {_metres(mount.position)}    # m, {mount.source}")
    elif mounting.up_shown_by == "gravity":
        lines.append(
            f"position = [0.0, 0.0, 0.0]    {FILL_IN} (m forward, left, up); "
            "leave 0 if not measured: a wrong value shifts zeta0"
        )
    if mounting.gyro_axes == "z":
        lines.append('gyro_axes = "z"    # the x and y gyros read zero all the time')
    if mounting.gyro_bias is not None:
        x, y, z = mounting.gyro_bias
        lines.append(
            f"# Gyro bias at standstill ({mounting.still_seconds:.0f} s): "
            f"({x:.5f}, {y:.5f}, {z:.5f}) rad/s in the IMU's axes."
        )
    lines += _bias_lines(estimates.bias, has_tracks=has_tracks)
    if mounting.gyro_noise_density:
        remark = "rad/s/√Hz, at standstill; vibration while driving adds to it"
        lines.append(f"gyro_noise_density = {mounting.gyro_noise_density:.2g}    # {remark}")
    remark = "usual scale error of a MEMS gyro; replace it with the data sheet's"
    lines.append(f"gyro_scale_sigma = {USUAL_GYRO_SCALE_SIGMA}    # {remark}")
    if mounting.accelerometer_noise_density:
        remark = "fast vibration; slow disturbances add to it"
        if has_tracks:
            remark = "residual after subtracting track acceleration (0.5 s mean)"
        noise = f"{mounting.accelerometer_noise_density:.2g}    # m/s²/√Hz, {remark}"
        lines.append(f"accelerometer_noise_density = {noise}")
    return [*lines, ""]


def _bias_lines(bias: GyroBias | None, *, has_tracks: bool) -> list[str]:
    """Keys gyro_bias and gyro_bias_sigma, or a comment why there are none."""
    if bias is None or not (bias.source == "standstill" or bias.differs(0.0)):
        if not has_tracks:
            return ["# Gyro bias: no track speeds to find a standstill by."]
        return ["# Gyro bias: no standstill of three seconds, and driving cannot show it."]
    error = "" if bias.source == "standstill" else f" ± {bias.sigma:.2g}, by the {bias.source}"
    sigma = float(np.hypot(STANDING_BIAS_SIGMA, bias.sigma))
    lines = [
        f"gyro_bias = {bias.value:.5f}    # rad/s{error} about the vertical, of this log",
        f"gyro_bias_sigma = {sigma:.2g}    # rad/s; a later log's may differ",
    ]
    if bias.walk:
        remark = "rad/s/√s; the bias changes from standstill to standstill, as with the temperature"
        lines.append(f"gyro_bias_walk = {bias.walk:.2g}    # {remark}")
    return lines


def _mounting_comments(mounting: Mounting) -> list[str]:
    """Comments on the evidence of an IMU's mounting: gravity, turning, accelerations."""
    by_gravity = mounting.up_shown_by == "gravity"
    lines = ["# The IMU has no accelerometer."]
    if mounting.specific_force is not None:
        x, y, z = mounting.specific_force
        end = "; roll and pitch turn it upright." if by_gravity else "."
        lines = [f"# Mean specific force ({x:.2f}, {y:.2f}, {z:.2f}) m/s²{end}"]
    if by_gravity:
        yaw = {
            "": f" {FILL_IN.removeprefix('# ')}; 0 is right if the IMU's x axis points forward.",
            "tracks": ": accelerations follow the track speeds with it.",
            STATIC: f": by /{STATIC}.",
        }[mounting.yaw_shown_by]
        lines.append(f"# Yaw{yaw}")
    elif mounting.up_shown_by == "turning":
        lines.append(
            "# Roll and pitch turn that axis up about which the gyro turns as the tracks do (correlation "
            f"{mounting.turning_correlation:.2f}), if left and right are not swapped."
        )
        return lines
    else:
        unknown = "# Nothing shows how it is mounted: this is for its z axis upward."
        lines.append(f"# Mounting by /{STATIC}." if mounting.yaw_shown_by else unknown)
    return [*lines, _turning_comment(mounting.turning_correlation)]


def _tracks_lines(estimates: LogEstimates) -> list[str]:
    """Table [tracks]: uncertainty of the effective radius, or of the speeds."""
    if estimates.mapping.track_keys is None:
        return []
    in_rates, wheels = estimates.mapping.in_rates, estimates.wheels
    ratio, ratio_sigma = wheels.distance_ratio, wheels.distance_sigma
    sigma, remark = USUAL_SCALE_SIGMA, "what is usually not known of an effective radius"
    if ratio is not None and ratio_sigma is not None and not estimates.sizes.radius:
        measured, subject = ratio_sigma / ratio, "the effective radius above"
        if not in_rates:
            # Speeds are not corrected, so that their whole error counts.
            measured, subject = float(np.hypot(ratio - 1.0, ratio_sigma)), "the speeds"
        if measured < (ROUGH_RADIUS if in_rates else sigma):
            sigma = max(measured, LEAST_SCALE_SIGMA)
            remark = f"of {subject}, by the {wheels.distance_source}"
            if in_rates and measured < USUAL_SCALE_SIGMA:
                remark += f"; {USUAL_SCALE_SIGMA:g} for another"
    return [
        "[tracks]",
        f"scale_sigma = {sigma:.2g}    # relative, {remark}",
        f"difference_sigma = {USUAL_DIFFERENCE_SIGMA:g}    # of the right radius less the left, relative",
        "",
    ]


def _turning_comment(correlation: float | None) -> str:
    """Comment on the sign of turning, by the correlation of tracks and gyro."""
    if correlation is None:
        return "# Nothing turns, or always alike: the sign of turning cannot be checked."
    text = f"# Track speeds and the rate about the vertical have a correlation of {correlation:.2f}"
    if correlation > CLEAR_SIGN:
        return f"{text}: the sign of turning is right."
    if correlation < -CLEAR_SIGN:
        return f"{text}: TURNS THE WRONG WAY, left and right may be swapped."
    return f"{text}: too little to check the sign of turning."


def _latency_lines(latency: Lag | NoLag | None) -> list[str]:
    """Key latency of the track speeds, or a comment why it is not written."""
    if not isinstance(latency, Lag):
        return []
    reason = objection(latency)
    if reason:
        size = f"{latency.seconds:.3f} ± {latency.sigma:.1g} s"
        return [f"# Latency against the gyro: {size}, {reason}: not written."]
    lags = "lags" if latency.seconds > 0.0 else "leads"
    return [f"latency = {latency.seconds:.2f}    # s, ± {latency.sigma:.1g}: {lags} the gyro"]


def _topic_lines(estimates: LogEstimates, latency: list[str], wander: list[str]) -> list[str]:
    """Tables [log.tracks], [log.imu], ...: topics, clocks, latency and errors."""
    mapping, tables, lines = estimates.mapping, dict[str, list[str]](), list[str]()
    if mapping.tracks:
        tables["tracks"] = _track_keys(mapping.tracks)
    if mapping.imu:
        rate, force = mapping.imu.rate_unit, mapping.imu.acceleration_unit
        names = ("acceleration_topic", "angular_velocity", "linear_acceleration")
        tables["imu"] = _named(mapping.imu, names)
        tables["imu"] += [f"rate_unit = {toml_value(rate)}"] if rate != "rad/s" else []
        tables["imu"] += [f"acceleration_unit = {toml_value(force)}"] if force != "m/s2" else []
    if mapping.fixes:
        hint = "# Where they are a truth, as of a lidar map: [log.truth], with the topic alone."
        sigma = mapping.fixes.position_sigma
        errors = [f"position_sigma = {sigma}    {FILL_IN} (m)"]
        if sigma is None or wander:
            errors = wander
        fields = _named(mapping.fixes, ("latitude", "longitude", "altitude", "sigma"))
        tables["fixes"] = [hint, *fields, *errors]
        if any(mapping.fixes.position):
            place = _metres(mapping.fixes.position)
            tables["fixes"].append(f"position = {place}    # m, of the antenna, by /{STATIC}")
        tables["fixes"] += _fit_lines(estimates.fix_fit, mapping.fixes.position)
    if mapping.heading:
        tables["heading"] = _heading_keys(mapping.heading, estimates)
        tables["heading"] += _latency_lines(estimates.latencies.get("heading"))
    if mapping.truth:
        tables["truth"] = _named(mapping.truth, ("twist", "tracks", "source_topic"))
    for purpose, keys in tables.items():
        topic = getattr(mapping, purpose).topic
        lines += ["", f"[log.{purpose}]", f"topic = {toml_value(topic)}", *keys]
        choice = estimates.clocks.get(purpose)
        if choice is not None and choice.clock == "recording":
            lines.append(f'time = "recording"    # {choice.reason}')
        lines += latency if purpose == "tracks" else []
    return lines[1:]


def _named(topic: Any, keys: Sequence[str]) -> list[str]:
    """Keys of a topic that name other topics, or fields of its messages."""
    return [f"{key} = {toml_value(value)}" for key in keys if (value := getattr(topic, key))]


def _fit_lines(fit: FixFit | None, known: tuple[float, ...]) -> list[str]:
    """Keys of the fixes: their lag, and the place of the antenna if it is not known."""
    lines = []
    if fit is not None and fit.differs(np.zeros(2)) and not any(known):
        place = _metres(fit.place.round(2))
        lines.append(f"position = {place}    # m, ± {fit.sigma:.1g}: antenna, by bends")
    if fit is not None and fit.is_late:
        side = "behind" if fit.lag > 0.0 else "ahead of"
        lines.append(f"latency = {fit.lag:.2f}    # s, ± {fit.lag_sigma:.1g}, {side} the tracks")
    return lines


def _heading_keys(heading: HeadingTopic, estimates: LogEstimates) -> list[str]:
    """Keys of [log.heading] but its topic."""
    log, fit = estimates.log, estimates.fix_fit
    keys = [] if heading.sigma is None else [f"sigma = {heading.sigma}    {FILL_IN} (rad)"]
    antenna = fit.place if fit is not None and fit.differs(np.zeros(2)) else None
    offset = None if log is None else heading_offset(log, antenna)
    if offset is None:
        return [*keys, f"offset_deg = nan    {FILL_IN} (to the direction of driving)"]
    remark = f"± {offset.sigma:.1g}: direction of driving less heading"
    return [*keys, f"offset_deg = {_to_tenth(offset.value)}    # {remark}"]


def _track_keys(tracks: TrackTopic) -> list[str]:
    """Keys of [log.tracks] but its topic."""
    keys = _named(tracks, ("right_topic", "left", "right", "speed", "yaw_rate"))
    if not tracks.left:
        keys.append(GAUGE_LINE)
    if tracks.left and (tracks.right_topic or tracks.unit != "rad/s"):
        keys.append(f"unit = {toml_value(tracks.unit)}    # check it")
    if tracks.counts_per_turn:
        keys.append(f"counts_per_turn = nan    {FILL_IN} (of the wheel)")
        keys += [f"wrap = {tracks.wrap}"] if tracks.wrap else []
    return keys


def _wander_lines(wander: FixWanderEstimate | str | None, states_sigma: bool) -> list[str]:
    """Keys of the error of the fixes: its white part, and that which wanders."""
    if not isinstance(wander, FixWanderEstimate):
        return []
    if wander.reason:
        # A part that seems slow is odometry's: little is known of a smaller white one.
        if states_sigma or (wander.sigma and wander.white < PLACEHOLDER_SIGMA):
            return []
        return [f"position_sigma = {wander.white:.2g}    # m, white noise, against odometry"]
    shortest, longest = wander.times
    white = f"position_sigma = {wander.white:.2g}    # m, what is new in each fix, against odometry"
    return [
        # Where odometry does not tell the parts apart, what the fixes state stays.
        *([white] if wander.stated is None else []),
        f"wander_sigma = {wander.sigma:.2g}    # m, the part that changes slowly",
        f"wander_time = {wander.time:g}    # s; {shortest:g} to {longest:g} s fit as well",
    ]


def _column_lines(
    columns: ColumnMap, track_latency: list[str], wander: list[str], fit: FixFit | None
) -> list[str]:
    """Tables [log.columns], [log.columns.tracks], ...; empty keys are left out."""
    lines = ["[log.columns]", f"time = {toml_value(columns.time)}"]
    lines.append(f"time_unit = {toml_value(columns.time_unit)}    # check it")
    for purpose in ("tracks", "imu", "fixes", "truth"):
        stream = getattr(columns, purpose)
        if stream is None:
            continue
        lines += ["", f"[log.columns.{purpose}]"]
        # Keys that the lines on latency and wander hold, or that nobody can guess.
        omitted = {"latency", "scale", "wander_sigma", "wander_time"}
        omitted |= {"position_sigma"} if wander else set()
        omitted |= {"unit"} if getattr(stream, "speed", None) else set()
        omitted |= set() if getattr(stream, "yaw", "") else {"yaw_unit"}
        for name in stream.__struct_fields__:
            value = getattr(stream, name)
            if name in omitted or value in (None, (), "", 0.0, (0.0, 0.0, 0.0)):
                continue
            text = "nan" if name == "counts_per_turn" else toml_value(value)
            text = repr(value) if name.startswith("clock_") else text  # all of its digits
            remark = f"    {FILL_IN}" if name in ("position_sigma", "counts_per_turn") else ""
            lines.append(f"{name} = {text}{'    # check it' if name in CHECKED else remark}")
        if purpose == "tracks":
            lines += [*([GAUGE_LINE] if stream.speed else []), *track_latency]
        lines += [*wander, *_fit_lines(fit, stream.position)] if purpose == "fixes" else []
    return lines


def _metres(position: Iterable[float]) -> str:
    """Position to the millimetre, as a list of TOML."""
    return f"[{', '.join(str(round(float(length), 3) + 0.0) for length in position)}]"


def _to_tenth(degrees: float) -> float:
    """Angle to the tenth; the sum turns -0.0 into 0.0."""
    return round(degrees, 1) + 0.0
