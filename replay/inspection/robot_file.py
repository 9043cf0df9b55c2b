"""Proposed robot file: values estimated from a log, and placeholders for the rest."""

from collections.abc import Iterable, Mapping, Sequence
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
from icreckon.replay.mapping.naming import PLACEHOLDER_SIGMA
from icreckon.replay.mapping.topics import HeadingTopic

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
# Keys that are guessed, for a person to check.
CHECKED = ("unit", "wrap", "time_unit", "rate_unit", "acceleration_unit", "yaw_unit")
MARGIN = 1.2  # highest speed of a robot over the fastest in a log [-]


def robot_file_text(path: Path, estimates: LogEstimates) -> str:
    """Format a robot file for `load_robot` and `topic_map`, named after the bag."""
    lines = [
        f"{FIRST_WORDS} {toml_value(path.name)[1:-1]}: check every line.",
        f"name = {toml_value(path.stem)}",
        "format = 1",
        "",
        *_vehicle_lines(estimates),
        *_index_lines(estimates),
        "",
        *_imu_lines(estimates),
        *_tracks_lines(estimates),
        *_topic_lines(estimates),
        *_column_lines(estimates),
    ]
    return "\n".join(lines) + "\n"


def _vehicle_lines(estimates: LogEstimates) -> list[str]:
    """Table [vehicle]; `load_robot` refuses the NaN of the unknown."""
    mapping, log = estimates.mapping, estimates.log
    gauge = f"track_gauge = nan        {FILL_IN} (m, between the track or wheel centrelines)"
    if (track := estimates.effective_track) is not None:
        gauge = (
            f"track_gauge = {track:.3g}    # m, the effective track ({track:.3g}): fill in the distance "
            "between the centrelines of tracks or wheels"
        )
    lines = [
        "[vehicle]",
        f"mass = nan               {FILL_IN} (kg, with load)",
        gauge,
        _radius_line(estimates),
        f"centre_of_mass = [0.0, 0.0, 0.2]    {FILL_IN} (m forward, left, 0.3 gauges up)",
    ]
    fastest = 0.0  # in the log, which was read with a radius of 1 m
    if log is not None and len(log.tracks.speeds) and not mapping.lacks_counts_per_turn:
        fastest = float(np.abs(log.tracks.speeds).max())
    scale = estimates.radius if mapping.in_rates else 1.0
    if fastest and scale is not None and fastest < ABSURD:
        remark = f"m/s; the fastest in the log is {fastest * scale:.2f}"
        lines.append(f"max_track_speed = {MARGIN * fastest * scale:.2g}    # {remark}")
    else:
        lines.append(f"max_track_speed = 2.0    {FILL_IN} (m/s)")
        if fastest:
            lines.append(f"# Fastest in the log: {fastest:.1f} rad/s, times sprocket_radius.")
    if mapping.track_keys is None:
        lines.append("# Nothing in the log looks like track speeds: no track speeds, no replay.")
    return lines


def _radius_line(estimates: LogEstimates) -> str:
    """Line of the key sprocket_radius: the effective radius, for tracks in rates."""
    if estimates.mapping.track_keys is not None and not estimates.mapping.in_rates:
        return "sprocket_radius = 0.1    # not used for this log"
    distance = estimates.wheels.distance
    if distance is None:
        return f"sprocket_radius = nan    {FILL_IN} (m, effective)"
    by_source = "by the fixes"
    if distance.source == "truth":
        by_source = "by the truth where it hardly turned"
    radius, error = distance.value, distance.error
    if distance.sigma is not None and distance.sigma > ROUGH_RADIUS * radius:
        return f"sprocket_radius = nan    {FILL_IN} (m, effective; {radius:.2g}{error} {by_source})"
    return f"sprocket_radius = {radius:.4g}    # m{error}, effective, {by_source}"


