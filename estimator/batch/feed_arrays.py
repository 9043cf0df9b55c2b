"""Feed arrays of track speeds and IMU samples to a pose estimator."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import BatchError
from icreckon.estimator.batch.front_end import FrontEnd
from icreckon.estimator.batch.inputs import NO_STAMPS
from icreckon.estimator.batch.replay import measured_alone, work_through_log
from icreckon.estimator.batch.replay_rows import OUTPUT_AT_END, ReplayRows
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.layout import IMU_GATES
from icreckon.estimator.engine.schedule import steps_after
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.sensors.imu_clock import ClockRecord
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

# Fewer IMU samples than these are fed one by one, which is faster.
LEAST_BULK = 100
# Number of IMU samples at the start that are fed one by one, so that the filter makes its first step.
FIRST_SAMPLES = 3


def feed_arrays(estimator: PoseEstimator, tracks: TrackSpeedSeries, imu: ImuSeries) -> int:
    """Feed track speeds and IMU samples in the order of their stamps.

    The estimate is that of `PoseEstimator.feed` for each of them, to rounding. Latencies are those at the
    start; that of the tracks is watched only where samples are fed one by one.

    The newest `Settings.history` seconds are fed one by one, so that late measurements can be inserted.
    Late measurements of the time before are `TOO_OLD` afterwards.

    All samples are fed one by one if the compiled steps do not support them: if values are implausible or
    missing, stamps do not rise, there are speeds of wheels or marks, or the engine is "plain". The steps
    are compiled at the first call for a variant.

    Args:
        estimator: the estimator.
        tracks: track speeds, newer than all measurements so far.
        imu: IMU samples, newer than all measurements so far.

    Returns:
        Number of measurements that were used.
    """
    late_tracks, late_imu = estimator.late(TrackSpeeds), estimator.late(ImuSample)
    log = Log(
        "arrays",
        replace(tracks, stamps=tracks.stamps - late_tracks),
        replace(imu, stamps=imu.stamps - late_imu),
    )
    bulk = _bulk(log, estimator.settings.history)
    if bulk is None:
        return _feed_each(estimator, log)
    used = _feed_each(estimator, log.between(log.start, bulk.begin))
    try:
        used += _feed_bulk(estimator, log, bulk)
    except BatchError:
        return used + _feed_each(estimator, log.between(bulk.begin + 1, log.end))
    return used + _feed_each(estimator, log.between(bulk.end + 1, log.end))


def _feed_each(estimator: PoseEstimator, log: Log) -> int:
    """Feed measurements one by one; return the number of those that were used."""
    return sum(map(estimator.feed_corrected, log.measurements()))


class _Bulk(NamedTuple):
    """Interval (begin, end] of stamps whose samples are processed as arrays [ns]."""

    begin: int
    end: int


def _bulk(log: Log, history: float) -> _Bulk | None:
    """Choose the samples to process as arrays; None if too few or out of order."""
    stamps = NO_STAMPS if log.imu is None else log.imu.stamps
    if any((np.diff(of_sensor) <= 0).any() for of_sensor in (log.tracks.stamps, stamps)):
        return None
    if len(stamps) < LEAST_BULK + FIRST_SAMPLES or not len(log.tracks.stamps):
        return None
    if log.tracks.left_wheels is not None:
        return None
    newest = max(int(stamps[-1]), int(log.tracks.stamps[-1]))
    last = int(np.searchsorted(stamps, newest - round(history / NANOSECOND))) - 1
    # The filter has begun with the first track speeds.
    first = int(np.searchsorted(stamps, log.tracks.stamps[0])) + FIRST_SAMPLES
    if last - first < LEAST_BULK:
        return None
    return _Bulk(int(stamps[first]), int(stamps[last]))


def _feed_bulk(estimator: PoseEstimator, log: Log, bulk: _Bulk) -> int:
    """Process the samples of the bulk; return the number of those that were used.

    Raises:
        BatchError: they cannot be processed as arrays; the estimator is unchanged.
    """
    before = estimator.filter_checkpoint()
    _require_ready(estimator, before)
    part = _part_of(log, bulk, before)
    imu = part.imu
    if imu is None or before.stamp is None or before.regressors is None:
        raise BatchError("the filter has not begun")
    robot, settings = estimator.robot, estimator.settings
    if imu.linear_acceleration is None:
        settings = msgspec.structs.replace(settings, use_accelerometer=False)
    measured, _, _ = measured_alone(part, robot)
    begin = int(measured.track_stamps[0])
    clocks = ClockRecord(before.tracks.stamp, before.tracks.interval), before.imu
    steps = steps_after(
        measured.track_stamps, imu.stamps, before.stamp, clocks, settings, OUTPUT_AT_END
    )
    one = BatchFilter(robot, estimator.variant, settings, width=1)
    one.compile_for(steps)
    lanes = one.begin(measured.tracks[:, 0], np.zeros(3), np.zeros(3))
    one.continue_from(lanes, before, before.regressors)
    front = FrontEnd(measured, steps, input_settings(robot, settings))
    front.continue_from(
        before.tracks.shifted(-begin),
        before.standstill.shifted(-begin),
        before.noise.shifted(-begin),
    )
    rows = ReplayRows(one, robot, steps, measured, np.zeros(0, np.int8), NO_STAMPS)
    work_through_log([one], [lanes], [rows], steps, measured, front)

    health = before.health.copy()
    counts = one.counts(lanes)
    rows.count(one, lanes, health)
    used = int(counts["gyro_used"][0]) + len(measured.track_stamps) - 1
    health.sensor("tracks").used += len(measured.track_stamps) - 1
    health.track_gaps += steps.gaps
    health.stuck_tracks += int(front.stuck_tracks[0])
    tracks, standstill, noise = front.records(0)
    rejected = {gate: float(counts[f"{gate}_rejected_for"][0]) for gate in IMU_GATES}
    x, P = one.state(lanes, 0, with_fast_slip=True)
    after = msgspec.structs.replace(
        before,
        stamp=bulk.end,
        state=x,
        covariance=P,
        stands=one.stood(lanes, 0),
        tracks=tracks.shifted(begin),
        standstill=standstill.shifted(begin),
        imu=ClockRecord(bulk.end, float(steps.intervals[-1])),
        rejected_for=before.rejected_for | rejected,
        health=health,
        model=one.model_memory(lanes, 0),
        regressors=one.regressors(lanes, 0, before.regressors),
        noise=noise.shifted(begin),
    )
    estimator.continue_from(after)
    return used


def _require_ready(estimator: PoseEstimator, before: FilterCheckpoint) -> None:
    """Require an estimator that arrays can continue.

    Raises:
        BatchError: the estimator needs the streaming filter.
    """
    if estimator.settings.engine != "compiled":
        raise BatchError("filters side by side are compiled")
    if before.clones is not None:
        raise BatchError("there are marks")
    if before.stood_at is not None and before.stood_at == before.stamp:
        raise BatchError("there is a zero velocity at the estimate's stamp")


def _part_of(log: Log, bulk: _Bulk, before: FilterCheckpoint) -> Log:
    """Samples of the bulk, preceded by the newest track speeds before it."""
    imu = log.imu
    if imu is None:
        raise BatchError("there is no IMU")
    is_track = (log.tracks.stamps > before.tracks.stamp) & (log.tracks.stamps <= bulk.end)
    is_sample = (imu.stamps > bulk.begin) & (imu.stamps <= bulk.end)
    force = imu.linear_acceleration
    held = np.array([[before.tracks.left, before.tracks.right]])
    return Log(
        "arrays",
        TrackSpeedSeries(
            np.concatenate([[before.tracks.stamp], log.tracks.stamps[is_track]]),
            np.concatenate([held, log.tracks.speeds[is_track]]),
        ),
        imu=ImuSeries(
            imu.stamps[is_sample],
            imu.angular_velocity[is_sample],
            None if force is None else force[is_sample],
        ),
    )
