"""Checks of the tracks in a robot file: sense, latency, scale, effective track."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.lag_search import BLOCKS
from icreckon.estimator.log.failed_sensors import (
    RIGHT,
    UnequalSides,
    stuck_sides,
    turning_at,
    unequal_sides,
)
from icreckon.estimator.log.lag import Lag
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.check import (
    LATENCY,
    SCALE,
    SIGMAS,
    TRACK,
    Check,
    Estimate,
    Measured,
    Settings,
    effective_track,
    has_track_rates,
    in_base,
    mapped_table,
    measured_scale,
    measured_track,
    true_motion,
    with_speeds,
)
from icreckon.replay.estimates import imu_mounting
from icreckon.replay.estimates.latency import clock_fit, objection, track_latency, without_lag
from icreckon.replay.estimates.wheels import DEGREES, jackknifed, turning_suspicion
from icreckon.replay.mapping.columns import TrackColumns
from icreckon.replay.mapping.topics import topic_map

# Error of a scale that counts in any case, in straight windows and in bends [-]: ground and slip change
# the distance by as much.
LEAST_SCALE, LEAST_IN_BENDS = 0.03, 0.1
# Factor between the effective tracks of the file and of the log that ground and steady bends do not
# explain [-], and latency that is usual [s]: robots turn up to 0.06 s later than their tracks.
OTHER_TRACK = 1.4
LEAST_LATENCY = 0.07
SCALE_BY_FORCE = 0.35  # least reported scale error by accelerometer [-]: suspensions squat
AGREEING = 1.2  # largest factor between the bounds of a scale by accelerometer that agree
SIDES, RATIO = "sides", "ratio of the sides"
FAILED = {SIDES, RATIO}  # checks of a side that fails
# Usual errors of a scale, as true over assumed.
RADIUS_ERRORS = (
    (0.5, "is the radius a diameter?"),
    (2.0, "is the radius half of what it should be?"),
)
TRUTH_ERRORS = ((1000.0, "is the truth in mm?"), (100.0, "is the truth in cm?"))
UNIT_ERRORS = (
    (0.001, "is a length or a speed in mm?"),
    (0.01, "is a length or a speed in cm?"),
    *TRUTH_ERRORS,
    (1.0 / 3.6, "are the speeds in km/h?"),
    (0.44704, "are the speeds in mph?"),
    (2.0 * math.pi, "are the rates in turns per second?"),
    (math.pi / 30.0, "are the rates in rpm?"),
    (math.pi / 180.0, "are the rates in deg/s?"),
)
STATED_ERRORS = (
    (180.0 / math.pi, "are the rates in rad/s, not deg/s?"),
    (30.0 / math.pi, "are the rates in rad/s, not rpm?"),
)
COUNT_QUESTION = "is counts_per_turn off by that (lines or edges, gears), or the radius a diameter?"
COUNT_ERRORS = tuple((size, COUNT_QUESTION) for size in (0.25, 0.5, 2.0, 4.0))
SIGN_WINDOW = 0.5  # windows in which signs are compared with those of a truth [s]
USUAL_ERROR = 0.05  # largest relative distance from a usual error [-]
USUAL_ETA, WIDEST_ETA = 3.5, 4.0  # usual eta0, and one that is another unit [-]
PLAUSIBLE = (3e-4, 3e3)  # scales that are a matter of units at all [-]
# Fewest samples of a gyro that reads one value, and turning of the tracks that a gyro must show [rad/s].
FEWEST, CLEARLY_TURNS = 20, 0.05


def check_sides(log: Log, robot: Robot) -> Iterator[Check]:
    """Sides that repeat one reading while the other one drives."""
    turning = _turning_by_gyro(log, robot)
    if turning is not None and (stuck := stuck_sides(log.tracks, turning)):
        text = "; ".join(side.text for side in stuck)
        remedy = "look at its sensor and cable; corrected here by the other side and the gyro"
        yield Check(SIDES, "both change", text, text, remedy, _without_stuck_sides)


def _turning_by_gyro(log: Log, robot: Robot) -> Floats | None:
    """Right less left speed (n,) by the gyro, at the tracks' stamps [m/s], or None."""
    if log.imu is None:
        return None
    vertical, _ = in_base(log.imu, robot)
    return turning_at(log.tracks, log.imu, vertical, effective_track(robot))


