"""Feed arrays of track speeds and IMU samples to a pose estimator."""

from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.filter.samples import NO_STAMPS, has_absurd_readings, samples_of
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import Rows

LEAST_BULK = 100  # fewer IMU samples than these are fed one by one, which is faster
# Number of IMU samples at the start that are fed one by one, so that the filter makes its first step.
FIRST_SAMPLES = 3


def feed_arrays(estimator: PoseEstimator, tracks: TrackSpeedSeries, imu: ImuSeries) -> int:
    """Feed track speeds and IMU samples in the order of their stamps.

    The estimate is that of `PoseEstimator.feed` for each of them, to the last bit. Latencies are those at
    the start; that of the tracks is watched only where samples are fed one by one.

    The newest `Settings.history` seconds are fed one by one, so that late measurements can be inserted.
    Late measurements of the time before are `TOO_OLD` afterwards.

    All samples are fed one by one if some are not newer than the estimate, values are implausible or
    missing, stamps do not rise, or there are marks, or faults of your own. The loop is compiled at the
    first call for a motion model.

    Args:
        estimator: the estimator.
        tracks: track speeds.
        imu: IMU samples.

    Returns:
        Number of measurements that were used.
    """
    tracks = replace(tracks, stamps=tracks.stamps - estimator.late(TrackSpeeds))
    imu = replace(imu, stamps=imu.stamps - estimator.late(ImuSample))
    log = Log("arrays", tracks, imu)
    interval = _array_interval(log, estimator)
    if interval is None:
        return _feed_each(estimator, log)
    begin, end = interval
    used = _feed_each(estimator, log.between(log.start, begin))
    samples = samples_of(log.between(begin + 1, end))
    while len(samples.track_stamps) or len(samples.imu_stamps):
        tracks_fed, imu_fed, more_used = estimator.feed_samples(samples, Rows(0).arrays)
        samples, used = samples.after(tracks_fed, imu_fed), used + more_used
        # What is left begins with a sample that needs more than a step.
        first = samples.first
        if first is not None:
            used += _feed_each(estimator, log.between(first, first))
            samples = samples_of(log.between(first + 1, end))
    return used + _feed_each(estimator, log.between(end + 1, log.end))


def _feed_each(estimator: PoseEstimator, log: Log) -> int:
    """Feed measurements one by one; return the number of those that were used."""
    return sum(map(estimator.feed_corrected, log.measurements()))


def _array_interval(log: Log, estimator: PoseEstimator) -> tuple[int, int] | None:
    """Interval (begin, end] of stamps to feed as arrays [ns]; None to feed one by one."""
    imu_stamps = NO_STAMPS if log.imu is None else log.imu.stamps
    track_stamps = log.tracks.stamps
    if (np.diff(track_stamps) <= 0).any() or (np.diff(imu_stamps) <= 0).any():
        return None
    if len(imu_stamps) < LEAST_BULK + FIRST_SAMPLES or not len(track_stamps):
        return None
    if estimator.stamp is not None and log.start <= estimator.stamp:
        return None
    fastest = estimator.robot.vehicle.max_track_speed
    if estimator.marks or estimator.has_own_faults or has_absurd_readings(log, fastest):
        return None
    newest = max(int(imu_stamps[-1]), int(track_stamps[-1]))
    oldest_of_history = newest - round(estimator.settings.history / NANOSECOND)
    last = int(np.searchsorted(imu_stamps, oldest_of_history)) - 1
    # The filter begins with the first track speeds.
    first = int(np.searchsorted(imu_stamps, track_stamps[0])) + FIRST_SAMPLES
    return (int(imu_stamps[first]), int(imu_stamps[last])) if last - first >= LEAST_BULK else None