def _index_lines(estimates: LogEstimates) -> list[str]:
    """Table [indices]: steering efficiency eta0 of constant ICRs, by the gyro."""
    estimate, track = estimates.wheels.track, estimates.effective_track
    if estimate is None and not estimates.mapping.lacks_counts_per_turn:
        return []
    if track is not None:
        eta0 = max(1.0, track / (estimates.sizes.gauge or track))
        remark = f"effective track by the gyro, {track:.3g} m, over track_gauge"
        line = f"eta0 = {eta0:.3g}    # {remark}"
    elif estimate is not None and estimates.mapping.from_twist:
        line = (
            f"eta0 = {max(1.0, estimate.value):.2f}    # effective track by the gyro: "
            f"{estimate.value:.2f} times the controller's gauge ([log.tracks]), over track_gauge"
        )
    else:
        advice = "or fill in the rest, and inspect again with --overwrite"
        if estimate is not None:
            advice = f"{estimate.value:.3g} sprocket_radius / track_gauge, by the gyro; {advice}"
        line = f"eta0 = nan    {FILL_IN} ({advice})"
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
    angles = [_to_tenth(angle) for angle in mounting.rotation_rpy_deg]
    lines = [*_mounting_comments(mounting), "[imu]", f"rotation_rpy_deg = {angles}"]
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
        bias = ", ".join(f"{rate:.5f}" for rate in mounting.gyro_bias)
        seconds = f"{mounting.still_seconds:.0f} s"
        lines.append(f"# Gyro bias at standstill ({seconds}): ({bias}) rad/s in the IMU's axes.")
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
    if bias is None or not bias.is_clear:
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
    by_gravity, correlation = mounting.up_shown_by == "gravity", mounting.turning_correlation
    lines = ["# The IMU has no accelerometer."]
    if mounting.specific_force is not None:
        force = ", ".join(f"{part:.2f}" for part in mounting.specific_force)
        end = "; roll and pitch turn it upright." if by_gravity else "."
        lines = [f"# Mean specific force ({force}) m/s²{end}"]
    if mounting.up_shown_by == "turning":
        lines.append(
            "# Roll and pitch turn that axis up about which the gyro turns as the tracks do (correlation "
            f"{correlation:.2f}), if left and right are not swapped."
        )
        return lines
    if by_gravity:
        yaw = {
            "": f" {FILL_IN.removeprefix('# ')}; 0 is right if the IMU's x axis points forward.",
            "tracks": ": accelerations follow the track speeds with it.",
            STATIC: f": by /{STATIC}.",
        }[mounting.yaw_shown_by]
        lines.append(f"# Yaw{yaw}")
    elif mounting.yaw_shown_by:
        lines.append(f"# Mounting by /{STATIC}.")
    else:
        lines.append("# Nothing shows how it is mounted: this is for its z axis upward.")
    if correlation is None:
        text = "# Nothing turns, or always alike: the sign of turning cannot be checked."
    else:
        verdict = "too little to check the sign of turning."
        if correlation > CLEAR_SIGN:
            verdict = "the sign of turning is right."
        elif correlation < -CLEAR_SIGN:
            verdict = "TURNS THE WRONG WAY, left and right may be swapped."
        subject = "Track speeds and the rate about the vertical"
        text = f"# {subject} have a correlation of {correlation:.2f}: {verdict}"
    return [*lines, text]


