"""Motion over a fault of a simulated drive: its error, own standard deviation, and when it is shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import relative
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.streaming.pose_estimator import PoseEstimator


class Motion(NamedTuple):
    """Error of the motion over a fault and its own standard deviation [m]; delay [s] or NaN.

    The delay is that until `health` shows the fault.
    """

    error: float
    sigma: float
    delay: float


def motion_between(
    log: Log, estimator: PoseEstimator, begin: int, end: int, shown: Callable[[Health], bool]
) -> Motion:
    """Run an estimator over a simulated log, and score its motion between two stamps.

    Args:
        log: the log.
        estimator: a new one.
        begin: stamp at which the fault begins, that of a sample [ns].
        end: stamp at which the motion ends [ns].
        shown: True if the health shows the fault.
    """
    delay = float("nan")
    for measurement in log.measurements():
        if measurement.stamp > end:
            break
        estimator.feed(measurement)
        if estimator.stamp == begin and begin not in estimator.marks:
            estimator.mark(begin)
        if measurement.stamp > begin and delay != delay and shown(estimator.health):
            delay = (measurement.stamp - begin) * NANOSECOND
    found = estimator.relative_motion(begin)
    if log.truth is None:
        raise ValueError("a simulated log has a truth")
    true = interpolate_poses(log.truth.poses, np.array([begin, end]))
    error = (found.pose - relative(true[0], true[1]))[:2]
    sigma = float(np.sqrt(np.trace(found.covariance[:2, :2])))
    return Motion(float(np.hypot(*error)), sigma, delay)
