"""Checks of the tracks in a robot file: sense, latency, scale, effective track."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from msgspec import structs

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Indexes, Stamps
from icreckon.estimator.base.lag_search import BLOCKS
from icreckon.estimator.log.failed_sensors import (
    RIGHT,
    StuckSide,
    UnequalSides,
    rates_at,
    stuck_sides,
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
    Correction,
    Measured,
    comparable_yaw_rates,
    force_in_base,
    has_track_rates,
    imu_yaw_rates,
    mapped_table,
    measured_scale,
    measured_track,
    replaced_speeds,
    true_motion,
    with_speeds,
)
from icreckon.replay.estimates import imu_mounting
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.latency import clock_fit, objection, track_latency, without_lag
from icreckon.replay.estimates.wheels import DEGREES, Estimate, jackknifed, turning_suspicion
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
RECORDING = 'time = "recording"'  # setting for topics whose header stamps are of another clock
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
ABOUT_UNITS = {question for _, question in (*UNIT_ERRORS, *STATED_ERRORS)}
ABOUT_TRUTH = {question for _, question in TRUTH_ERRORS}
COUNT_QUESTION = "is counts_per_turn off by that (lines or edges, gears), or the radius a diameter?"
COUNT_ERRORS = tuple((size, COUNT_QUESTION) for size in (0.25, 0.5, 2.0, 4.0))
SIGN_WINDOW = 0.5  # windows in which signs are compared with those of a truth [s]
USUAL_ERROR = 0.05  # largest relative distance from a usual error [-]
USUAL_ETA, WIDEST_ETA = 3.5, 4.0  # usual eta0, and one that is another unit [-]
PLAUSIBLE = (3e-4, 3e3)  # scales that are a matter of units at all [-]


def check_sides(log: Log, robot: Robot) -> Iterator[Check]:
    """Sides that repeat one reading while the other one drives."""
    if stuck := _stuck_sides(log, robot)[0]:
        text = "; ".join(side.text for side in stuck)
        remedy = "look at its sensor and cable; corrected here by the other side and the gyro"
        yield Check(SIDES, "both change", text, text, remedy, _without_stuck_sides)


def _stuck_sides(log: Log, robot: Robot) -> tuple[list[StuckSide], Floats]:
    """Stuck sides, and V_r - V_l (n,) by the gyro [m/s]; no sides without a gyro."""
    if log.imu is None:
        return [], np.zeros(len(log.tracks.stamps))
    turning = robot.effective_track * rates_at(log.tracks, *imu_yaw_rates(log.imu, robot))
    return stuck_sides(log.tracks, turning), turning


def _without_stuck_sides(log: Log, robot: Robot) -> tuple[Log, Robot]:
    """Give stuck sides the speed of the other side and the gyro's turning."""
    (stuck, turning), speeds = _stuck_sides(log, robot), log.tracks.speeds.copy()
    for side in stuck:
        sign = 1.0 if side.side == RIGHT else -1.0
        for rows in side.spans:
            speeds[rows, side.side] = speeds[rows, 1 - side.side] + sign * turning[rows]
    return replaced_speeds(log, speeds), robot


def check_ratio(log: Log, robot: Robot) -> Iterator[Check]:
    """Ratio of the sides where the robot drives straight on by the gyro."""
    if (unequal := _unequal_sides(log, robot)) is not None:
        sides = "right over left" if unequal.side == RIGHT else "left over right"
        in_log = f"{unequal.ratio:.2f}, {sides}"
        remedy = "look at counts, gears, radius and wheels of both sides: one of them is wrong"
        yield Check(RATIO, "1 straight on", in_log, unequal.text, remedy, _with_equal_sides)


def _unequal_sides(log: Log, robot: Robot) -> UnequalSides | None:
    """Side that reads less than the other one; None if neither, or without a gyro."""
    yaw_rates = comparable_yaw_rates(log, robot)
    return None if yaw_rates is None else unequal_sides(log.tracks, *yaw_rates)


def _with_equal_sides(log: Log, robot: Robot) -> tuple[Log, Robot]:
    """Scale the side that reads less, from the row on from which it does."""
    unequal, speeds = _unequal_sides(log, robot), log.tracks.speeds.copy()
    if unequal is not None:
        speeds[unequal.begin :, unequal.side] /= unequal.ratio
    return replaced_speeds(log, speeds), robot


