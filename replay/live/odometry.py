"""Live odometry: messages in, estimates in `odom` and, with fixes, in `map` out."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.measurements import HeadingFix, Measurement, PositionFix
from icreckon.estimator.motion.icr import IndexValues
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.latencies import Latencies
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.live.inputs import LiveInputs, Subscription
from icreckon.replay.live.map_frame import MapFrame
from icreckon.replay.live.reorder import ReorderBuffer
from icreckon.replay.mapping.topics import TopicMap, topic_map, writable_topics

FIXES = (PositionFix, HeadingFix)


class LiveEstimate(NamedTuple):
    """Estimate at one stamp.

    Attributes:
        stamp: time [ns].
        pose: (3,) x, y [m], yaw [rad] of base_link in odom, without jumps.
        pose_covariance: (3, 3) its covariance.
        twist: (3,) v_x, v_y [m/s], w [rad/s] of base_link.
        twist_covariance: (3, 3) its covariance.
        indices: sliding and eccentricity [m] and steering efficiency [-] of the motion.
        map_pose: (3,) pose of base_link in map, or None before the first fix.
        map_covariance: (3, 3) its covariance, or None.
    """

    stamp: int
    pose: Floats
    pose_covariance: Floats
    twist: Floats
    twist_covariance: Floats
    indices: IndexValues
    map_pose: Floats | None
    map_covariance: Floats | None


class LiveOdometry:
    """Odometry of a robot from live messages, without threads, clocks or transport.

    A run over the messages of a bag equals `icreckon replay --engine streaming` of that bag, provided
    that `reorder` covers the disorder of the messages. Held track speeds are used as they come: the
    next value, which a replay interpolates to, is not known yet.

    Args:
        robot: the robot; topics of its `[log]`, or those of `icreckon simulate` if it maps none.
        variant: name of the filter variant.
        settings: settings of the estimators.
        reorder: time for which measurements are held, to process them in the order of their stamps
            [s]; at 0 they are processed as they come, and late ones correct the estimate.
        use_fixes: whether fixes and headings feed an estimator of the pose in `map`.
        highest_rate: highest rate of estimates, 0 for one at each IMU sample [Hz].
        saved: file of learnt parameters, from `save`, to start with if it exists.

    Raises:
        EstimatorError: an invalid setting, or a saved file for another robot.
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
    ) -> None:
        for name, value, most in (("reorder", reorder, 10.0), ("highest_rate", highest_rate, 1e4)):
            if not 0.0 <= value <= most:
                raise EstimatorError(f"{name} must be from 0 to {most:g}, found {value!r}")
        mapping = live_topics(robot)
        if not use_fixes:
            mapping = TopicMap(tracks=mapping.tracks, imu=mapping.imu)
        self.robot = robot
        self.inputs = LiveInputs(robot, mapping)
        # `inputs` takes off the latencies of the robot file; that of the tracks is watched, and estimated
        # where the file gives none.
        given = "latency" in robot.log.get("tracks", {})
        latencies = Latencies(estimate_tracks=not given)
        self.warm = saved is not None and saved.exists()
        self.odom = (
            _warm(saved, robot, variant, settings, latencies)
            if saved is not None and self.warm
            else PoseEstimator(robot, variant, settings=settings, latencies=latencies)
        )
        self.map = MapFrame() if mapping.fixes is not None else None
        self._buffer = ReorderBuffer(reorder)
        self._interval = round(1.0 / highest_rate / NANOSECOND) if highest_rate else 0
        self._history = round(self.odom.settings.history / NANOSECOND)
        self._newest: int | None = None

    def take(
        self, subscription: Subscription, msgtype: str, message: Any, arrival: int
    ) -> list[LiveEstimate]:
        """Process a message.

        Args:
            subscription: one of `inputs.subscriptions()`.
            msgtype: its type, as "sensor_msgs/msg/Imu".
            message: the message, with the attributes of its type.
            arrival: time of arrival [ns].

        Returns:
            New estimates, in the order of their stamps.

        Raises:
            ReplayError: the type cannot be read for this stream.
        """
        return self._process(self.inputs.take(subscription, msgtype, message, arrival))

    def flush(self, now: int) -> list[LiveEstimate]:
        """Process what waits although no more messages come.

        Args:
            now: present time [ns], of the clock of arrivals.
        """
        estimates = self._process(self.inputs.flush(now))
        return estimates + list(self._estimates(self._buffer.take_all()))

    def restart(self, now: int | None = None) -> None:
        """Start anew at the origin with the learnt parameters.

        Args:
            now: time to which the clock of arrivals went back [ns], None if it did not.
        """
        self.odom = self.odom.restarted()
        self.inputs.restart(now)
        self._buffer.take_all()
        if self.map is not None:
            self.map.restart()
        self._newest = None

    def save(self, path: Path) -> None:
        """Save what was learnt, with fixes if there were any, for the next start.

        Args:
            path: the file, which is replaced.

        Raises:
            EstimatorError: it cannot be written.
        """
        learnt = self.map.estimator if self.map is not None else None
        (learnt or self.odom).save(path, overwrite=True)

    def _process(self, measurements: list[Measurement]) -> list[LiveEstimate]:
        return list(self._estimates(self._buffer.put(measurements))) if measurements else []

    def _estimates(self, groups: list[list[Measurement]]) -> Iterator[LiveEstimate]:
        for group in groups:
            for measurement in group:
                if not isinstance(measurement, FIXES):
                    self.odom.feed(measurement)
            if self.map is not None:
                self.map.take(group, self.odom, geodetic=self.inputs.geodetic)
            stamp = self.odom.stamp
            if stamp is not None and self._is_due(stamp):
                self._newest = stamp
                yield self._estimate()

    def _is_due(self, stamp: int) -> bool:
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
        return LiveEstimate(
            odom.stamp,
            odom.state[s.POSE].copy(),
            odom.covariance[s.POSE, s.POSE].copy(),
            odom.twist,
            odom.twist_covariance,
            odom.indices,
            None if fixed is None else fixed.pose,
            None if fixed is None else fixed.pose_covariance,
        )


def live_topics(robot: Robot) -> TopicMap:
    """Topics of a robot's streams; by default those of `icreckon simulate`.

    Raises:
        ReplayError: a misspelt key, a wrong type or a bad value.
    """
    mapping = topic_map(robot, f"robot {robot.name!r}")
    return mapping if mapping.tracks is not None else writable_topics(mapping)


def _warm(
    saved: Path, robot: Robot, variant: str, settings: Settings | None, latencies: Latencies
) -> PoseEstimator:
    off = max(0.0, time.time() - saved.stat().st_mtime)
    return PoseEstimator.warm_start(
        saved, robot, variant, off=off, settings=settings, latencies=latencies
    )
