"""Latencies of each stream's stamps, taken off ahead of the filter.

A stamp is late if the driver averaged, filtered, queued or repeated the value before it stamped it. That
of the track speeds is watched while driving, and estimated where none is given.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.checks import Latency, check_bounds, require_flag
from icreckon.estimator.base.lag_search import BEYOND
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.health import TrackLatencyHealth
from icreckon.estimator.log import measurements
from icreckon.estimator.log.measurements import Measurement, TrackSpeeds
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors import track_latency
from icreckon.estimator.sensors.track_latency import TrackLatencyMemory

LARGEST_SIGMA = 0.02  # largest standard error with which an estimate is used [s]
LEAST_LATENCY, LEAST_CHANGE = 0.03, 0.01
"""Least latency that is subtracted, and least change of the one that is [s]."""
SAMPLES_AT_ONCE = 1000  # number of waiting samples at which the estimator takes them, all at once


class Latencies(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Latency of each stream's stamps, which `PoseEstimator.feed` takes off them [s].

    Attributes:
        tracks: of the track speeds.
        imu: of the IMU samples.
        position: of the position fixes and heights.
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

        Headings without a latency have that of `[log.fixes]`. Pose fixes have none.
        """

        def latency(stream: str) -> float | None:
            table: Any = robot.log.get(stream, robot.log.get("columns", {}).get(stream))
            return table.get("latency") if isinstance(table, dict) else None

        tracks, fixes, heading = latency("tracks"), latency("fixes"), latency("heading")
        return cls(
            tracks=tracks or 0.0,
            imu=latency("imu") or 0.0,
            position=fixes or 0.0,
            heading=(fixes if heading is None else heading) or 0.0,
            body_velocity=latency("velocity") or 0.0,
            estimate_tracks=tracks is None,
        )

    def by_kind(self) -> dict[type, float]:
        """Latencies by type of measurement [s]."""
        return {
            TrackSpeeds: self.tracks,
            measurements.ImuSample: self.imu,
            measurements.PositionFix: self.position,
            measurements.HeadingFix: self.heading,
            measurements.HeightFix: self.position,
            measurements.PoseFix: self.pose,
            measurements.BodyVelocity: self.body_velocity,
        }


class RateSamples(NamedTuple):
    """Successive samples of a rate."""

    stamps: Stamps  # (n,) [ns]
    rates: Floats  # (n,)


NO_SAMPLES = RateSamples(np.zeros(0, np.int64), np.zeros(0))


def joined(parts: list[RateSamples]) -> RateSamples:
    """Join successive samples; none if there are no parts."""
    stamps, rates = zip(NO_SAMPLES, *parts, strict=True)
    return RateSamples(np.concatenate(stamps), np.concatenate(rates))


class StampCorrection:
    """Correction of stamps by latencies, and the watch over that of the tracks.

    Args:
        latencies: the latencies.
        estimated: part of the track speeds' latency that an earlier run has estimated [s].
        memory: checkpoint of the watch, see `memory`; None to start again.
    """

    def __init__(
        self, latencies: Latencies, estimated: float = 0.0, memory: TrackLatencyMemory | None = None
    ) -> None:
        self.latencies, self.estimated = latencies, estimated
        # Waiting samples of track-speed difference and yaw rate for the estimator, and their number.
        self._track_parts, self._gyro_parts = list[RateSamples](), list[RateSamples]()
        self._waiting_samples = 0
        self._estimator = track_latency.TrackLatencyEstimator()
        if memory is not None:
            self._estimator.recall(memory)
        latency_ns = {kind: _nanoseconds(value) for kind, value in latencies.by_kind().items()}
        latency_ns[TrackSpeeds] += _nanoseconds(estimated)
        self._latency_ns = latency_ns

    def late(self, kind: type) -> int:
        """Latency that is taken off the stamps of a type of measurements [ns]."""
        return self._latency_ns.get(kind, 0)

    def corrected(self, measurement: Measurement) -> Measurement:
        """Measurement with the latency of its type taken off its stamp."""
        late_ns = self._latency_ns.get(type(measurement))
        if not late_ns:
            return measurement
        # Measurements are dataclasses, but their protocol only asks for a stamp.
        return replace(measurement, stamp=measurement.stamp - late_ns)  # type: ignore[type-var]

    def watch(self, record: FilterRecord) -> None:
        """Move the newest rates from a filter's record here; estimate after many of them."""
        # The estimator needs track stamps without the estimated part of the correction.
        for parts, samples, added_ns in (
            (self._track_parts, record.turning, _nanoseconds(self.estimated)),
            (self._gyro_parts, record.yaw_rates, 0),
        ):
            count, samples.count = samples.count, 0
            if not count:
                continue
            begin = int(samples.begin) + added_ns
            if parts and begin < parts[-1].stamps[0] - track_latency.LARGEST_HOLE:
                # The clock was set back.
                self._flush()
            stamps = begin + np.array(samples.times[:count]).astype(np.int64)
            parts.append(RateSamples(stamps, np.array(samples.rates[:count])))
            self._waiting_samples += count
        if self._waiting_samples >= SAMPLES_AT_ONCE:
            self._use_estimate()

    def _flush(self) -> None:
        """Add the waiting samples to the estimator."""
        samples = *joined(self._track_parts), *joined(self._gyro_parts)
        self._track_parts.clear()
        self._gyro_parts.clear()
        self._estimator.take(*samples)

    def memory(self) -> TrackLatencyMemory:
        """Checkpoint of the watch; the waiting samples are used first."""
        self._use_estimate()
        return self._estimator.memory()

    def health(self) -> TrackLatencyHealth:
        """Latency of the track speeds: the one subtracted, and the estimate if any."""
        self._flush()
        configured, lag = self.latencies.tracks, self._estimator.estimate()
        subtracted = configured + self.estimated
        if lag is None:
            return TrackLatencyHealth(subtracted)
        return TrackLatencyHealth(subtracted, configured + lag.seconds, lag.sigma)

    def _use_estimate(self) -> None:
        """Subtract the estimated latency from now on if it is allowed, certain and new."""
        self._flush()
        self._waiting_samples = 0
        if not self.latencies.estimate_tracks:
            return
        lag = self._estimator.estimate()
        if lag is None or lag.sigma > LARGEST_SIGMA:
            return
        is_clear = abs(lag.seconds) > max(LEAST_LATENCY, BEYOND * lag.sigma)
        seconds = lag.seconds if is_clear else 0.0
        if abs(seconds - self.estimated) > max(LEAST_CHANGE, lag.sigma):
            self.estimated = seconds
            self._latency_ns[TrackSpeeds] = _nanoseconds(self.latencies.tracks + seconds)


def _nanoseconds(seconds: float) -> int:
    return round(seconds / NANOSECOND)