def check_turning(log: Log, robot: Robot) -> Iterator[Check]:
    """Unit of the gyro, and its sense of rotation against that of the tracks."""
    yaw_rates = comparable_yaw_rates(log, robot)
    if yaw_rates is None:
        return
    rates, difference = yaw_rates.rates, log.tracks.difference
    correlation = imu_mounting.turning_correlation(log.tracks, yaw_rates)
    in_log = "nothing turns" if correlation is None else f"correlation {correlation:.2f}"
    check = Check("sense of turning", "left is positive", in_log)
    if correlation is None or abs(correlation) < imu_mounting.CLEAR_TURNING:
        if correlation is not None:
            check = replace(check, in_log=f"{in_log}: unclear")
        yield _unclear_turning(log, yaw_rates, robot, check)
        return
    spread = float(difference.std()) / robot.effective_track
    ratio = float(rates.std()) / spread if spread else 0.0
    lowest, highest = DEGREES
    # Where the gyro agrees with a truth, `check_scale` names the unit of the tracks.
    over_truth = _over_truth(log, *yaw_rates, axis=2)
    if lowest < ratio < highest and (over_truth is None or abs(over_truth) > lowest):
        in_log = f"{ratio:.0f} times the tracks' turning"
        problem = f"the gyro reads {ratio:.0f} times what the tracks turn: it is in deg/s"
        remedy, measured = 'rate_unit = "deg/s" in [log.imu]', Measured(ratio, "-", 1.0)
        in_radians = _with_rates_times(math.pi / 180.0)
        yield Check("unit of the gyro", "rad/s", in_log, problem, remedy, in_radians, measured)
    check = replace(check, measured=Measured(correlation, "-", 1.0))
    yield _clear_turning(log, yaw_rates, robot, check, turns_alike=correlation > 0.0)


def _clear_turning(
    log: Log, yaw_rates: YawRates, robot: Robot, check: Check, *, turns_alike: bool
) -> Check:
    """Check the signs of tracks that clearly turn as the gyro, or opposite to it."""
    forward_ratio = _over_truth(log, log.tracks.stamps, log.tracks.speeds.mean(axis=1), axis=0)
    is_backward = forward_ratio is not None and forward_ratio < 0.0
    if turns_alike and not is_backward:
        return check
    # Where tracks and gyro agree, it is the truth that turns the other way.
    turning_ratio = _over_truth(log, *yaw_rates, axis=2)
    if not turns_alike and turning_ratio is not None and turning_ratio < 0.0:
        text = "the gyro's signs are wrong: it turns the other way than the truth"
        table = mapped_table(robot, "imu")
        remedy = f"a negative rate_unit in [{table}], -1.0 for rad/s (or its z axis points down)"
        return check.contradicted(text, remedy, _with_rates_times(-1.0))
    if topic_map(robot).from_twist:
        return _wrong_twist(check, is_backward=is_backward, turns_alike=turns_alike)
    minus = 'with a minus before each name, as "-motor"'
    table = mapped_table(robot, "tracks")
    exchange = f"exchange left and right in [{table}]"
    if "right_topic" in robot.log.get("tracks", {}):
        exchange = "exchange topic and right_topic in [log.tracks]"
    if turns_alike:
        return check.contradicted(
            "the tracks drive backward where the truth drives forward, and turn as the gyro does",
            f"{exchange}, {minus}",
            with_speeds(lambda speeds: -speeds[:, ::-1]),
        )
    # Without a truth the accelerations show the forward direction, if the IMU's mounting is right.
    is_clear = forward_ratio is not None
    is_backward_by_imu = not is_clear and _accelerates_backward(log, yaw_rates, robot)
    if is_backward or is_backward_by_imu:
        text = "both tracks count backward: they turn the other way than the gyro"
        remedy = f"left and right in [{table}] {minus}"
        if is_backward_by_imu:
            text += " and accelerate the other way than the IMU"
            remedy += " (or left and right are swapped, and the IMU is turned by 180 deg)"
        return check.contradicted(text, remedy, with_speeds(lambda speeds: -speeds))
    text, remedy = "left and right are swapped", exchange
    if not is_clear:
        text += ", or the gyro's signs are wrong"
        remedy += " (or the gyro's z axis points down, or needs a negative rate_unit)"
    text += ": the tracks turn the other way than the gyro"
    return check.contradicted(text, remedy, with_speeds(lambda speeds: speeds[:, ::-1].copy()))