def _without_stuck_sides(log: Log, robot: Robot) -> tuple[Log, Robot]:
    """Give stuck sides the speed of the other side and the gyro's turning."""
    turning, speeds = _turning_by_gyro(log, robot), log.tracks.speeds.copy()
    if turning is not None:
        for stuck in stuck_sides(log.tracks, turning):
            sign = 1.0 if stuck.side == RIGHT else -1.0
            for rows in stuck.spans:
                speeds[rows, stuck.side] = speeds[rows, 1 - stuck.side] + sign * turning[rows]
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, speeds)), robot


def check_ratio(log: Log, robot: Robot) -> Iterator[Check]:
    """Ratio of the sides where the robot drives straight on by the gyro."""
    unequal = _unequal_sides(log, robot)
    if unequal is not None:
        in_log = f"{unequal.ratio:.2f}, {('left over right', 'right over left')[unequal.side]}"
        remedy = "look at counts, gears, radius and wheels of both sides: one of them is wrong"
        yield Check(RATIO, "1 straight on", in_log, unequal.text, remedy, _with_equal_sides)


def _unequal_sides(log: Log, robot: Robot) -> UnequalSides | None:
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return None
    return unequal_sides(log.tracks, log.imu, in_base(log.imu, robot)[0])


def _with_equal_sides(log: Log, robot: Robot) -> tuple[Log, Robot]:
    """Scale the side that reads less, from the row on from which it does."""
    unequal, speeds = _unequal_sides(log, robot), log.tracks.speeds.copy()
    if unequal is not None:
        speeds[unequal.begin :, unequal.side] /= unequal.ratio
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, speeds)), robot


