"""Live odometry: messages in, estimates in `odom` and, with fixes, in `map` out."""

import math
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import compose, relative
from icreckon.estimator.log.measurements import (
    HeadingFix,
    HeightFix,
    Measurement,
    PositionFix,
    TrackSpeeds,
)
from icreckon.estimator.motion.icr import IndexValues
from icreckon.estimator.motion.pose3d import Pose3d, Twist3d, pose3d_of
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.latencies import Latencies
from icreckon.estimator.streaming.outputs import Snapshot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.bags.messages import planar_covariance
from icreckon.replay.base.start import Start
from icreckon.replay.live.base_frame import CENTRE, BaseFrame, Pose
from icreckon.replay.live.inputs import LiveInputs, Subscription
from icreckon.replay.live.map_frame import MapFrame
from icreckon.replay.live.reorder import ReorderBuffer
from icreckon.replay.mapping.topics import TopicMap, topic_map, writable_topics

FIXES = (PositionFix, HeadingFix, HeightFix)
START_SIGMA = (0.5, 0.5, math.pi / 12.0)
"""Standard deviations of a start whose own are unknown [m, m, rad], those of AMCL."""
LOST_SIGMA = 10_000.0  # standard deviation of a position beyond which no filter recovers [m]


class LiveEstimate(NamedTuple):
    """Estimate at one stamp."""

    stamp: int  # time [ns]
    pose: Floats  # (3,) x, y [m], yaw [rad] of the base frame in odom, without jumps
    pose_covariance: Floats  # (3, 3) its covariance
    twist: Floats  # (3,) v_x, v_y [m/s], w [rad/s] of the base frame
    twist_covariance: Floats  # (3, 3) its covariance
    indices: IndexValues  # sliding and eccentricity [m] and steering efficiency [-] of the motion
    map_pose: Floats | None  # (3,) pose of the base frame in map, or None before the first fix
    map_covariance: Floats | None  # (3, 3) its covariance, or None
    base: BaseFrame  # the base frame
    odom: Snapshot  # estimate in odom of the centre of the tracks' contact area
    fixed: tuple[Floats, Floats] | None = None  # state of the estimator in map, covariance; or None

    @property
    def pose3d(self) -> Pose3d:
        """Pose of the base frame in odom with height, roll and pitch."""
        return self.base.pose3d(self.odom.pose3d, self.pose, self.pose_covariance)

    @property
    def twist3d(self) -> Twist3d:
        """Twist of the base frame with the rates of roll and pitch."""
        return self.base.twist3d(self.odom.twist3d, self.twist, self.twist_covariance)

    def in_odom(self, *, planar: bool) -> Pose3d:
        """Pose of the base frame in odom; a planar one is level."""
        return _level(self.pose, self.pose_covariance) if planar else self.pose3d

    def in_map(self, *, planar: bool) -> Pose3d | None:
        """Pose of the base frame in map; None before the first fix."""
        if self.fixed is None or self.map_pose is None or self.map_covariance is None:
            return None
        placed = self.map_pose, self.map_covariance
        return _level(*placed) if planar else self.base.pose3d(pose3d_of(*self.fixed), *placed)

    def odom_in_map(self, *, planar: bool) -> Pose3d | None:
        """Pose of odom in map, which are both level; None before the first fix."""
        placed, reckoned = self.in_map(planar=planar), self.in_odom(planar=planar)
        if placed is None or self.map_pose is None:
            return None
        pose = compose(self.map_pose, relative(self.pose, CENTRE))
        return _level(pose, np.zeros((3, 3)), placed.position[2] - reckoned.position[2])


