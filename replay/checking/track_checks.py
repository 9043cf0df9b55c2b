"""Checks of the tracks in a robot file: sense, latency, scale, effective track."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.lag_search import BLOCKS
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
    Measured,
    effective_track,
    in_base,
    in_rates_of,
    mapped_tracks,
    measured_scale,
    measured_track,
    tracks_table,
    true_motion,
    with_speeds,
)
from icreckon.replay.inspection import imu_mounting
from icreckon.replay.inspection.latency import objection, track_latency
from icreckon.replay.inspection.wheels import DEGREES, jackknifed, turning_suspicion
from icreckon.replay.mapping.topics import TrackTopic

# Error of a scale that counts in any case, in straight windows and in bends [-]: ground and slip change
# the distance by as much.
LEAST_SCALE, LEAST_IN_BENDS = 0.03, 0.1
# Factor between the effective tracks of the file and of the log that ground and steady bends do not
# explain [-], and latency that is usual [s]: robots turn up to 0.06 s later than their tracks.
OTHER_TRACK = 1.4
LEAST_LATENCY = 0.07
# Least error of the scale by the accelerometer that is reported [-]: suspensions squat.
SCALE_BY_FORCE = 0.35
# Usual errors of a scale, as true over assumed.
USUAL_ERRORS = (
    (0.5, "is the radius a diameter?"),
    (2.0, "is the radius half of what it should be?"),
    (0.001, "is a length or a speed in mm?"),
    (0.01, "is a length or a speed in cm?"),
    (1000.0, "is the truth in mm?"),
    (100.0, "is the truth in cm?"),
    (1.0 / 3.6, "are the speeds in km/h?"),
    (0.44704, "are the speeds in mph?"),
    (2.0 * math.pi, "are the rates in turns per second?"),
    (math.pi / 30.0, "are the rates in rpm?"),
    (math.pi / 180.0, "are the rates in deg/s?"),
)
OF_COUNTS = "is counts_per_turn off by that (lines or edges, gears), or the radius a diameter?"
BACKWARD_WINDOW = 0.5  # windows in which driving backward is looked for [s]
USUAL_ERROR = 0.05  # largest relative distance from a usual error [-]
PLAUSIBLE = (3e-4, 3e3)  # scales that are a matter of units at all [-]
# Fewest samples of a gyro that reads one value, and turning of the tracks that a gyro must show [rad/s].
FEWEST, CLEARLY_TURNS = 20, 0.05


def check_turning(log: Log, robot: Robot) -> Iterator[Check]:
    """Unit of the gyro, and its sense of rotation against that of the tracks."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return
    vertical, force = in_base(log.imu, robot)
    turning = float(np.ptp(log.tracks.speeds, axis=1).mean()) / effective_track(robot)
    if len(vertical) > FEWEST and np.ptp(vertical) == 0.0 and turning > CLEARLY_TURNS:
        yield Check(
            "gyro",
            "shows turns",
            f"reads {vertical[0]:.4g} rad/s all the time",
            "the gyro reads one value all the time, and the tracks turn",
            "look at its driver and cable; gyro_axes in [imu] if only one axis is logged",
        )
        return
    correlation = imu_mounting.turning_correlation(log.tracks, log.imu, vertical)
    shown = "nothing turns" if correlation is None else f"correlation {correlation:.2f}"
    found = Check("sense of turning", "left is positive", shown)
    if correlation is None or abs(correlation) < imu_mounting.CLEAR_TURNING:
        found = replace(found, in_log=shown if correlation is None else f"{shown}: unclear")
        tracks = mapped_tracks(robot)
        if isinstance(tracks, TrackTopic) and not tracks.left:
            gauge = tracks.gauge or robot.vehicle.track_gauge
            if off := turning_suspicion(log, vertical, gauge):
                remedy = "gauge in [log.tracks], which is that of its controller, or its yaw rate"
                found = found.contradicted(off[0], remedy)
        elif (reversed_side := _reversed_side(log.tracks, log.imu, vertical)) is not None:
            side, signs = reversed_side
            found = found.contradicted(
                f"the {side} side counts backward: the robot turns as the sum of both sides",
                f'a minus before the names of {side} in [{tracks_table(robot)}], as "-motor"',
                with_speeds(lambda speeds: speeds * signs),
            )
        yield found
        return
    turned = log.tracks.speeds[:, 1] - log.tracks.speeds[:, 0]
    difference = float(turned.std()) / effective_track(robot)
    ratio = float(vertical.std()) / difference if difference else 0.0
    if DEGREES[0] < ratio < DEGREES[1]:
        yield Check(
            "unit of the gyro",
            "rad/s",
            f"{ratio:.0f} times the tracks' turning",
            f"the gyro reads {ratio:.0f} times what the tracks turn: it is in deg/s",
            'rate_unit = "deg/s" in [log.imu]',
            _in_radians,
            Measured(ratio, "-", 1.0),
        )
    found = replace(found, measured=Measured(correlation, "-", 1.0))
    backward = _drives_backward(log)
    if correlation > 0.0 and not backward:
        yield found
        return
    minus = 'with a minus before each name, as "-motor"'
    table = tracks_table(robot)
    exchange = f"exchange left and right in [{table}]"
    if "right_topic" in robot.log.get("tracks", {}):
        exchange = "exchange topic and right_topic in [log.tracks]"
    if correlation > 0.0:
        text = "the tracks drive backward where the truth drives forward, and turn as the gyro does"
        remedy = f"{exchange}, {minus}"
        correction = with_speeds(lambda speeds: -speeds[:, ::-1])
    elif backward or (
        backward is None and _accelerates_backward(log.tracks, log.imu, vertical, force)
    ):
        text = "both tracks count backward: they turn the other way than the gyro"
        remedy = f"left and right in [{table}] {minus}"
        correction = with_speeds(lambda speeds: -speeds)
        if backward is None:
            text += " and accelerate the other way than the IMU"
            remedy += " (or left and right are swapped, and the IMU is turned by 180 deg)"
    else:
        text = "left and right are swapped: the tracks turn the other way than the gyro"
        remedy = f"{exchange} (or the gyro's z axis points down)"
        correction = with_speeds(lambda speeds: speeds[:, ::-1].copy())
    yield found.contradicted(text, remedy, correction)