def check_turning(log: Log, robot: Robot) -> Iterator[Check]:
    """Unit of the gyro, and its sense of rotation against that of the tracks."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return
    vertical, _ = in_base(log.imu, robot)
    track_rate = float(np.ptp(log.tracks.speeds, axis=1).mean()) / effective_track(robot)
    if len(vertical) > FEWEST and np.ptp(vertical) == 0.0 and track_rate > CLEARLY_TURNS:
        in_log = f"reads {vertical[0]:.4g} rad/s all the time"
        problem = "the gyro reads one value all the time, and the tracks turn"
        remedy = "look at its driver and cable; gyro_axes in [imu] if only one axis is logged"
        yield Check("gyro", "shows turns", in_log, problem, remedy)
        return
    correlation = imu_mounting.turning_correlation(log.tracks, log.imu, vertical)
    in_log = "nothing turns" if correlation is None else f"correlation {correlation:.2f}"
    check = Check("sense of turning", "left is positive", in_log)
    if correlation is None or abs(correlation) < imu_mounting.CLEAR_TURNING:
        in_log += "" if correlation is None else ": unclear"
        yield _unclear_turning(log, log.imu, robot, replace(check, in_log=in_log), vertical)
        return
    spread = float(log.tracks.difference.std()) / effective_track(robot)
    ratio = float(vertical.std()) / spread if spread else 0.0
    lowest, highest = DEGREES
    is_apart = lowest < ratio < highest
    # Where the gyro agrees with a truth, `check_scale` names the unit of the tracks.
    if is_apart and abs(_over_true(log, log.imu.stamps, vertical, 2) or math.inf) > lowest:
        in_log = f"{ratio:.0f} times the tracks' turning"
        problem = f"the gyro reads {ratio:.0f} times what the tracks turn: it is in deg/s"
        remedy, measured = 'rate_unit = "deg/s" in [log.imu]', Measured(ratio, "-", 1.0)
        in_radians = partial(_with_rates, factor=math.pi / 180.0)
        yield Check("unit of the gyro", "rad/s", in_log, problem, remedy, in_radians, measured)
    check = replace(check, measured=Measured(correlation, "-", 1.0))
    yield _clear_turning(log, log.imu, robot, check, turns_alike=correlation > 0.0)


def _clear_turning(
    log: Log, imu: ImuSeries, robot: Robot, check: Check, *, turns_alike: bool
) -> Check:
    """Check of tracks that turn as the gyro, or opposite: swapped, or reversed?"""
    vertical, force = in_base(imu, robot)
    # None without a truth
    is_backward = _is_opposite(log, log.tracks.stamps, log.tracks.speeds.mean(axis=1), 0)
    # Where tracks and gyro agree, it is the truth that turns the other way.
    if not turns_alike and _is_opposite(log, imu.stamps, vertical, 2):
        text = "the gyro's signs are wrong: it turns the other way than the truth"
        table = mapped_table(robot, "imu")
        remedy = f"a negative rate_unit in [{table}], -1.0 for rad/s (or its z axis points down)"
        return check.contradicted(text, remedy, partial(_with_rates, factor=-1.0))
    by_imu = False
    if is_backward is None and force is not None:
        horizontal = np.nan_to_num(force[:, :2])
        yaw = imu_mounting.forward_yaw(log.tracks, imu.stamps, horizontal, vertical)
        by_imu = yaw is not None and abs(yaw) == 180.0
    if turns_alike and not is_backward:
        return check
    if topic_map(robot).from_twist:
        are_wrong = {"forward speed": is_backward, "yaw rate": not turns_alike}
        wrong = [name for name, is_wrong in are_wrong.items() if is_wrong]
        order = slice(None, None, -1 if turns_alike == bool(is_backward) else 1)
        sign = -1.0 if is_backward else 1.0
        text = f"the odometry has the wrong sign of {' and '.join(wrong)}"
        remedy = "its driver, or record the speeds of both sides"
        return check.contradicted(text, remedy, with_speeds(lambda v: sign * v[:, order]))
    minus = 'with a minus before each name, as "-motor"'
    table = mapped_table(robot, "tracks")
    exchange = f"exchange left and right in [{table}]"
    if "right_topic" in robot.log.get("tracks", {}):
        exchange = "exchange topic and right_topic in [log.tracks]"
    if turns_alike:
        text = "the tracks drive backward where the truth drives forward, and turn as the gyro does"
        remedy = f"{exchange}, {minus}"
        correction = with_speeds(lambda speeds: -speeds[:, ::-1])
    elif is_backward or by_imu:
        text = "both tracks count backward: they turn the other way than the gyro"
        remedy = f"left and right in [{table}] {minus}"
        correction = with_speeds(lambda speeds: -speeds)
        if by_imu:
            text += " and accelerate the other way than the IMU"
            remedy += " (or left and right are swapped, and the IMU is turned by 180 deg)"
    else:
        text, remedy = "left and right are swapped", exchange
        if is_backward is None:
            text += ", or the gyro's signs are wrong"
            remedy += " (or the gyro's z axis points down, or needs a negative rate_unit)"
        text += ": the tracks turn the other way than the gyro"
        correction = with_speeds(lambda speeds: speeds[:, ::-1].copy())
    return check.contradicted(text, remedy, correction)


def _unclear_turning(log: Log, imu: ImuSeries, robot: Robot, check: Check, rate: Floats) -> Check:
    """Check of tracks without a clear correlation: clock, gauge, or a side?"""
    tracks, table = topic_map(robot).track_keys, mapped_table(robot, "tracks")
    fit = clock_fit(log.tracks, imu, rate)
    if fit is not None and fit.is_apart:
        moved = fit.undone(log.tracks)
        remedy, settings = f'time = "recording" in [{table}]', Settings()
        if isinstance(tracks, TrackColumns):
            keys = fit.keys(tracks)
            settings = {f"{table}.{key}": value for key, value in keys.items()}
            remedy = f"{', '.join(f'{key} = {value}' for key, value in keys.items())} in [{table}]"
        return check.contradicted(
            f"the tracks' clock is {fit.offset:+.2f} s off the IMU's",
            remedy,
            lambda log, robot: (replace(log, tracks=moved), robot),
            settings,
        )
    if tracks is not None and not tracks.left:
        suspicion = turning_suspicion(log, rate, tracks.gauge or robot.vehicle.track_gauge)
        remedy = f"gauge in [{table}], which is that of its controller, or its yaw rate"
        return check.contradicted(suspicion[0], remedy) if suspicion else check
    side = imu_mounting.backward_side(log.tracks, imu, rate)
    if side is None:
        if not imu_mounting.turn_apart(log.tracks, imu, rate):
            return check
        remedy = (
            f"look at the topics of {table} and of the IMU: another robot's, or another time's?"
        )
        return check.contradicted("the gyro and the tracks turn, but not together", remedy)
    signs = np.array([1.0, -1.0] if side == "right" else [-1.0, 1.0])
    return check.contradicted(
        f"the {side} side counts backward: the robot turns as the sum of both sides",
        f'a minus before the names of {side} in [{table}], as "-motor"',
        with_speeds(lambda speeds: speeds * signs),
    )


def _is_opposite(log: Log, stamps: Stamps, values: Floats, axis: int) -> bool | None:
    """True if speeds (axis 0) or yaw rates (2) have the wrong signs, None if unknown."""
    ratio = _over_true(log, stamps, values, axis)
    return None if ratio is None else ratio < 0.0


def _over_true(log: Log, stamps: Stamps, values: Floats, axis: int) -> float | None:
    """Ratio of speeds (axis 0) or yaw rates (2) to a truth's [-], None if unclear."""
    truth = log.truth
    if truth is None or not truth.headings:
        return None
    motion = true_motion(log, truth, SIGN_WINDOW)
    if motion is None:
        return None
    edges, moved = motion
    true, middles = moved[:, axis] / SIGN_WINDOW, 0.5 * (edges[1:] + edges[:-1])
    found = np.interp(middles, stamps, values)
    product, square = float(true @ found), float(true @ true)
    size = math.sqrt(square) * float(np.linalg.norm(found))
    # From -1 to 1, as of a correlation about zero.
    is_clear = size > 0.0 and abs(product) / size > imu_mounting.CLEAR_TURNING
    return product / square if is_clear else None