class LiveOdometry:
    """Odometry of a robot from live messages, without threads, clocks or transport.

    A run over the messages of a bag equals `icreckon replay` of that bag, provided that `reorder` covers
    the disorder of the messages.

    Args:
        robot: the robot; topics of its `[log]`, or those of `icreckon simulate` if it maps none.
        variant: name of the filter variant.
        settings: settings of the estimators.
        reorder: time for which measurements are held, to process them in the order of their stamps
            [s]; at 0 they are processed as they come, and late ones correct the estimate.
        use_fixes: whether fixes and headings feed an estimator of the pose in `map`.
        highest_rate: highest rate of estimates, 0 for one at each IMU sample [Hz].
        saved: file of learnt parameters, from `save`, to start with if it exists; one that cannot be used
            is set aside under another name.
        start_pose: pose of the base frame in map at the start: x, y [m], yaw [rad]; with it there is a
            map without fixes. None for that of the first fix.
        base_offset: place of the base frame: forward, left of the centre of the tracks' contact area [m],
            and its yaw [rad].
        odom_frame: frame of fixes that are in `odom`.

    Raises:
        EstimatorError: an invalid setting.
        ReplayError: no topic for the track speeds.
    """

    def __init__(
        self,
        robot: Robot,
        variant: str = "inertia-online",
        *,
        settings: Settings | None = None,
        reorder: float = 0.0,
        use_fixes: bool = True,
        highest_rate: float = 0.0,
        saved: Path | None = None,
        start_pose: Pose | None = None,
        base_offset: Pose = CENTRE,
        odom_frame: str = "odom",
    ) -> None:
        for name, value, most in (("reorder", reorder, 10.0), ("highest_rate", highest_rate, 1e4)):
            if not 0.0 <= value <= most:
                raise EstimatorError(f"{name} must be from 0 to {most:g}, found {value!r}")
        mapping = live_topics(robot)
        if not use_fixes:
            mapping = TopicMap(tracks=mapping.tracks, imu=mapping.imu)
        self.robot, self.base, self.odom_frame = robot, BaseFrame(base_offset), odom_frame
        self.assumed_topics = "tracks" not in robot.log  # they are those of `icreckon simulate`
        self.inputs = LiveInputs(robot, mapping)
        self._saved, self._settings, self._variant = saved, settings, variant
        self.warm = False  # True if learnt parameters were read from a file
        self.set_aside = ""  # warning of such a file that could not be used
        self.odom = self._begin()  # estimator without fixes
        start = None if start_pose is None else Start(self.base.centre(start_pose), START_SIGMA)
        # None without fixes and start.
        self.map = MapFrame(start) if start or mapping.fixes is not None else None
        self._buffer = ReorderBuffer(reorder)
        self._interval = round(1.0 / highest_rate / NANOSECOND) if highest_rate else 0
        self._history = round(self.odom.settings.history / NANOSECOND)
        self._newest: int | None = None
        self.tracks: TrackSpeeds | None = None  # newest ones

    def take(
        self,
        subscription: Subscription,
        msgtype: str,
        message: Any,
        arrival: int,
        steady: int | None = None,
    ) -> list[LiveEstimate]:
        """Process a message; return new estimates, in the order of their stamps.

        Args:
            subscription: one of `inputs.subscriptions()`, on which the message came.
            msgtype: its type, such as "sensor_msgs/msg/Imu".
            message: the message: any object with the attributes of that type.
            arrival: its time of arrival [ns].
            steady: its time of arrival by a clock that nobody sets, which shows whether header stamps
                jump ahead [ns]; None for `arrival`.

        Raises:
            ReplayError: the type cannot be read for this stream.
        """
        measurements = self.inputs.take(subscription, msgtype, message, arrival, steady)
        estimates: list[LiveEstimate] = []
        if clock_step := self.inputs.clock_step:
            # Measurements in the buffer have stamps from before the step: they go first.
            estimates.extend(self._estimates(self._buffer.take_all()))
            self.odom.set_clock(clock_step)
            if self.map is not None:
                self.map.set_clock(clock_step)
        return estimates + self._process(measurements)

    def flush(self, now: int) -> list[LiveEstimate]:
        """Process what waits although no more messages come, at `now` by their clock [ns]."""
        estimates = self._process(self.inputs.flush(now))
        return estimates + list(self._estimates(self._buffer.take_all()))

    def restart(self, now: int | None = None) -> None:
        """Start again at the origin with the learnt parameters.

        A lost filter starts with those of the file, see `loss_of`. `now` is the time to which the clock
        of arrivals went back [ns], None if it did not.
        """
        self.odom = self._begin() if loss_of(self.odom) else self.odom.restarted()
        self.inputs.restart(now)
        self._buffer.take_all()
        if self.map is not None:
            self.map.restart()
        self._newest = None

    def place(self, pose: Pose, covariance: ArrayLike) -> bool:
        """Start the map again at a pose, with the next messages; `odom` goes on.

        The pose is that of the base frame in map: x, y [m], yaw [rad], with its covariance (3, 3), of
        which zeros are unknown. Returns False if there is no map: without fixes and start pose.

        Raises:
            EstimatorError: a value is not finite, or a variance is negative.
        """
        if self.map is None:
            return False
        variances = np.diagonal(covariance)
        if not (np.isfinite([*pose, *variances]).all() and (variances >= 0.0).all()):
            raise EstimatorError(
                f"the pose {pose} with variances {variances.tolist()} is none: all must be finite, and "
                "variances positive or zero"
            )
        of_x, of_y, of_yaw = np.sqrt(variances).tolist()
        sigma = (of_x, of_y, of_yaw) if variances.any() else START_SIGMA
        self.map.place(Start(self.base.centre(pose), sigma))
        return True

    def save(self, path: Path) -> None:
        """Save what was learnt, with fixes if there were any, for the next start.

        Raises:
            EstimatorError: it cannot be written, or the filter is lost.
        """
        if loss := loss_of(self.newest):
            raise EstimatorError(f"{path}: not written, {loss}")
        self.newest.save(path, overwrite=True)

    @property
    def newest(self) -> PoseEstimator:
        """Estimator that has all measurements: that of the map, once there is one."""
        return (self.map.estimator if self.map is not None else None) or self.odom

    def _begin(self) -> PoseEstimator:
        """Start an estimator: warm if there is a usable file, else by the robot file."""
        robot, variant, settings, saved = self.robot, self._variant, self._settings, self._saved
        # `inputs` takes off the latencies of the robot file; that of the tracks is watched, and estimated
        # where the file gives none.
        latencies = Latencies(estimate_tracks="latency" not in robot.log.get("tracks", {}))
        cold = PoseEstimator(robot, variant, settings=settings, latencies=latencies)
        self.warm = saved is not None and saved.exists()
        if saved is None or not self.warm:
            return cold
        off = max(0.0, time.time() - saved.stat().st_mtime)  # [s]; 0 by a clock that was set back
        try:
            return PoseEstimator.warm_start(
                saved, robot, variant, off=off, settings=settings, latencies=latencies
            )
        except EstimatorError as problem:
            self.warm = False
            self.set_aside = f"{problem}. {_set_aside(saved)}"
        return cold

    def _process(self, measurements: list[Measurement]) -> list[LiveEstimate]:
        return list(self._estimates(self._buffer.put(measurements))) if measurements else []

    def _estimates(self, groups: list[list[Measurement]]) -> Iterator[LiveEstimate]:
        """Feed the measurements, a group for each stamp; yield the estimates that are due."""
        for group in groups:
            for measurement in group:
                if isinstance(measurement, TrackSpeeds):
                    self.tracks = measurement
                if not isinstance(measurement, FIXES):
                    self.odom.feed(measurement)
            if self.map is not None:
                in_odom = self.inputs.fix_frame == self.odom_frame and not self.inputs.geodetic
                self.map.take(group, self.odom, in_odom=in_odom)
            stamp = self.odom.stamp
            if stamp is not None and self._is_due(stamp):
                self._newest = stamp
                yield self._estimate()

    def _is_due(self, stamp: int) -> bool:
        """True if the estimate at a stamp [ns] is published: new, and not above the rate."""
        newest = self._newest
        if newest is None:
            return True
        # A late IMU sample takes back a step that track speeds had made alone. A stamp that is further
        # back is that of a clock that was set back.
        if 0 <= newest - stamp <= self._history:
            return False
        # A grid of slots keeps the mean rate, whatever the rate of the IMU.
        return not self._interval or stamp // self._interval != newest // self._interval

    def _estimate(self) -> LiveEstimate:
        odom, fixed = self.odom.snapshot(), self.map.estimator if self.map is not None else None
        pose, covariance = odom.state[s.POSE].copy(), odom.covariance[s.POSE, s.POSE].copy()
        in_map: tuple[Floats | None, Floats | None] = (None, None)
        of_map = None
        if fixed is not None and fixed.stamp is not None:
            in_map = self.base.pose_in_map(fixed.pose, fixed.pose_covariance)
            of_map = fixed.state, fixed.covariance
        in_odom = self.base.pose_in_odom(pose, covariance)
        twist = self.base.twist(odom.twist, odom.twist_covariance)
        return LiveEstimate(
            odom.stamp, *in_odom, *twist, odom.indices, *in_map, self.base, odom, of_map
        )