def _reversed_side(
    tracks: TrackSpeedSeries, imu: ImuSeries, vertical: Floats
) -> tuple[str, Floats] | None:
    """Side that counts backward, and the signs (2,) that correct it; None if unclear."""
    signs = np.array([1.0, -1.0])
    mirrored = TrackSpeedSeries(tracks.stamps, tracks.speeds * signs)
    by_sum = imu_mounting.turning_correlation(mirrored, imu, vertical)
    if by_sum is None or abs(by_sum) < imu_mounting.CLEAR_TURNING:
        return None
    return ("right", signs) if by_sum > 0.0 else ("left", -signs)


def _accelerates_backward(
    tracks: TrackSpeedSeries, imu: ImuSeries, vertical: Floats, force: Floats | None
) -> bool:
    """True if the IMU accelerates backward where the tracks speed up."""
    if force is None:
        return False
    yaw = imu_mounting.forward_yaw(tracks, imu.stamps, np.nan_to_num(force[:, :2]), vertical)
    return yaw is not None and abs(yaw) == 180.0


def _drives_backward(log: Log) -> bool | None:
    """True if tracks drive backward where the truth drives forward; None if unknown."""
    truth = log.truth
    if truth is None or not truth.headings:
        return None
    motion = true_motion(log, truth, BACKWARD_WINDOW)
    if motion is None:
        return None
    edges, ahead = motion[0], motion[1][:, 0]
    speed = np.interp(
        0.5 * (edges[1:] + edges[:-1]), log.tracks.stamps, log.tracks.speeds.mean(axis=1)
    )
    size = float(np.linalg.norm(ahead) * np.linalg.norm(speed))
    if size == 0.0:
        return None
    agreement = float(ahead @ speed) / size
    return agreement < 0.0 if abs(agreement) > imu_mounting.CLEAR_TURNING else None


def _in_radians(log: Log, robot: Robot) -> tuple[Log, Robot]:
    assert log.imu is not None  # noqa: S101 - checked by the caller
    rates = np.radians(log.imu.angular_velocity)
    return replace(log, imu=replace(log.imu, angular_velocity=rates)), robot