def _with_rates(log: Log, robot: Robot, *, factor: float) -> tuple[Log, Robot]:
    """Correct a gyro whose readings have the wrong unit or signs."""
    assert log.imu is not None  # noqa: S101 - checked by the caller
    rates = factor * log.imu.angular_velocity
    return replace(log, imu=replace(log.imu, angular_velocity=rates)), robot


def check_latency(log: Log, robot: Robot) -> Iterator[Check]:
    """Latency of the track speeds against the gyro, beyond that of the file."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return
    vertical, _ = in_base(log.imu, robot)
    lag = track_latency(log.tracks, log.imu, vertical)
    if not isinstance(lag, Lag):
        yield Check(LATENCY, "", f"not seen: {lag.reason}")
        return
    tracks = topic_map(robot).track_keys
    # `read_log` has subtracted the latency of the file from the stamps.
    stated = 0.0 if tracks is None else tracks.latency
    latency = stated + lag.seconds
    in_log = f"{latency:.3f} ± {lag.sigma:.1g} s after the gyro"
    measured = Measured(latency, "s", stated, lag.sigma)
    check = Check(LATENCY, f"{stated:g} s", in_log, measured=measured)
    if objection(lag) or abs(lag.seconds) <= max(LEAST_LATENCY, SIGMAS * lag.sigma):
        if abs(lag.seconds) > SIGMAS * lag.sigma:
            check = replace(check, in_log=f"{in_log}; counts from {LEAST_LATENCY:g} s on")
        yield check
        return
    table = mapped_table(robot, "tracks")
    size = f"{abs(lag.seconds):.2f} s {'late' if lag.seconds > 0.0 else 'early'}"
    yield check.contradicted(
        f"track speeds are stamped {size} against the gyro, ± {lag.sigma:.3f} s",
        f"add {lag.seconds:+.2f} to latency in [{table}]",
        lambda log, robot: (replace(log, tracks=without_lag(log.tracks, lag)), robot),
        {f"{table}.latency": round(latency, 2)},
    )


def check_scale(log: Log, robot: Robot) -> Iterator[Check]:
    """Scale of the track speeds, by truth, fixes or the accelerometer."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return
    scale, least = _measured_scale(log, log.imu, robot)
    if scale is None:
        yield Check(SCALE, "1", "not seen: no truth, no fixes")
        return
    ratio, sigma, source = scale
    error = "" if sigma is None else f" ± {sigma:.3f}"
    in_log = f"{ratio:.3f}{error}, {source} over tracks"
    if sigma is None:
        in_log += " (too few straight stretches to tell its error)"
    # Rates are corrected by the radius, speeds by their scale.
    table, name, stated = "vehicle", "sprocket_radius", robot.vehicle.sprocket_radius
    tracks = topic_map(robot).track_keys
    if tracks is not None and not has_track_rates(robot):
        table, name, stated = mapped_table(robot, "tracks"), "scale", tracks.scale
    value = float(f"{ratio * stated:.4g}")
    check = Check(SCALE, "1", in_log, measured=Measured(ratio, "-", 1.0, sigma))
    smallest, largest = PLAUSIBLE
    if not smallest < ratio < largest:
        yield check.contradicted(
            f"the {source} moves {ratio:.3g} times as far as the tracks: one of them shows no motion, or "
            "they are in units that nobody uses",
            "look at both; a receiver without a fix may repeat one position",
        )
        return
    if abs(ratio - 1.0) <= max(least, SIGMAS * (sigma or 0.0)) and 0.5 < ratio < 2.0:
        if abs(ratio - 1.0) > LEAST_SCALE:
            in_log += f"; counts from {least:.0%} on, {name} = {value:.3g} would fit"
        yield replace(check, in_log=in_log)
        return
    guess = _guess(ratio, robot)
    text = f"the {source} moves {ratio:.3g}{error} times as far as the tracks{guess}"
    if source == "truth" and guess.removeprefix(": ") in dict(TRUTH_ERRORS).values():
        yield check.contradicted(text, "convert the positions of the truth to metres")
        return
    if source == "accelerometer":
        text = f"accelerations are {ratio:.3g}{error} times the changes of the track speeds"
        text += f" (suspensions explain 1.2){guess}"
    remedy = f"{name} = {value:g} in [{table}]"
    if guess.removeprefix(": ") in dict((*UNIT_ERRORS, *STATED_ERRORS)).values():
        remedy = f"the unit in [{mapped_table(robot, 'tracks')}], or else {remedy}"
    corrected = with_speeds(lambda speeds: ratio * speeds)
    yield check.contradicted(text, remedy, corrected, {f"{table}.{name}": value})


