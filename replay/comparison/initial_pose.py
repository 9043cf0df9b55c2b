"""Initial pose of a run from the truth, or from fixes for a log without a truth."""

import math
from dataclasses import replace

import numpy as np
from msgspec.structs import replace as replace_setting

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import compose, relative, rotate, wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import Truth
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import FixWander, Settings, wander_of
from icreckon.estimator.streaming.run import run
from icreckon.replay.base.start import ANY_HEADING, CLEAR, EXACT_ORIGIN, SOON, Start, align_path

BEGINNING = 20.0  # least track distance over which fixes and dead reckoning are compared [m]
SIGMAS = 20.0  # least length of that distance in standard deviations of a fix [-]
TURN_SIGMA = 0.5  # standard deviation of the yaw rate before the first heading [rad/s]
LATE_TRUTH = 1.0  # time after the start of a log from which on its truth begins late [s]


def lateness(log: Log, truth: Truth) -> float:
    """Time from the start of a log to its truth [s]; 0 below `LATE_TRUTH`."""
    late = float(truth.poses.stamps[0] - log.start) * NANOSECOND
    return late if late > LATE_TRUTH else 0.0


def start_from_truth(log: Log, truth: Truth, reckoned: Trajectory | None) -> Start:
    """Find the pose of the truth at the start of a log.

    Dead reckoning leads back from the first pose of a truth that begins late; its errors are the sigmas,
    which are zero otherwise.
    """
    if reckoned is None or not lateness(log, truth):
        pose = interpolate_poses(truth.poses, np.array([log.start]))[0]
        return Start((pose.item(0), pose.item(1), pose.item(2)), (0.0, 0.0, 0.0))
    first_stamp, first_pose = truth.poses.stamps[:1], truth.poses.poses[0]
    at_first = interpolate_poses(reckoned.pose_series, first_stamp)[0]
    back = relative(at_first, reckoned.poses[0])
    x, y, yaw = compose(first_pose, back).tolist()
    row = min(int(np.searchsorted(reckoned.stamps, first_stamp[0])), len(reckoned.stamps) - 1)
    variance_x, variance_y, variance_yaw = reckoned.pose_covariances[row].diagonal().tolist()
    position_sigma = math.sqrt(variance_x + variance_y)
    return Start((x, y, yaw), (position_sigma, position_sigma, math.sqrt(variance_yaw)))


def start_from_fixes(log: Log, robot: Robot, variant: str, settings: Settings | None) -> Start:
    """Estimate the initial pose in the frame of the fixes.

    The pose is exactly the origin without fixes, or if the first fixes agree with the origin, as fixes in
    `odom` do. Otherwise the path from dead reckoning is fitted to the fixes. If neither this nor a
    measured heading gives the yaw, its variance is large, and the filter estimates it in driving.
    """
    fixes = log.fixes
    if fixes is None or not len(fixes.stamps) or not len(log.tracks.stamps):
        return EXACT_ORIGIN
    white_sigma = math.sqrt(float(np.median(fixes.variances[:, 0])))
    settings = settings or Settings()
    wander = wander_of(robot, settings)
    # Errors that wander do not average out along the path.
    distance = max(BEGINNING, SIGMAS * math.hypot(white_sigma, wander.sigma))
    # The stamp at this track distance after the first fix, or the last one.
    stamps, speed = log.tracks.stamps, np.abs(log.tracks.speeds.mean(axis=1))
    driven = np.concatenate([[0.0], np.cumsum(speed[1:] * np.diff(stamps) * NANOSECOND)])
    at_fix = float(np.interp(fixes.stamps[0], stamps, driven))
    row = int(np.searchsorted(driven, at_fix + distance))
    until = int(stamps[min(row, len(stamps) - 1)])
    without_wander = replace_setting(settings, wander=FixWander())
    # Only the tracks and the IMU.
    beginning = replace(log.between(log.start, until), fixes=None, truth=None, others=())
    path = run(beginning, robot, variant, settings=without_wander).trajectory.pose_series
    used = (fixes.stamps >= path.stamps[0]) & (fixes.stamps <= min(until, path.stamps[-1]))
    if not used.any():
        return EXACT_ORIGIN
    poses = interpolate_poses(path, fixes.stamps[used])
    # Positions (n, 2) of the antenna by dead reckoning from the origin, and by the fixes.
    reckoned = poses[:, :2] + rotate(fixes.lever_arms[used, :2], poses[:, 2])
    measured = fixes.poses[used, :2]
    sigma = wander.at_start(white_sigma)
    start = align_path(reckoned, measured, white_sigma, wander)
    heading = _first_heading(log)
    if heading is not None:
        yaw, yaw_sigma = heading
        if start is None or yaw_sigma < start.yaw_sigma:
            x, y = (measured[0] - rotate(reckoned[0], yaw)).tolist()
            position_sigma = sigma + yaw_sigma * float(np.hypot(*reckoned[0]))
            start = Start((x, y, yaw), (position_sigma, position_sigma, yaw_sigma))
    if start is None:
        position_sigma = sigma + float(np.hypot(*reckoned[0]))
        x, y = measured[0].tolist()
        if not wander.sigma and math.hypot(x, y) <= CLEAR * position_sigma:
            return EXACT_ORIGIN
        return Start((x, y, 0.0), (position_sigma, position_sigma, ANY_HEADING))
    if wander.sigma:
        # Fixes that wander are of a map, not of odom.
        return start
    agrees_with_origin = (np.abs(start.pose) / np.array(start.sigma) <= CLEAR).all()
    return EXACT_ORIGIN if agrees_with_origin else start


def _first_heading(log: Log) -> tuple[float, float] | None:
    """Initial yaw and its sigma [rad] by the first heading; None if missing or late."""
    others = [other for other in log.others if isinstance(other, HeadingFix)]
    headings = [(other.stamp, other.yaw, other.variance) for other in others[:1]]
    fixes = log.fixes
    if fixes is not None:
        for row in np.flatnonzero(np.isfinite(fixes.poses[:, 2]))[:1]:
            yaw, variance = float(fixes.poses[row, 2]), float(fixes.variances[row, 1])
            headings.append((int(fixes.stamps[row]), yaw, variance))
    if not headings:
        return None
    stamp, yaw, variance = min(headings)
    wait = max(0.0, (stamp - log.start) * NANOSECOND)
    if wait > SOON:
        return None
    return float(wrap_angle(yaw)), math.sqrt(variance) + TURN_SIGMA * wait