def check_latency(log: Log, robot: Robot) -> Iterator[Check]:
    """Latency of the track speeds against the gyro, beyond that of the file."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return
    late = track_latency(log.tracks, log.imu, in_base(log.imu, robot)[0])
    if not isinstance(late, Lag):
        yield Check(LATENCY, "", f"not seen: {late.reason}")
        return
    mapped = mapped_tracks(robot)
    of_file = 0.0 if mapped is None else mapped.latency
    stated = f"{of_file:g} s"
    measured = Measured(of_file + late.seconds, "s", of_file, late.sigma)
    shown = f"{of_file + late.seconds:.3f} ± {late.sigma:.3f} s after the gyro"
    found = Check(LATENCY, stated, shown, measured=measured)
    if objection(late) or abs(late.seconds) <= max(LEAST_LATENCY, SIGMAS * late.sigma):
        if abs(late.seconds) > SIGMAS * late.sigma:
            found = replace(found, in_log=f"{shown}; counts from {LEAST_LATENCY:g} s on")
        yield found
        return
    by = late.seconds
    word = "late" if by > 0.0 else "early"

    def shifted(log: Log, robot: Robot) -> tuple[Log, Robot]:
        stamps = log.tracks.stamps - round(by / NANOSECOND)
        return replace(log, tracks=TrackSpeedSeries(stamps, log.tracks.speeds)), robot

    yield found.contradicted(
        f"track speeds are stamped {abs(by):.2f} s {word} against the gyro, ± {late.sigma:.3f} s",
        f"add {by:+.2f} to latency in [{tracks_table(robot)}]",
        shifted,
        {f"{tracks_table(robot)}.latency": round(of_file + by, 2)},
    )


def check_scale(log: Log, robot: Robot) -> Iterator[Check]:
    """Scale of the track speeds, by truth, fixes or the accelerometer."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return
    least, seen = LEAST_SCALE, measured_scale(log, robot)
    if seen is None:
        least, seen = LEAST_IN_BENDS, measured_scale(log, robot, bends=True)
    if seen is not None:
        ratio, sigma, source = seen
    elif (by_force := _scale_by_force(log.tracks, log.imu, robot)) is not None:
        ratio, sigma, source, least = *by_force, "accelerometer", SCALE_BY_FORCE
    else:
        yield Check(SCALE, "1", "not seen: no truth, no fixes")
        return
    if source != "accelerometer":
        least = max(least, SIGMAS * robot.tracks.scale_sigma)
    error = "" if sigma is None else f" ± {sigma:.3f}"
    shown = f"{ratio:.3f}{error}, {source} over tracks"
    if sigma is None:
        shown += " (too few straight stretches to tell its error)"
    table, name, of_file = "vehicle", "sprocket_radius", robot.vehicle.sprocket_radius
    if not in_rates_of(robot) and (tracks := mapped_tracks(robot)) is not None:
        table, name, of_file = tracks_table(robot), "scale", tracks.scale
    value = float(f"{ratio * of_file:.4g}")
    found = Check(SCALE, "1", shown, measured=Measured(ratio, "-", 1.0, sigma))
    if not PLAUSIBLE[0] < ratio < PLAUSIBLE[1]:
        yield found.contradicted(
            f"the {source} moves {ratio:.3g} times as far as the tracks: one of them shows no motion, or "
            "they are in units that nobody uses",
            "look at both; a receiver without a fix may repeat one position",
        )
        return
    if abs(ratio - 1.0) <= max(least, SIGMAS * (sigma or 0.0)) and 0.5 < ratio < 2.0:
        if abs(ratio - 1.0) > LEAST_SCALE:
            shown += f"; counts from {least:.0%} on, {name} = {value:.3g} would fit"
        yield replace(found, in_log=shown)
        return
    text = f"the {source} moves {ratio:.3g}{error} times as far as the tracks{_guess(ratio, robot)}"
    if source == "accelerometer":
        text = (
            f"accelerations are {ratio:.3g}{error} times the changes of the track speeds (suspensions "
            "explain 1.2)"
        )
    yield found.contradicted(
        text,
        f"{name} = {value:g} in [{table}]",
        with_speeds(lambda speeds: ratio * speeds),
        {f"{table}.{name}": value},
    )


