"""Initial pose of a run from fixes, for a log without a truth."""

import math
from dataclasses import replace

import numpy as np
from msgspec.structs import replace as replace_setting

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import rotate, wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import FixWander, Settings, wander_of
from icreckon.estimator.streaming.run import run
from icreckon.replay.base.start import ANY_HEADING, CLEAR, SOON, Start, laid_over

BEGINNING = 20.0
"""Track distance over which fixes and dead reckoning are compared [m]; longer for rough fixes."""
SIGMAS = 20.0
"""Least length of that distance in standard deviations of a fix [-]."""
TURN_SIGMA = 0.5
"""Standard deviation of the yaw rate between the start and the first heading [rad/s]."""

EXACT_ORIGIN = Start((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def start_from_fixes(log: Log, robot: Robot, variant: str, settings: Settings | None) -> Start:
    """Estimate the initial pose in the frame of the fixes.

    It is exactly the origin if the first fixes agree with it and do not wander, as fixes in `odom`.
    Otherwise the path from dead reckoning is fitted to the fixes; a more certain heading fix replaces
    the fitted yaw. If neither gives the yaw, its sigma is large, and the filter estimates it in motion.
    """
    fixes = log.fixes
    if fixes is None or not len(fixes.stamps) or not len(log.tracks.stamps):
        return EXACT_ORIGIN
    white = math.sqrt(float(np.median(fixes.variances[:, 0])))
    settings = settings or Settings()
    wander = wander_of(robot, settings)
    # Errors that wander do not average out along the path.
    until = _stamp_at_distance(log, max(BEGINNING, SIGMAS * math.hypot(white, wander.sigma)))
    alone = replace_setting(settings, wander=FixWander())
    path = run(_beginning(log, until), robot, variant, settings=alone).trajectory.pose_series
    used = (fixes.stamps <= until) & (fixes.stamps >= path.stamps[0])
    used &= fixes.stamps <= path.stamps[-1]
    if not used.any():
        return EXACT_ORIGIN
    poses = interpolate_poses(path, fixes.stamps[used])
    reckoned = poses[:, :2] + rotate(fixes.lever_arms[used], poses[:, 2])
    places = fixes.poses[used, :2]
    sigma = wander.at_start(white)
    start = laid_over(reckoned, places, math.hypot(white, math.sqrt(len(places)) * wander.sigma))
    if start is not None and wander.sigma:
        wide = sigma + start.sigma[2] * float(np.hypot(*reckoned.mean(axis=0)))
        start = start._replace(sigma=(wide, wide, start.sigma[2]))
    heading = _first_heading(log)
    if heading is not None and (start is None or heading[1] < start.sigma[2]):
        first = places[0] - rotate(reckoned[0], heading[0])
        wide = sigma + heading[1] * float(np.hypot(*reckoned[0]))
        start = Start((float(first[0]), float(first[1]), heading[0]), (wide, wide, heading[1]))
    if start is None:
        wide = sigma + float(np.hypot(*reckoned[0]))
        x, y = places[0].tolist()
        if not wander.sigma and math.hypot(x, y) <= CLEAR * wide:
            return EXACT_ORIGIN
        return Start((x, y, 0.0), (wide, wide, ANY_HEADING))
    if wander.sigma:
        # Fixes that wander are of a map, not of odom.
        return start
    off = np.abs(start.pose) / np.array(start.sigma)
    return EXACT_ORIGIN if (off <= CLEAR).all() else start


def _stamp_at_distance(log: Log, distance: float) -> int:
    """Stamp [ns] at a track distance [m] after the first fix, or the last stamp."""
    stamps, speed = log.tracks.stamps, np.abs(log.tracks.speeds.mean(axis=1))
    travelled = np.concatenate([[0.0], np.cumsum(speed[1:] * np.diff(stamps) * NANOSECOND)])
    before = 0.0 if log.fixes is None else float(np.interp(log.fixes.stamps[0], stamps, travelled))
    return int(stamps[min(int(np.searchsorted(travelled, before + distance)), len(stamps) - 1)])


def _beginning(log: Log, until: int) -> Log:
    """Log of only the tracks and the IMU up to a stamp [ns]."""
    beginning = log.between(log.start, until)
    return replace(beginning, fixes=None, truth=None, others=())


def _first_heading(log: Log) -> tuple[float, float] | None:
    """First measured yaw and its sigma [rad] at the start; None if it comes too late."""
    found = [
        (other.stamp, other.yaw, other.variance)
        for other in log.others
        if isinstance(other, HeadingFix)
    ][:1]
    if log.fixes is not None:
        first = np.flatnonzero(np.isfinite(log.fixes.poses[:, 2]))[:1]
        found += [
            (int(log.fixes.stamps[at]), float(log.fixes.poses[at, 2]), float(variance))
            for at, variance in zip(first, log.fixes.variances[first, 1], strict=True)
        ]
    if not found:
        return None
    stamp, yaw, variance = min(found)
    wait = max(0.0, (stamp - log.start) * NANOSECOND)
    if wait > SOON:
        return None
    return float(wrap_angle(yaw)), math.sqrt(variance) + TURN_SIGMA * wait
