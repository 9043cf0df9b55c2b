"""Map frame: an estimator with fixes or a given start, beside that of `odom`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import rotate, wrap_angle
from icreckon.estimator.log.measurements import HeadingFix, Measurement, PositionFix
from icreckon.estimator.robot.settings import wander_of
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.base.start_limits import ANY_HEADING, CLEAR, SOON
from icreckon.replay.live.base_frame import Pose


class Placed(NamedTuple):
    """Pose that somebody gives.

    Attributes:
        pose: of the centre of the tracks in map: x, y [m], yaw [rad].
        sigma: its standard deviations [m, m, rad].
    """

    pose: Pose
    sigma: Pose


class MapFrame:
    """Estimator of the pose in `map`, from the first fix on.

    It starts as a copy of that in `odom` if the first fix agrees with it, as fixes of a simulation or
    of a localisation that starts with the robot do; otherwise at the first fix, with its heading if
    one is known and with any heading if not. A pose that somebody gives takes precedence. Parameters and
    biases are those learnt so far.

    Args:
        start: pose at the start, if it is known.

    Attributes:
        estimator: the estimator; None before the first fix.
    """

    def __init__(self, start: Placed | None = None) -> None:
        self.estimator: PoseEstimator | None = None
        self._heading: HeadingFix | None = None
        self._start = self._placed = start

    def place(self, placed: Placed) -> None:
        """Start anew at a pose with the next measurements; what was learnt stays."""
        self._placed = placed

    def take(self, group: list[Measurement], odom: PoseEstimator, *, geodetic: bool) -> None:
        """Update with measurements of one stamp.

        Args:
            group: the measurements.
            odom: the estimator of the pose in `odom`, updated with all of them but the fixes.
            geodetic: whether positions are east and north of an origin, so that the first one agrees
                with `odom` without saying anything of the yaw.
        """
        if self._placed is not None and odom.stamp is not None:
            learnt = odom if self.estimator is None else self.estimator
            self.estimator, self._placed = learnt.restarted(*self._placed), None
        if self.estimator is not None:
            for measurement in group:
                self.estimator.feed(measurement)
            return
        for measurement in group:
            if isinstance(measurement, HeadingFix):
                self._heading = measurement
        fix = next((one for one in group if isinstance(one, PositionFix)), None)
        if fix is not None and odom.stamp is not None and _is_finite(fix):
            self.estimator = self._started(fix, odom, geodetic=geodetic)
            for measurement in group:
                if isinstance(measurement, PositionFix | HeadingFix):
                    self.estimator.feed(measurement)

    def restart(self) -> None:
        """Start anew at the given start, or at the next fix."""
        self.estimator, self._heading, self._placed = None, None, self._start

    def _started(self, fix: PositionFix, odom: PoseEstimator, *, geodetic: bool) -> PoseEstimator:
        heading, lever_arm = self._heading, np.array([fix.forward, fix.left])
        if heading is not None and abs(fix.stamp - heading.stamp) * NANOSECOND > SOON:
            heading = None
        wander = wander_of(odom.robot, odom.settings)
        pose, sigma = odom.pose, wander.at_start(math.sqrt(fix.variance))
        if not geodetic and not wander.sigma:
            expected = pose[:2] + rotate(lever_arm, pose[2])
            spread = sigma + math.sqrt(float(np.trace(odom.pose_covariance[:2, :2])))
            near = math.hypot(fix.x - expected[0], fix.y - expected[1]) <= CLEAR * spread
            if near and (heading is None or _agrees(heading, odom)):
                return odom.copy()
        if heading is None:
            sigma += float(np.hypot(*lever_arm))
            return odom.restarted((fix.x, fix.y, 0.0), (sigma, sigma, ANY_HEADING))
        x, y = np.array([fix.x, fix.y]) - rotate(lever_arm, heading.yaw)
        start = (float(x), float(y), heading.yaw)
        return odom.restarted(start, (sigma, sigma, math.sqrt(heading.variance)))


def _agrees(heading: HeadingFix, odom: PoseEstimator) -> bool:
    off = float(wrap_angle(heading.yaw - odom.pose[2]))
    spread = math.sqrt(heading.variance) + math.sqrt(float(odom.pose_covariance[2, 2]))
    return abs(off) <= CLEAR * spread


def _is_finite(fix: PositionFix) -> bool:
    return bool(np.isfinite([fix.x, fix.y, fix.variance]).all()) and fix.variance > 0.0
