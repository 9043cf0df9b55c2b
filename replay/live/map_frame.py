"""Map frame: an estimator with fixes or a given start, next to that of `odom`."""

import math
from collections import deque

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import compose, relative, rotate, wrap_angle
from icreckon.estimator.log.measurements import HeadingFix, Measurement, PositionFix
from icreckon.estimator.robot.settings import wander_of
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.base.start import CLEAR, SOON, Start, align_path

MOST_POSES = 2000  # most poses in `odom` that are kept for late fixes
MOST_WAITING, LONGEST = 1000, 300.0
"""Most positions that are aligned with the path, and the longest time for which they are [s]."""


class MapFrame:
    """Estimator of the pose in `map`, from the first fix on.

    It starts as a copy of that in `odom` if the first fix agrees with it and is said to be in `odom`, as
    those of a simulation are. Otherwise it starts at the first fix with a heading, or when the path has
    gone far enough to show the heading by positions alone. A pose that somebody gives takes precedence.
    Parameters and biases are those learnt so far.

    Args:
        start: pose of the centre of the tracks in `map` to begin with; None to begin at a fix.
    """

    def __init__(self, start: Start | None = None) -> None:
        self.estimator: PoseEstimator | None = None  # None before it starts
        self._heading: HeadingFix | None = None  # newest one before the estimator starts
        # Newest poses in `odom`, with their stamps: fixes come late.
        self._path: deque[tuple[int, Floats]] = deque(maxlen=MOST_POSES)
        # Positions without a heading before that, and the pose in `odom` at each.
        self._waiting: deque[tuple[PositionFix, Floats]] = deque(maxlen=MOST_WAITING)
        self._start = start  # pose to which `restart` returns
        self._placed = start  # pose to start at with the next measurements, then None

    def place(self, placed: Start) -> None:
        """Start again at a pose with the next measurements; what was learnt is kept."""
        self._placed = placed

    def take(self, group: list[Measurement], odom: PoseEstimator, *, in_odom: bool) -> None:
        """Update with measurements of one stamp; `odom` has all of them but the fixes.

        `in_odom`: the fixes are said to be in `odom`.
        """
        if self._placed is not None and odom.stamp is not None:
            learnt = odom if self.estimator is None else self.estimator
            self.estimator, self._placed = learnt.restarted(*self._placed), None
        if self.estimator is not None:
            for measurement in group:
                self.estimator.feed(measurement)
            return
        if odom.stamp is not None:
            self._path.append((odom.stamp, odom.pose))
        for measurement in group:
            if isinstance(measurement, HeadingFix):
                self._heading = measurement
        fix = next((part for part in group if isinstance(part, PositionFix)), None)
        if fix is None or odom.stamp is None:
            return
        if not (np.isfinite([fix.x, fix.y, fix.variance]).all() and fix.variance > 0.0):
            return
        self.estimator = self._started(fix, odom, in_odom=in_odom) or self._by_path(fix, odom)

    def set_clock(self, by: int) -> None:
        """Continue after the clock was set forward [ns]; drop waiting fixes and heading."""
        self._heading = None
        self._waiting.clear()
        self._path.clear()
        if self.estimator is not None:
            self.estimator.set_clock(by)

    def restart(self) -> None:
        """Start again at the given start, or by the next fixes."""
        self.estimator, self._heading, self._placed = None, None, self._start
        self._waiting.clear()
        self._path.clear()

    @property
    def waiting(self) -> int:
        """Number of fixes so far whose heading is not known yet."""
        return 0 if self.estimator is not None else len(self._waiting)

    def _started(
        self, fix: PositionFix, odom: PoseEstimator, *, in_odom: bool
    ) -> PoseEstimator | None:
        """Start as a copy of `odom`, or at a fix with a heading; None without a heading."""
        heading, lever_arm = self._heading, np.array([fix.forward, fix.left])
        if heading is not None and abs(fix.stamp - heading.stamp) * NANOSECOND > SOON:
            heading = None
        wander = wander_of(odom.robot, odom.settings)
        pose, sigma = self._reckoned(fix.stamp, odom), wander.at_start(math.sqrt(fix.variance))
        then = pose if heading is None else self._reckoned(heading.stamp, odom)
        x, y = pose[:2] + rotate(lever_arm, pose[2])
        both_sigmas = sigma + math.sqrt(float(np.trace(odom.pose_covariance[:2, :2])))
        is_near = math.hypot(fix.x - x, fix.y - y) <= CLEAR * both_sigmas
        if in_odom and is_near and (heading is None or _agrees(heading, then, odom)):
            if not wander.sigma:
                copy = odom.copy()
                for measurement in (fix, heading):
                    if measurement is not None:
                        copy.feed(measurement)
                return copy
            # A copy would be too certain of a position that wanders: only the heading is that of odom.
            heading = HeadingFix(fix.stamp, float(pose[2]), float(odom.pose_covariance[2, 2]))
            then = pose
        if heading is None:
            return None
        # Heading and fix were measured before now, and the robot has moved since.
        yaw = heading.yaw + float(pose[2] - then[2])
        x, y = np.array([fix.x, fix.y]) - rotate(lever_arm, yaw)
        x, y, yaw = compose((x, y, yaw), relative(pose, odom.pose)).tolist()
        return odom.restarted((x, y, yaw), (sigma, sigma, math.sqrt(heading.variance)))

    def _reckoned(self, stamp: int, odom: PoseEstimator) -> Floats:
        """Pose in `odom` at a stamp [ns], of the recent past or a little ahead."""
        ahead = (stamp - (odom.stamp or 0)) * NANOSECOND
        if ahead >= 0.0:
            return compose(odom.pose, odom.twist * ahead)
        stamps, poses = zip(*self._path, strict=True)
        x, y, yaw = np.array(poses).T
        return np.array([np.interp(stamp, stamps, one) for one in (x, y, np.unwrap(yaw))])

    def _by_path(self, fix: PositionFix, odom: PoseEstimator) -> PoseEstimator | None:
        """Start by the path in `odom`, aligned with the fixes; None if it is too short."""
        while self._waiting and (fix.stamp - self._waiting[0][0].stamp) * NANOSECOND > LONGEST:
            self._waiting.popleft()
        self._waiting.append((fix, self._reckoned(fix.stamp, odom)))
        fixes, poses = zip(*self._waiting, strict=True)
        reckoned = np.array(poses)
        lever_arms = [(waiting.forward, waiting.left) for waiting in fixes]
        path = reckoned[:, :2] + rotate(lever_arms, reckoned[:, 2])
        white_sigma = math.sqrt(float(np.median([waiting.variance for waiting in fixes])))
        wander = wander_of(odom.robot, odom.settings)
        positions = np.array([(waiting.x, waiting.y) for waiting in fixes])
        fitted = align_path(path, positions, white_sigma, wander, odom.pose[:2])
        if fitted is None:
            return None
        x, y, yaw = compose(fitted.pose, odom.pose).tolist()
        self._waiting.clear()
        return odom.restarted((x, y, yaw), fitted.sigma)


def _agrees(heading: HeadingFix, pose: Floats, odom: PoseEstimator) -> bool:
    """True if a heading is that of a pose in `odom`, within `CLEAR` times both sigmas."""
    difference = float(wrap_angle(heading.yaw - pose[2]))
    both_sigmas = math.sqrt(heading.variance) + math.sqrt(float(odom.pose_covariance[2, 2]))
    return abs(difference) <= CLEAR * both_sigmas