def _level(pose: Floats, covariance: Floats, height: float = 0.0) -> Pose3d:
    """Pose on level ground, of a planar one (3,) with its covariance (3, 3)."""
    position, rpy = np.array([*pose[:2], height]), np.array([0.0, 0.0, pose[2]])
    return Pose3d(position, rpy, planar_covariance(covariance).reshape(6, 6))


def live_topics(robot: Robot) -> TopicMap:
    """Topics of a robot's streams; by default those of `icreckon simulate`.

    Raises:
        ReplayError: a misspelt key, a wrong type or a bad value.
    """
    mapping = topic_map(robot)
    return mapping if mapping.tracks is not None else writable_topics(mapping)


def loss_of(estimator: PoseEstimator) -> str:
    """Reason for which a filter cannot recover, empty if it can."""
    state, covariance = estimator.state, estimator.covariance
    if not (np.isfinite(state).all() and np.isfinite(covariance).all()):
        return "the filter is lost: its estimate is not finite"
    sigma = math.sqrt(max(covariance[s.X, s.X], covariance[s.Y, s.Y]))
    return f"the filter is lost: sigma {sigma:.3g} m" if sigma > LOST_SIGMA else ""


def _set_aside(saved: Path) -> str:
    """Rename a file that cannot be used, and describe that."""
    place = saved.resolve()
    candidates = (place.with_name(f"{place.name}.unusable-{k}") for k in count(1))
    aside = next(path for path in candidates if not path.exists())
    if not place.is_file():
        return f"{saved} is not a file: starting cold, and nothing is saved"
    try:
        place.rename(aside)
    except OSError as problem:
        return f"{saved} cannot be renamed to {aside}: {problem.strerror}; starting cold"
    return f"{saved} is set aside as {aside}; starting cold"
