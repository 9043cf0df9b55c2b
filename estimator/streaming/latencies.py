"""Latencies of each stream's stamps, taken off ahead of the filter.

A stamp is late if the driver averaged, filtered, queued or repeated the value before it stamped it. That
of the track speeds is watched while driving, and estimated where nobody gave one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.checks import Latency, check_bounds, require_flag
from icreckon.estimator.base.lag_search import BEYOND
from icreckon.estimator.filter.health import TrackLatencyHealth
from icreckon.estimator.log.input_checks import key_of
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    Measurement,
    PoseFix,
    PositionFix,
    TrackSpeeds,
)
from icreckon.estimator.log.series import FixSeries, ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.sensors.track_latency import (
    TrackLatency,
    TrackLatencyEstimator,
    TrackLatencyMemory,
)

_Series = TypeVar("_Series", TrackSpeedSeries, ImuSeries, FixSeries)
LARGEST_SIGMA = 0.02
"""Standard error from which on an estimate is used [s]."""
LEAST, LEAST_CHANGE = 0.03, 0.01
"""Smallest latency that is taken off, and smallest change of one that is [s]."""


class Latencies(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Latency of each stream's stamps, which `PoseEstimator.feed` takes off them [s].

    Attributes:
        tracks: of the track speeds.
        imu: of the IMU samples.
        position: of the position fixes.
        heading: of the heading fixes.
        pose: of the pose fixes.
        body_velocity: of the body velocities.
        estimate_tracks: whether the latency of the track speeds behind the gyro is estimated while
            driving, and taken off once it is clear, in addition to `tracks`.

    Raises:
        EstimatorError: a latency of more than 10 s, or not a number.
    """

    tracks: Latency = 0.0
    imu: Latency = 0.0
    position: Latency = 0.0
    heading: Latency = 0.0
    pose: Latency = 0.0
    body_velocity: Latency = 0.0
    estimate_tracks: bool = False

    def __post_init__(self) -> None:
        check_bounds(self, "Latencies.{}")
        require_flag("Latencies.estimate_tracks", self.estimate_tracks)

    @classmethod
    def of(cls, robot: Robot) -> Latencies:
        """Latencies of a robot file's `[log]`; the tracks' is estimated if not given.

        Args:
            robot: the robot.
        """

        def latency(stream: str) -> float | None:
            table: Any = robot.log.get(stream)
            return table.get("latency") if isinstance(table, dict) else None

        tracks, fixes, heading = latency("tracks"), latency("fixes"), latency("heading")
        return cls(
            tracks=tracks or 0.0,
            imu=latency("imu") or 0.0,
            position=fixes or 0.0,
            heading=(fixes if heading is None else heading) or 0.0,
            estimate_tracks=tracks is None,
        )

    def taken_off(self, log: Log) -> Log:
        """Log with the stamps of its sensors corrected, for a log of raw stamps.

        Headings that come with a position are as late as that. A latency that is to be estimated is not
        taken off; the truth stays as it is.

        Args:
            log: the log.
        """

        def corrected(series: _Series, seconds: float) -> _Series:
            return replace(series, stamps=series.stamps - _nanoseconds(seconds))

        correction = {kind: _nanoseconds(value) for kind, value in self.by_kind().items()}
        others = [_shifted(one, correction.get(type(one), 0)) for one in log.others]
        return replace(
            log,
            tracks=corrected(log.tracks, self.tracks),
            imu=log.imu and corrected(log.imu, self.imu),
            fixes=log.fixes and corrected(log.fixes, self.position),
            others=tuple(sorted(others, key=key_of)),
        )

    def by_kind(self) -> dict[type, float]:
        """Latencies by type of measurement [s]."""
        return {
            TrackSpeeds: self.tracks,
            ImuSample: self.imu,
            PositionFix: self.position,
            HeadingFix: self.heading,
            PoseFix: self.pose,
            BodyVelocity: self.body_velocity,
        }


class StampCorrection:
    """Correction of stamps by latencies, and the watch over that of the tracks.

    Args:
        robot: the robot, for the mounting of its IMU.
        latencies: the latencies.
        estimated: estimate of an earlier run to begin with [s].
        watch: checkpoint of the watch, see `memory`; None to begin anew.

    Attributes:
        latencies: the latencies.
        estimated: part of the track speeds' latency that was estimated, and is taken off [s].
    """

    def __init__(
        self,
        robot: Robot,
        latencies: Latencies,
        estimated: float = 0.0,
        watch: TrackLatencyMemory | None = None,
    ) -> None:
        self.latencies, self.estimated = latencies, estimated
        self._estimated_ns = _nanoseconds(estimated)
        self._watch = TrackLatencyEstimator(SensorModels(robot).yaw_rates)
        if watch is not None:
            self._watch.recall(watch)
        self._found: TrackLatency | None = self._watch.estimate()
        self._completed = 0
        self._late = {kind: _nanoseconds(value) for kind, value in latencies.by_kind().items()}
        self._late[TrackSpeeds] += _nanoseconds(estimated)

    def late(self, kind: type) -> int:
        """Latency that is taken off the stamps of a type of measurements [ns]."""
        return self._late.get(kind, 0)

    def corrected(self, measurement: Measurement) -> Measurement:
        """Return the measurement with its stamp corrected."""
        late = self._late.get(type(measurement), 0)
        return _shifted(measurement, late) if late else measurement

    def watch(self, measurement: Measurement) -> None:
        """Watch the track speeds' latency by a plausible, corrected measurement."""
        m: Any = measurement
        if type(m) is ImuSample:
            self._watch.take_gyro(m.stamp, m.angular_velocity)
        elif type(m) is TrackSpeeds:
            self._watch.take_tracks(m.stamp + self._estimated_ns, m.left, m.right)
        if self._watch.completed != self._completed:
            self._completed = self._watch.completed
            self._use_estimate()

    def memory(self) -> TrackLatencyMemory:
        """Checkpoint of the watch over the track speeds' latency."""
        return self._watch.memory()

    def health(self) -> TrackLatencyHealth:
        """Latency of the track speeds: what is taken off, and what the watch finds."""
        given, found = self.latencies.tracks, self._found
        used = given + self.estimated
        if found is None:
            return TrackLatencyHealth(used)
        return TrackLatencyHealth(used, given + found.seconds, found.sigma)

    def _use_estimate(self) -> None:
        found = self._found = self._watch.estimate()
        if not self.latencies.estimate_tracks or found is None or found.sigma > LARGEST_SIGMA:
            return
        clear = abs(found.seconds) > max(LEAST, BEYOND * found.sigma)
        seconds = found.seconds if clear else 0.0
        if abs(seconds - self.estimated) > max(LEAST_CHANGE, found.sigma):
            self.estimated, self._estimated_ns = seconds, _nanoseconds(seconds)
            self._late[TrackSpeeds] = _nanoseconds(self.latencies.tracks + seconds)


def _shifted(measurement: Measurement, late: int) -> Measurement:
    # Measurements are dataclasses, but their protocol only asks for a stamp.
    shifted: Measurement = replace(measurement, stamp=measurement.stamp - late)  # type: ignore[type-var]
    return shifted


def _nanoseconds(seconds: float) -> int:
    return round(seconds / NANOSECOND)
