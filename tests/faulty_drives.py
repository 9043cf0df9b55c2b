"""Simulated drives with one fault, and the motion over it, for the tests of faults."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from icreckon import Health, Log, PoseEstimator, Robot, Run, Scenario, simulate
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import relative, wrap_angle
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import TrackSpeedSeries

SECOND = 1_000_000_000
BEGINS, RESTS, AFTER = 30.0, 2.8, 1.0
"""When faults begin, while driving and at rest, and time for which the motion goes on after them [s]."""
EXCESS = 0.8
"""Speed of a free track or wheel beyond the ground's [m/s]."""
OWN_ERROR, LAG = 0.03, 0.02
"""Error of each wheel of a side [-], lag of the rear one [s]."""
VARIANTS = ("gyro", "constant-online", "inertia-online")
Change = Callable[[Floats], Floats]


def drive(robot: Robot, seed: int, duration: float = 48.0) -> Log:
    """Everyday driving with friction as the truth, without fixes and faults."""
    return simulate(
        Scenario(duration=duration, seed=seed, trajectory="random", fix_rate=0.0), robot
    )


def with_rates(log: Log, lasts: float, change: Change, begins: float = BEGINS) -> Log:
    """Copy of a log whose yaw rates are changed while a fault lasts."""
    imu = log.imu
    rates, hit = imu.angular_velocity.copy(), _within(log, imu.stamps, lasts, begins)
    rates[hit, 2] = change(rates[hit, 2])
    return replace(log, imu=replace(imu, angular_velocity=rates))


def with_tracks(log: Log, lasts: float, change: Change, begins: float = BEGINS) -> Log:
    """Copy of a log whose track speeds are changed while a fault lasts."""
    stamps, speeds = log.tracks.stamps, log.tracks.speeds.copy()
    hit = _within(log, stamps, lasts, begins)
    speeds[hit] = change(speeds[hit])
    return replace(log, tracks=TrackSpeedSeries(stamps, speeds))


def _within(log: Log, stamps: np.ndarray, lasts: float, begins: float) -> np.ndarray:
    since = (stamps - log.start) * NANOSECOND - begins
    return np.asarray((since >= 0.0) & (since < lasts))


def with_free_track(log: Log, lasts: float = 3.0) -> Log:
    """The log whose left track spins."""
    return with_tracks(log, lasts, lambda speeds: speeds + np.array([EXCESS, 0.0]))


def with_free_tracks(log: Log) -> Log:
    """The log both of whose tracks spin by 1.2 m/s for 3 s; they speed up and slow down in 0.2 s."""
    times = (log.tracks.stamps - log.start) * NANOSECOND - BEGINS
    share = np.interp(times, [0.0, 0.2, 3.0, 3.2], [0.0, 1.0, 1.0, 0.0])
    speeds = log.tracks.speeds + 1.2 * share[:, None]
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, speeds))


def with_wheels(log: Log, count: int, seed: int = 0) -> Log:
    """The log with so many wheels at each side, each with an error of its own; the rear one is late."""
    rng, stamps = np.random.default_rng(seed), log.tracks.stamps
    times = (stamps - stamps[0]) * NANOSECOND
    sides = []
    for speeds in log.tracks.speeds.T:
        wheels = [
            np.interp(times - LAG * k / (count - 1), times, speeds)
            * (1.0 + OWN_ERROR * rng.standard_normal(len(times)))
            for k in range(count)
        ]
        sides.append(np.column_stack(wheels))
    return _of_wheels(log, sides)


def _of_wheels(log: Log, sides: Sequence[Floats]) -> Log:
    means = np.column_stack([side.mean(axis=1) for side in sides])
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, means, *sides))


def with_free_wheel(log: Log, begins: float = BEGINS) -> Log:
    """The log of a robot with wheels, whose foremost left one spins."""
    left = log.tracks.left_wheels.copy()
    left[_within(log, log.tracks.stamps, 3.0, begins), 0] += EXCESS
    return _of_wheels(log, (left, log.tracks.right_wheels))


def rotated(angle: float) -> Floats:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def errors(one: Run, log: Log) -> tuple[Floats, Floats, Floats]:
    """Seconds, and errors of position [m] and yaw [rad], of the rows of a run."""
    off = one.states[:, :3] - interpolate_poses(log.truth.poses, one.stamps)
    seconds = (one.stamps - log.start) * NANOSECOND
    return seconds, np.hypot(off[:, 0], off[:, 1]), np.abs(wrap_angle(off[:, 2]))


class Motion(NamedTuple):
    """Motion over a fault."""

    error: float
    sigma: float
    yaw: float
    yaw_sigma: float
    delay: float


def motion_over(
    log: Log,
    robot: Robot,
    variant: str,
    shown: Callable[[Health], bool],
    lasts: float = 3.0,
    begins: float = BEGINS,
) -> Motion:
    """Run a variant up to a second after a fault; score the motion since its begin."""
    estimator, delay = PoseEstimator(robot, variant), float("nan")
    begin = log.start + round(begins * SECOND)
    end = begin + round((lasts + AFTER) * SECOND)
    for measurement in log.measurements():
        if measurement.stamp > end:
            break
        estimator.feed(measurement)
        if estimator.stamp == begin and begin not in estimator.marks:
            estimator.mark(begin)
        if measurement.stamp > begin and delay != delay and shown(estimator.health):
            delay = (measurement.stamp - begin) * NANOSECOND
    found = estimator.relative_motion(begin)
    true = interpolate_poses(log.truth.poses, np.array([begin, end]))
    error, P = found.pose - relative(true[0], true[1]), found.covariance
    return Motion(
        float(np.hypot(*error[:2])),
        float(np.sqrt(np.trace(P[:2, :2]))),
        abs(float(wrap_angle(error[2]))),
        float(np.sqrt(P[2, 2])),
        delay,
    )
