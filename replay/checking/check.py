"""Record of a check, correction of a log or a robot, and the IMU in base_link."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
from msgspec.structs import replace as replace_of

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import relative
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import even_grid, interpolate_poses
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries, Truth
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.estimates import imu_mounting
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.latency import truth_lag, with_truth_in_time
from icreckon.replay.estimates.wheels import LARGEST_TURNING, Estimate, wheel_estimates
from icreckon.replay.mapping.topics import topic_map

SIGMAS = 3.0  # standard errors from which a difference is significant
MOUNTING, FORWARD = "tilt of the IMU", "forward axis of the IMU"
SCALE, TRACK, LATENCY = "scale of the tracks", "effective track", "latency of the tracks"
NEARLY_STRAIGHT = 0.2  # largest turning of a window in which tracks hardly slip [rad]

Correction = Callable[[Log, Robot], tuple[Log, Robot]]
Settings = dict[str, float | list[float]]


class Measured(NamedTuple):
    """Quantity measured from a log."""

    value: float  # the estimate
    unit: str  # "m", "s", ...; "-" for none
    expected: float | None = None  # value by the robot file, None if the file has none
    sigma: float | None = None  # standard error of the estimate, None if unknown


@dataclass(frozen=True)
class Check:
    """One quantity of a robot file, compared with a log."""

    name: str  # the quantity
    in_file: str  # value of the file, with its unit
    in_log: str  # value that the log shows, with its unit and error; empty if it shows none
    problem: str = ""  # contradiction, in a sentence; empty if there is none
    remedy: str = ""  # what to set in the file
    correction: Correction | None = None  # function that corrects log and robot, None if none can
    measured: Measured | None = None  # numbers of `in_file` and `in_log`, None if unknown
    # values to set in the robot file by dotted key, such as "log.tracks.latency"; empty if no single
    # key corrects it
    settings: Settings = field(default_factory=dict)

    def contradicted(
        self,
        problem: str,
        remedy: str,
        correction: Correction | None = None,
        settings: Settings | None = None,
    ) -> Self:
        """Copy as a contradiction of the file; arguments as the attributes."""
        return replace(
            self, problem=problem, remedy=remedy, correction=correction, settings=settings or {}
        )


def corrected(log: Log, robot: Robot, checks: Iterable[Check]) -> tuple[Log, Robot]:
    """Apply the corrections of checks, one after the other; skip checks without one."""
    for check in checks:
        if check.correction is not None:
            log, robot = check.correction(log, robot)
    return log, robot


def imu_yaw_rates(imu: ImuSeries, robot: Robot) -> YawRates:
    """Rates about the vertical of base_link, by the mounting in the robot file."""
    upward = robot.imu_rotation[2]
    rates = imu_mounting.rate_about(upward, imu.angular_velocity, robot.imu.gyro_axes)
    return YawRates(imu.stamps, rates)


def force_in_base(imu: ImuSeries, robot: Robot) -> Floats | None:
    """Specific force (n, 3) in base_link [m/s²], None without accelerometers."""
    force = imu.linear_acceleration
    return None if force is None else np.asarray(force @ robot.imu_rotation.T)


def comparable_yaw_rates(log: Log, robot: Robot) -> YawRates | None:
    """Yaw rates to compare with tracks; None without an IMU or usable track speeds."""
    if log.imu is None or not imu_mounting.are_usable(log.tracks):
        return None
    return imu_yaw_rates(log.imu, robot)


def has_track_rates(robot: Robot) -> bool:
    """True if the track speeds of a robot's logs are rates, multiplied by its radius."""
    return topic_map(robot).in_rates if robot.log else True


def mapped_table(robot: Robot, stream: str) -> str:
    """Table of a robot file that maps a stream, as "log.tracks"."""
    only_columns = "columns" in robot.log and stream not in robot.log
    return f"log.columns.{stream}" if only_columns else f"log.{stream}"


def with_imu(**values: object) -> Correction:
    """Correction that sets keys of the robot's [imu] to values."""
    return lambda log, robot: (log, replace_of(robot, imu=replace_of(robot.imu, **values)))


def with_speeds(change: Callable[[Floats], Floats]) -> Correction:
    """Correction that changes the log's track speeds (n, 2)."""
    return lambda log, robot: (replaced_speeds(log, change(log.tracks.speeds)), robot)


def replaced_speeds(log: Log, speeds: Floats) -> Log:
    """Log with other track speeds (n, 2) [m/s], without those of wheels."""
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps, speeds))


def measured_track(log: Log, robot: Robot) -> Estimate | None:
    """Effective track by gyro and tracks [m]; None if they turn too little."""
    yaw_rates = comparable_yaw_rates(log, robot)
    if yaw_rates is None:
        return None
    correlation = imu_mounting.turning_correlation(log.tracks, yaw_rates)
    return wheel_estimates(log, yaw_rates, correlation).track


def measured_scale(log: Log, robot: Robot, *, with_bends: bool = False) -> Estimate | None:
    """Distance by truth or fixes over that of the tracks [-]; None if not observable.

    Windows in which tracks slip in a bend count only with `with_bends`.
    """
    yaw_rates = comparable_yaw_rates(log, robot)
    if yaw_rates is None or log.imu is None:
        return None
    most_turning = LARGEST_TURNING if with_bends else NEARLY_STRAIGHT
    if log.truth is not None:
        log = with_truth_in_time(log, truth_lag(log.truth, log.tracks, log.imu, yaw_rates))
    return wheel_estimates(log, yaw_rates, None, most_turning).distance


def true_motion(log: Log, truth: Truth, window: float) -> tuple[Stamps, Floats] | None:
    """Motion of a truth in windows [s]; None if it is too short.

    Returns the stamps (n + 1,) between the windows [ns], and the pose (n, 3) at the end of each window,
    relative to the pose at its start [m, m, rad].
    """
    known = truth.poses.stamps
    start, end = max(known[0], log.start), min(known[-1], log.end)
    edges = even_grid(start, end, round(window / NANOSECOND), known)
    if len(edges) < 2:
        return None
    poses = interpolate_poses(truth.poses, edges)
    return edges, relative(poses[:-1], poses[1:])