def _accelerates_backward(log: Log, yaw_rates: YawRates, robot: Robot) -> bool:
    """True if the IMU clearly accelerates backward where the tracks speed up."""
    force = None if log.imu is None else force_in_base(log.imu, robot)
    if force is None:
        return False
    horizontal = np.nan_to_num(force[:, :2])
    yaw = imu_mounting.forward_yaw(log.tracks, yaw_rates, horizontal)
    return yaw is not None and abs(yaw) == 180.0


def _wrong_twist(check: Check, *, is_backward: bool, turns_alike: bool) -> Check:
    """Contradiction of an odometry whose speed or yaw rate has the wrong sign."""
    wrong = []
    if is_backward:
        wrong.append("forward speed")
    if not turns_alike:
        wrong.append("yaw rate")
    # Tracks of a mirrored twist: both negative (speed), exchanged (yaw rate), or both.
    sign = -1.0 if is_backward else 1.0
    order = -1 if turns_alike == is_backward else 1
    return check.contradicted(
        f"the odometry has the wrong sign of {' and '.join(wrong)}",
        "its driver, or record the speeds of both sides",
        with_speeds(lambda speeds: sign * speeds[:, ::order]),
    )


def _unclear_turning(log: Log, yaw_rates: YawRates, robot: Robot, check: Check) -> Check:
    """Check tracks that do not clearly turn with the gyro: clock, gauge, or a side?"""
    tracks, table = topic_map(robot).track_keys, mapped_table(robot, "tracks")
    clock = clock_fit(log.tracks, yaw_rates)
    if clock is not None and clock.is_apart:
        moved = clock.undone(log.tracks)
        keys = clock.keys(tracks) if isinstance(tracks, TrackColumns) else {}
        settings = ", ".join(f"{key} = {value}" for key, value in keys.items())
        return check.contradicted(
            f"the tracks' clock is {clock.offset:+.2f} s off the IMU's",
            f"{settings or RECORDING} in [{table}]",
            lambda log, robot: (replace(log, tracks=moved), robot),
            {f"{table}.{key}": value for key, value in keys.items()},
        )
    if tracks is not None and not tracks.left:
        gauge = tracks.gauge or robot.vehicle.track_gauge
        suspicion = turning_suspicion(log.tracks, yaw_rates, gauge)
        remedy = f"gauge in [{table}], which is that of its controller, or its yaw rate"
        return check.contradicted(suspicion, remedy) if suspicion else check
    side = imu_mounting.backward_side(log.tracks, yaw_rates)
    if side is not None:
        signs = np.array([1.0, -1.0] if side == "right" else [-1.0, 1.0])
        return check.contradicted(
            f"the {side} side counts backward: the robot turns as the sum of both sides",
            f'a minus before the names of {side} in [{table}], as "-motor"',
            with_speeds(lambda speeds: speeds * signs),
        )
    if imu_mounting.turn_apart(log.tracks, yaw_rates):
        problem = "the gyro and the tracks turn, but not together"
        other = "another robot's, or another time's?"
        return check.contradicted(problem, f"look at the topics of {table} and of the IMU: {other}")
    return check


def _over_truth(log: Log, stamps: Stamps, values: Floats, axis: int) -> float | None:
    """Ratio of speeds (axis 0) or yaw rates (2) to a truth's [-], None if unclear."""
    truth = log.truth
    if truth is None or not truth.headings:
        return None
    motion = true_motion(log, truth, SIGN_WINDOW)
    if motion is None:
        return None
    edges, moved = motion
    true_values, middles = moved[:, axis] / SIGN_WINDOW, 0.5 * (edges[1:] + edges[:-1])
    measured = np.interp(middles, stamps, values)
    product, square = float(true_values @ measured), float(true_values @ true_values)
    size = math.sqrt(square) * float(np.linalg.norm(measured))
    # Over the size it is from -1 to 1, as a correlation about zero.
    is_clear = size > 0.0 and abs(product) / size > imu_mounting.CLEAR_TURNING
    return product / square if is_clear else None


def _with_rates_times(factor: float) -> Correction:
    """Correction of a gyro whose readings have the wrong unit or signs."""

    def correction(log: Log, robot: Robot) -> tuple[Log, Robot]:
        if log.imu is None:
            return log, robot
        rates = factor * log.imu.angular_velocity
        return replace(log, imu=replace(log.imu, angular_velocity=rates)), robot

    return correction