def _tracks_lines(estimates: LogEstimates) -> list[str]:
    """Table [tracks]: uncertainty of the effective radius, or of the speeds."""
    if estimates.mapping.track_keys is None:
        return []
    in_rates, distance = estimates.mapping.in_rates, estimates.wheels.distance
    sigma, remark = USUAL_SCALE_SIGMA, "what is usually not known of an effective radius"
    if distance is not None and distance.sigma is not None and not estimates.sizes.radius:
        if in_rates:
            largest, subject = ROUGH_RADIUS, "the effective radius above"
            measured = distance.sigma / distance.value
        else:
            # Speeds are not corrected, so that their whole error counts.
            largest, subject = USUAL_SCALE_SIGMA, "the speeds"
            measured = float(np.hypot(distance.value - 1.0, distance.sigma))
        if measured < largest:
            sigma = max(measured, LEAST_SCALE_SIGMA)
            remark = f"of {subject}, by the {distance.source}"
            if in_rates and measured < USUAL_SCALE_SIGMA:
                remark += f"; {USUAL_SCALE_SIGMA:g} for another"
    return [
        "[tracks]",
        f"scale_sigma = {sigma:.2g}    # relative, {remark}",
        f"difference_sigma = {USUAL_DIFFERENCE_SIGMA:g}    # of the right radius less the left, relative",
        "",
    ]


def _topic_lines(estimates: LogEstimates) -> list[str]:
    """Tables [log.tracks], [log.imu], ...: topics, clocks, latency and errors."""
    lines = []
    for purpose in ("tracks", "imu", "fixes", "heading", "truth"):
        topic = getattr(estimates.mapping, purpose)
        if topic is None:
            continue
        lines += ["", f"[log.{purpose}]"]
        if purpose == "fixes":
            remark = "Where they are a truth, as of a lidar map: [log.truth], with the topic alone."
            lines.append(f"# {remark}")
        is_pair = getattr(topic, "right_topic", None) is not None
        usual = ("auto",) if is_pair else ("auto", "rad/s", "m/s2")
        lines += _key_lines(topic, _estimated_keys(purpose, topic, estimates), usual)
    return lines[1:]


def _column_lines(estimates: LogEstimates) -> list[str]:
    """Tables [log.columns], [log.columns.tracks], ...; none without columns."""
    columns = estimates.mapping.columns
    if columns is None:
        return []
    lines = ["[log.columns]", f"time = {toml_value(columns.time)}"]
    lines.append(f"time_unit = {toml_value(columns.time_unit)}    # check it")
    for purpose in ("tracks", "imu", "fixes", "truth"):
        stream = getattr(columns, purpose)
        if stream is not None:
            lines += ["", f"[log.columns.{purpose}]"]
            lines += _key_lines(stream, _estimated_keys(purpose, stream, estimates))
    return lines


def _key_lines(stream: Any, estimated: Mapping[str, str], usual: Sequence[str] = ()) -> list[str]:
    """Lines of a topic's or columns' keys: as estimated, or as guessed if not usual."""
    lines = []
    for key in stream.__struct_fields__:
        value = getattr(stream, key)
        if key in estimated:
            lines += [estimated[key]] if estimated[key] else []
        elif value not in (None, (), "", 0.0, (0.0, 0.0, 0.0), *usual):
            text = repr(value) if key.startswith("clock_") else toml_value(value)  # all digits
            remark = "    # check it" if key in CHECKED else ""
            if key == "counts_per_turn":
                text, remark = "nan", f"    {FILL_IN} (of the wheel)"
            elif key == "position_sigma":
                remark = f"    {FILL_IN} (m)"
            lines.append(f"{key} = {text}{remark}")
    return lines


def _estimated_keys(purpose: str, stream: Any, estimates: LogEstimates) -> dict[str, str]:
    """Lines of keys of a topic or columns by an estimate; empty for keys left out."""
    lines = {"scale": ""}  # nobody can guess it
    choice = estimates.clocks.get(purpose)
    if choice is not None and choice.clock == "recording" and hasattr(stream, "topic"):
        lines["time"] = f'time = "recording"    # {choice.reason}'
    if purpose == "tracks" and not stream.left:
        lines |= {"gauge": GAUGE_LINE, "unit": ""}
    if purpose in ("tracks", "heading"):
        lines["latency"] = _latency_line(estimates.latencies.get(purpose))
    if purpose == "heading":
        lines |= _heading_keys(stream, estimates)
    if not getattr(stream, "yaw", ""):
        lines["yaw_unit"] = ""
    if purpose == "fixes":
        lines |= _wander_keys(estimates.wander, estimates.states_fix_sigma)
        lines |= _fit_keys(estimates.fix_fit, stream.position)
    return lines


