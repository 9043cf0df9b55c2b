"""Map frame: an estimator with fixes or a given start, next to that of `odom`."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import compose, rotate, wrap_angle
from icreckon.estimator.log.measurements import HeadingFix, Measurement, PositionFix
from icreckon.estimator.robot.settings import wander_of
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.base.start import CLEAR, SOON, laid_over
from icreckon.replay.live.base_frame import Pose

MOST_WAITING, LONGEST = 1000, 300.0
"""Most positions that are aligned with the path, and the longest time for which they are [s]."""


class Placed(NamedTuple):
    """Pose that somebody gives."""

    pose: Pose  # of the centre of the tracks in map: x, y [m], yaw [rad]
    sigma: Pose  # its standard deviations [m, m, rad]


class MapFrame:
    """Estimator of the pose in `map`, from the first fix on.

    It starts as a copy of that in `odom` if the first fix agrees with it and has the frame `odom`, as in
    a simulation. Otherwise it starts at the first fix with a heading, or when the path is long enough to
    estimate the heading from positions alone. A pose set by `place` takes precedence. Learnt parameters
    and biases are kept.

    Attributes:
        estimator: the estimator; None before it starts.
    """

    def __init__(self, start: Placed | None = None) -> None:
        self.estimator: PoseEstimator | None = None
        self._heading: HeadingFix | None = None
        # Positions without a heading, and the pose in `odom` at each.
        self._waiting: deque[tuple[PositionFix, Floats]] = deque(maxlen=MOST_WAITING)
        self._start = self._placed = start

    def place(self, placed: Placed) -> None:
        """Start again at a pose with the next measurements; what was learnt is kept."""
        self._placed = placed

    def take(self, group: list[Measurement], odom: PoseEstimator, *, in_odom: bool) -> None:
        """Update with measurements of one stamp.

        `odom` is the estimator in `odom`, already updated with all of them but the fixes; `in_odom` is
        True if the frame of the fixes is `odom`.
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
        if fix is None or odom.stamp is None or not _is_finite(fix):
            return
        self.estimator = self._started(fix, odom, in_odom=in_odom)
        if self.estimator is not None:
            for measurement in group:
                if isinstance(measurement, PositionFix | HeadingFix):
                    self.estimator.feed(measurement)
        else:
            self.estimator = self._by_path(fix, odom)

    def set_clock(self, by: int) -> None:
        """Continue with a clock that was set forward by this time [ns]."""
        self._heading = None
        self._waiting.clear()
        if self.estimator is not None:
            self.estimator.set_clock(by)

    def restart(self) -> None:
        """Start again at the given start, or by the next fixes."""
        self.estimator, self._heading, self._placed = None, None, self._start
        self._waiting.clear()

    @property
    def waiting(self) -> int:
        """Number of fixes so far whose heading is not known yet."""
        return 0 if self.estimator is not None else len(self._waiting)

    def _started(
        self, fix: PositionFix, odom: PoseEstimator, *, in_odom: bool
    ) -> PoseEstimator | None:
        """Start at a fix that has a heading, or agrees with `odom`; None otherwise."""
        heading, lever_arm = self._heading, np.array([fix.forward, fix.left])
        if heading is not None and abs(fix.stamp - heading.stamp) * NANOSECOND > SOON:
            heading = None
        wander = wander_of(odom.robot, odom.settings)
        pose, sigma = odom.pose, wander.at_start(math.sqrt(fix.variance))
        expected = pose[:2] + rotate(lever_arm, pose[2])
        spread = sigma + math.sqrt(float(np.trace(odom.pose_covariance[:2, :2])))
        near = math.hypot(fix.x - expected[0], fix.y - expected[1]) <= CLEAR * spread
        if in_odom and near and (heading is None or _agrees(heading, odom)):
            if not wander.sigma:
                return odom.copy()
            heading = HeadingFix(fix.stamp, float(pose[2]), float(odom.pose_covariance[2, 2]))
        if heading is None:
            return None
        x, y = np.array([fix.x, fix.y]) - rotate(lever_arm, heading.yaw)
        start = (float(x), float(y), heading.yaw)
        return odom.restarted(start, (sigma, sigma, math.sqrt(heading.variance)))

    def _by_path(self, fix: PositionFix, odom: PoseEstimator) -> PoseEstimator | None:
        """Start by the path in `odom`, aligned with the fixes; None if it is too short."""
        while self._waiting and (fix.stamp - self._waiting[0][0].stamp) * NANOSECOND > LONGEST:
            self._waiting.popleft()
        since = (fix.stamp - (odom.stamp or 0)) * NANOSECOND
        self._waiting.append((fix, compose(odom.pose, odom.twist * since)))
        fixes, poses = zip(*self._waiting, strict=True)
        at = np.array(poses)
        path = at[:, :2] + rotate([(one.forward, one.left) for one in fixes], at[:, 2])
        white = math.sqrt(float(np.median([one.variance for one in fixes])))
        wander = wander_of(odom.robot, odom.settings)
        sigma = math.hypot(white, math.sqrt(len(fixes)) * wander.sigma)
        fit = laid_over(path, np.array([(one.x, one.y) for one in fixes]), sigma)
        if fit is None:
            return None
        x, y, yaw = compose(fit.pose, odom.pose).tolist()
        # The error of the yaw turns the pose about the middle of the path.
        distance = float(np.hypot(*(odom.pose[:2] - path.mean(axis=0))))
        position_sigma = wander.at_start(white) + fit.sigma[2] * distance
        self._waiting.clear()
        return odom.restarted((x, y, yaw), (position_sigma, position_sigma, fit.sigma[2]))


def _agrees(heading: HeadingFix, odom: PoseEstimator) -> bool:
    off = float(wrap_angle(heading.yaw - odom.pose[2]))
    spread = math.sqrt(heading.variance) + math.sqrt(float(odom.pose_covariance[2, 2]))
    return abs(off) <= CLEAR * spread


def _is_finite(fix: PositionFix) -> bool:
    return bool(np.isfinite([fix.x, fix.y, fix.variance]).all()) and fix.variance > 0.0