def check_latency(log: Log, robot: Robot) -> Iterator[Check]:
    """Latency of the track speeds against the gyro, beyond that of the file."""
    yaw_rates = comparable_yaw_rates(log, robot)
    if yaw_rates is None:
        return
    lag = track_latency(log.tracks, yaw_rates)
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
    table, key, stated = _scale_setting(robot)
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
            in_log += f"; counts from {least:.0%} on, {key} = {value:.3g} would fit"
        yield replace(check, in_log=in_log)
        return
    question = _usual_error(ratio, robot)
    text = f"the {source} moves {ratio:.3g}{error} times as far as the tracks"
    if source == "accelerometer":
        text = f"accelerations are {ratio:.3g}{error} times the changes of the track speeds"
        text += " (suspensions explain 1.2)"
    text += f": {question}" if question else ""
    if source == "truth" and question in ABOUT_TRUTH:
        yield check.contradicted(text, "convert the positions of the truth to metres")
        return
    remedy = f"{key} = {value:g} in [{table}]"
    if question in ABOUT_UNITS:
        remedy = f"the unit in [{mapped_table(robot, 'tracks')}], or else {remedy}"
    corrected = with_speeds(lambda speeds: ratio * speeds)
    yield check.contradicted(text, remedy, corrected, {f"{table}.{key}": value})


def _scale_setting(robot: Robot) -> tuple[str, str, float]:
    """Table, key and value by which track speeds are scaled: a radius for rates."""
    tracks = topic_map(robot).track_keys
    if tracks is None or has_track_rates(robot):
        return "vehicle", "sprocket_radius", robot.vehicle.sprocket_radius
    return mapped_table(robot, "tracks"), "scale", tracks.scale


def _measured_scale(log: Log, imu: ImuSeries, robot: Robot) -> tuple[Estimate | None, float]:
    """Scale of the track speeds [-], None if unclear, and the least error that counts."""
    least = LEAST_SCALE
    scale = measured_scale(log, robot)
    if scale is None:
        least, scale = LEAST_IN_BENDS, measured_scale(log, robot, with_bends=True)
    if scale is None:
        return _scale_by_force(log.tracks, imu, robot), SCALE_BY_FORCE
    return scale, max(least, SIGMAS * robot.tracks.scale_sigma)


def _usual_error(ratio: float, robot: Robot) -> str:
    """Question whether a usual error explains a scale, true over assumed; else empty."""
    radius, tracks = robot.vehicle.sprocket_radius, topic_map(robot).track_keys
    by_radius = [(radius, "are they rates in rad/s, read as m/s?")]
    if has_track_rates(robot):
        by_radius = [(1.0 / radius, "are they m/s, read as rates in rad/s?"), *STATED_ERRORS]
    usual_errors = [*RADIUS_ERRORS, *UNIT_ERRORS, *by_radius]
    if tracks is not None and tracks.unit == "counts":
        usual_errors = [*COUNT_ERRORS, *UNIT_ERRORS, *by_radius]
    distance, question = min((abs(math.log(ratio / size)), text) for size, text in usual_errors)
    return question if distance < USUAL_ERROR else ""


def _scale_by_force(tracks: TrackSpeedSeries, imu: ImuSeries, robot: Robot) -> Estimate | None:
    """Scale of the track speeds, by the acceleration of the IMU [-]; None if unclear."""
    # Accelerations are means over successive intervals of `imu_mounting.SMOOTHING`.
    stamps, force = imu.stamps, force_in_base(imu, robot)
    if force is None or len(stamps) < 20 * BLOCKS:
        return None
    step = float(np.median(np.diff(stamps))) * NANOSECOND
    width = max(1, round(imu_mounting.SMOOTHING / step))
    count = (len(stamps) - 1) // width
    if count < 20 * BLOCKS:
        return None
    speed = np.interp(stamps, tracks.stamps, tracks.speeds.mean(axis=1))
    edges = slice(0, count * width + 1, width)
    track_acceleration = np.diff(speed[edges]) / (np.diff(stamps[edges]) * NANOSECOND)
    imu_acceleration = force[: count * width, 0].reshape(count, width).mean(axis=1)
    is_known = np.isfinite(imu_acceleration)
    # Changes from one interval to the next are free of slopes and bias, which change slowly.
    by_tracks, by_imu = np.diff(track_acceleration[is_known]), np.diff(imu_acceleration[is_known])

    def slope(rows: Indexes) -> float:
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
    estimate, stated = measured_track(log, robot), robot.effective_track
    in_file = f"{stated:.2f} m"
    if estimate is None:
        yield Check(TRACK, in_file, "not seen: tracks and gyro turn too little, or not alike")
        return
    track, sigma, _ = estimate
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