def _measured_scale(log: Log, imu: ImuSeries, robot: Robot) -> tuple[Estimate | None, float]:
    """Scale of the track speeds [-], None if unclear, and the least error that counts."""
    least = LEAST_SCALE
    scale = measured_scale(log, robot)
    if scale is None:
        least, scale = LEAST_IN_BENDS, measured_scale(log, robot, with_bends=True)
    if scale is None:
        return _scale_by_force(log.tracks, imu, robot), SCALE_BY_FORCE
    return scale, max(least, SIGMAS * robot.tracks.scale_sigma)


def _guess(ratio: float, robot: Robot) -> str:
    """Question whether a usual error explains a scale, true over assumed; else empty."""
    radius, tracks = robot.vehicle.sprocket_radius, topic_map(robot).track_keys
    by_radius = [(radius, "are they rates in rad/s, read as m/s?")]
    if has_track_rates(robot):
        by_radius = [(1.0 / radius, "are they m/s, read as rates in rad/s?"), *STATED_ERRORS]
    usual_errors = [*RADIUS_ERRORS, *UNIT_ERRORS, *by_radius]
    if tracks is not None and tracks.unit == "counts":
        usual_errors = [*COUNT_ERRORS, *UNIT_ERRORS, *by_radius]
    distance, question = min((abs(math.log(ratio / size)), text) for size, text in usual_errors)
    return f": {question}" if distance < USUAL_ERROR else ""


def _scale_by_force(tracks: TrackSpeedSeries, imu: ImuSeries, robot: Robot) -> Estimate | None:
    """Scale of the track speeds, by the acceleration of the IMU [-]; None if unclear."""
    # Accelerations are means over successive intervals of `imu_mounting.SMOOTHING`.
    stamps, (_, force) = imu.stamps, in_base(imu, robot)
    if force is None:
        return None
    step = float(np.median(np.diff(stamps))) * NANOSECOND
    width = max(1, round(imu_mounting.SMOOTHING / step))
    count = (len(stamps) - 1) // width
    if count < 20 * BLOCKS:
        return None
    speed = np.interp(stamps, tracks.stamps, tracks.speeds.mean(axis=1))
    edges = slice(0, count * width + 1, width)
    of_tracks = np.diff(speed[edges]) / (np.diff(stamps[edges]) * NANOSECOND)
    of_imu = force[: count * width, 0].reshape(count, width).mean(axis=1)
    is_known = np.isfinite(of_imu)
    # Changes from one interval to the next are free of slopes and bias, which change slowly.
    by_tracks, by_imu = np.diff(of_tracks[is_known]), np.diff(of_imu[is_known])

    def slope(rows: NDArray[np.int_]) -> float:
        x, y = by_tracks[rows], by_imu[rows]
        return float(x @ y / (x @ x))

    if not by_tracks.any():
        return None
    scale, sigma = jackknifed(slope, len(by_tracks))
    if scale <= 0.0 or sigma >= 0.1 * scale:
        return None
    # Noise of the tracks makes this slope too small; noise of the IMU makes the inverse of the slope of
    # tracks over IMU too large. Unless these two bounds agree, the one nearer to 1 counts.
    largest = float(by_imu @ by_imu / (by_tracks @ by_imu))
    if largest > AGREEING * scale:
        if scale < 1.0 < largest:
            return None
        scale = min(scale, largest, key=lambda bound: abs(math.log(bound)))
    return Estimate(scale, sigma, "accelerometer")