def _latency_line(latency: Lag | NoLag | None) -> str:
    """Key latency of a stream, or a comment why it is not written; empty if unknown."""
    if not isinstance(latency, Lag):
        return ""
    if reason := objection(latency):
        size = f"{latency.seconds:.3f} ± {latency.sigma:.1g} s"
        return f"# Latency against the gyro: {size}, {reason}: not written."
    lags = "lags" if latency.seconds > 0.0 else "leads"
    return f"latency = {latency.seconds:.2f}    # s, ± {latency.sigma:.1g}: {lags} the gyro"


def _heading_keys(heading: HeadingTopic, estimates: LogEstimates) -> dict[str, str]:
    """Keys sigma and offset_deg of [log.heading]."""
    log, fit = estimates.log, estimates.fix_fit
    antenna = fit.place if fit is not None and fit.differs(np.zeros(2)) else None
    offset = None if log is None else heading_offset(log, antenna)
    offset_line = f"offset_deg = nan    {FILL_IN} (to the direction of driving)"
    if offset is not None:
        remark = f"± {offset.sigma:.1g}: direction of driving less heading"
        offset_line = f"offset_deg = {_to_tenth(offset.value)}    # {remark}"
    if heading.sigma is None:
        return {"offset_deg": offset_line}
    return {"sigma": f"sigma = {heading.sigma}    {FILL_IN} (rad)", "offset_deg": offset_line}


def _wander_keys(wander: FixWanderEstimate | str | None, states_sigma: bool) -> dict[str, str]:
    """Keys of the error of the fixes: its white part, and that which wanders."""
    if not isinstance(wander, FixWanderEstimate):
        return {}
    white = f"position_sigma = {wander.white:.2g}    # m"
    if wander.reason:
        # A part that seems slow is odometry's: little is known of a smaller white one.
        if states_sigma or (wander.sigma and wander.white < PLACEHOLDER_SIGMA):
            return {}
        return {"position_sigma": f"{white}, white noise, against odometry"}
    shortest, longest = wander.times
    lines = {
        "position_sigma": f"{white}, what is new in each fix, against odometry",
        "wander_sigma": f"wander_sigma = {wander.sigma:.2g}    # m, the part that changes slowly",
        "wander_time": f"wander_time = {wander.time:g}    # s; {shortest:g} to {longest:g} s fit as well",
    }
    if wander.stated is not None:
        # Where odometry does not tell the parts apart, the fixes' own sigma holds.
        lines["position_sigma"] = ""
    return lines


def _fit_keys(fit: FixFit | None, known: tuple[float, ...]) -> dict[str, str]:
    """Keys of the fixes: their latency, and the place of the antenna."""
    lines = {}
    if any(known):
        lines["position"] = f"position = {_metres(known)}    # m, of the antenna, by /{STATIC}"
    elif fit is not None and fit.differs(np.zeros(2)):
        place = _metres(fit.place.round(2))
        lines["position"] = f"position = {place}    # m, ± {fit.sigma:.1g}: antenna, by bends"
    if fit is not None and fit.is_late:
        lag, side = f"{fit.lag:.2f}", "behind" if fit.lag > 0.0 else "ahead of"
        lines["latency"] = f"latency = {lag}    # s, ± {fit.lag_sigma:.1g}, {side} the tracks"
    return lines


def _metres(position: Iterable[float]) -> str:
    """Position to the millimetre, as a list of TOML."""
    return str([round(float(length), 3) + 0.0 for length in position])


def _to_tenth(degrees: float) -> float:
    """Angle to the tenth; the sum turns -0.0 into 0.0."""
    return round(degrees, 1) + 0.0