def _guess(ratio: float, robot: Robot) -> str:
    """Question after the usual error next to a scale, true over assumed."""
    radius = robot.vehicle.sprocket_radius
    of_radius = (
        (1.0 / radius, "are they m/s, read as rates in rad/s?")
        if in_rates_of(robot)
        else (radius, "are they rates in rad/s, read as m/s?")
    )
    usual, tracks = [*USUAL_ERRORS, of_radius], mapped_tracks(robot)
    if tracks is not None and tracks.unit == "counts":
        usual[:2] = [(size, OF_COUNTS) for size in (0.25, 0.5, 2.0, 4.0)]
    off, question = min((abs(math.log(ratio / size)), text) for size, text in usual)
    return f": {question}" if off < USUAL_ERROR else ""


def _scale_by_force(
    tracks: TrackSpeedSeries, imu: ImuSeries, robot: Robot
) -> tuple[float, float] | None:
    """Scale by forward acceleration over the change of track speed, and its error."""
    stamps, force = imu.stamps, in_base(imu, robot)[1]
    if force is None:
        return None
    step = float(np.median(np.diff(stamps))) * NANOSECOND
    width = max(1, round(imu_mounting.SMOOTHING / step))
    count = (len(stamps) - 1) // width
    if count < 20 * BLOCKS:
        return None
    speed = np.interp(stamps, tracks.stamps, tracks.speeds.mean(axis=1))
    edges = speed[: count * width + 1 : width]
    change = np.diff(edges) / (np.diff(stamps[: count * width + 1 : width]) * NANOSECOND)
    forward = force[: count * width, 0].reshape(count, width).mean(axis=1)
    fine = np.isfinite(forward)
    # Differences of neighbours: slopes and bias change slowly.
    change, forward = np.diff(change[fine]), np.diff(forward[fine])

    def slope(where: NDArray[np.int_]) -> float:
        x, y = change[where], forward[where]
        return float(x @ y / (x @ x))

    if not change.any():
        return None
    ratio, sigma = jackknifed(slope, len(change))
    return (ratio, sigma) if ratio > 0.0 and sigma < 0.1 * ratio else None


def is_other_track(ratio: float) -> bool:
    """Return True if a ratio of effective tracks, log over file, is a contradiction."""
    return not 1.0 / OTHER_TRACK < ratio < OTHER_TRACK


def check_track(log: Log, robot: Robot) -> Iterator[Check]:
    """Effective track, by gyro and tracks."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return
    found = measured_track(log, robot)
    in_file = effective_track(robot)
    if found is None:
        yield Check(
            TRACK, f"{in_file:.2f} m", "not seen: tracks and gyro turn too little, or not alike"
        )
        return
    track, sigma = found
    ratio = track / in_file
    error = "" if sigma is None else f" ± {sigma:.1g}"
    shown = f"{track:.2f}{error} m by the gyro, {ratio:.2f} times"
    check = Check(TRACK, f"{in_file:.2f} m", shown, measured=Measured(track, "m", in_file, sigma))
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
    keys, also = _keys_of_track(robot, round(eta0, 2)), ""
    if robot.constant_icr is not None:
        left, right = keys["constant_icr.x_ICRl"], keys["constant_icr.x_ICRr"]
        also = f" and x_ICRl = {left}, x_ICRr = {right} in [constant_icr]"
    yield check.contradicted(
        f"the effective track is {track:.2f} m by the gyro, {ratio:.2f} times that of the file: wheel "
        f"odometry turns {ratio:.2f} times as far as the robot",
        f"eta0 = {eta0:.2f} in [indices]{also}, or calibrate; where sprocket_radius is "
        "wrong, this is, too",
        lambda log, robot: (log, _with_track(robot, gauge, eta0)),
        keys,
    )


def _keys_of_track(robot: Robot, eta0: float) -> dict[str, float | list[float]]:
    """Keys of a robot file that state the effective track, for a new one."""
    keys: dict[str, float | list[float]] = {"indices.eta0": eta0}
    icr = robot.constant_icr
    if icr is not None:
        middle, half = 0.5 * (icr.x_ICRl + icr.x_ICRr), 0.5 * eta0 * robot.vehicle.track_gauge
        keys["constant_icr.x_ICRl"] = round(middle - half, 4)
        keys["constant_icr.x_ICRr"] = round(middle + half, 4)
        keys["constant_icr.y_ICR"] = icr.y_ICR
    return keys


def _with_track(robot: Robot, gauge: float, eta0: float) -> Robot:
    return structs.replace(
        robot,
        vehicle=structs.replace(robot.vehicle, track_gauge=gauge),
        indices=structs.replace(robot.indices, eta0=eta0),
        constant_icr=None,
    )