def is_other_track(ratio: float) -> bool:
    """Return True if a ratio of effective tracks, log over file, is a contradiction."""
    return not 1.0 / OTHER_TRACK < ratio < OTHER_TRACK


def check_track(log: Log, robot: Robot) -> Iterator[Check]:
    """Effective track, by gyro and tracks."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return
    estimate, stated = measured_track(log, robot), effective_track(robot)
    in_file = f"{stated:.2f} m"
    if estimate is None:
        yield Check(TRACK, in_file, "not seen: tracks and gyro turn too little, or not alike")
        return
    track, sigma = estimate.value, estimate.sigma
    ratio = track / stated
    error = "" if sigma is None else f" ± {sigma:.1g}"
    in_log = f"{track:.2f}{error} m by the gyro, {ratio:.2f} times"
    check = Check(TRACK, in_file, in_log, measured=Measured(track, "m", stated, sigma))
    gauge = robot.vehicle.track_gauge
    if not is_other_track(ratio) and track > 0.9 * gauge:
        yield check
        return
    eta0 = track / gauge
    if eta0 < 1.0:
        yield check.contradicted(
            f"the effective track is {track:.3g} m by the gyro, narrower than track_gauge = {gauge:g} m, "
            "which no slip explains",
            "measure track_gauge between the centrelines, and check sprocket_radius",
            lambda log, robot: (log, _with_track(robot, track, 1.0)),
        )
        return
    questions = [text for size, text in UNIT_ERRORS if 1.0 < eta0 * size < USUAL_ETA]
    if eta0 > WIDEST_ETA and questions:
        text = f"the tracks turn {ratio:.0f} times as far as the gyro, which no slip explains"
        yield check.contradicted(text, f"look at the unit of [log.tracks]: {questions[0]}")
        return
    settings, icr_remedy = _track_settings(robot, round(eta0, 2)), ""
    if robot.constant_icr is not None:
        left, right = settings["constant_icr.x_ICRl"], settings["constant_icr.x_ICRr"]
        icr_remedy = f" and x_ICRl = {left}, x_ICRr = {right} in [constant_icr]"
    yield check.contradicted(
        f"the effective track is {track:.2f} m by the gyro, {ratio:.2f} times that of the file: wheel "
        f"odometry turns {ratio:.2f} times as far as the robot",
        f"eta0 = {eta0:.2f} in [indices]{icr_remedy}, or calibrate; where sprocket_radius is "
        "wrong, this is, too",
        lambda log, robot: (log, _with_track(robot, gauge, eta0)),
        settings,
    )


def _track_settings(robot: Robot, eta0: float) -> dict[str, float | list[float]]:
    """Settings of a robot file, by dotted key, for the effective track of an eta0."""
    settings: dict[str, float | list[float]] = {"indices.eta0": eta0}
    icr = robot.constant_icr
    if icr is not None:
        middle, half = 0.5 * (icr.x_ICRl + icr.x_ICRr), 0.5 * eta0 * robot.vehicle.track_gauge
        settings["constant_icr.x_ICRl"] = round(middle - half, 4)
        settings["constant_icr.x_ICRr"] = round(middle + half, 4)
        settings["constant_icr.y_ICR"] = icr.y_ICR
    return settings


def _with_track(robot: Robot, gauge: float, eta0: float) -> Robot:
    """Robot with a gauge and eta0, without constant ICRs, which overrule eta0."""
    vehicle = structs.replace(robot.vehicle, track_gauge=gauge)
    indices = structs.replace(robot.indices, eta0=eta0)
    return structs.replace(robot, vehicle=vehicle, indices=indices, constant_icr=None)
