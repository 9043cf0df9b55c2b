"""Effective track, scale and true motion, measured on a log."""

from __future__ import annotations

from typing import NamedTuple

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import relative
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import even_grid, interpolate_poses
from icreckon.estimator.log.series import Truth
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.check import in_base
from icreckon.replay.inspection.imu_mounting import are_usable, turning_correlation
from icreckon.replay.inspection.wheels import STRAIGHT as BENDS
from icreckon.replay.inspection.wheels import wheel_estimates

# Turning of a window that hardly slips [rad].
STRAIGHT = 0.2


class Scale(NamedTuple):
    """Scale of the track speeds."""

    ratio: float  # distance over ground over that of the tracks [-]
    sigma: float | None  # its standard error, None if unknown
    source: str  # source of the distance over ground, "truth" or "fixes"


class TrueMotion(NamedTuple):
    """Motion of a truth in windows of equal length."""

    edges: Stamps  # (n + 1,) stamps of their starts and ends [ns]
    moved: Floats  # (n, 3) pose at the end of each in that at its start [m, m, rad]


def effective_track(robot: Robot) -> float:
    """Effective track of a robot file, with constant ICRs [m]."""
    return robot.constant_indices.eta0 * robot.vehicle.track_gauge


def measured_track(log: Log, robot: Robot) -> tuple[float, float | None] | None:
    """Effective track by gyro and tracks, and its standard error or None [m].

    None if they turn too little.
    """
    if log.imu is None or not are_usable(log.tracks):
        return None
    vertical = in_base(log.imu, robot)[0]
    correlation = turning_correlation(log.tracks, log.imu, vertical)
    found = wheel_estimates(log, vertical, correlation)
    return None if found.track_ratio is None else (found.track_ratio, found.track_sigma)


def measured_scale(log: Log, robot: Robot, *, bends: bool = False) -> Scale | None:
    """Scale of the track speeds by truth or fixes; None if they do not show it.

    Args:
        log: the log.
        robot: the robot.
        bends: whether windows with bends count, too, in which tracks slip.
    """
    if log.imu is None or not are_usable(log.tracks):
        return None
    vertical = in_base(log.imu, robot)[0]
    found = wheel_estimates(log, vertical, None, BENDS if bends else STRAIGHT)
    if found.way_ratio is None:
        return None
    return Scale(found.way_ratio, found.way_sigma, found.way_source)


def true_motion(log: Log, truth: Truth, window: float) -> TrueMotion | None:
    """Motion of a truth in windows [s]; None if it is too short."""
    edges = even_grid(
        max(truth.poses.stamps[0], log.start),
        min(truth.poses.stamps[-1], log.end),
        round(window / NANOSECOND),
        truth.poses.stamps,
    )
    if len(edges) < 2:
        return None
    poses = interpolate_poses(truth.poses, edges)
    return TrueMotion(edges, relative(poses[:-1], poses[1:]))
