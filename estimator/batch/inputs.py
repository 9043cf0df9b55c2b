"""Measurements of logs with the same stamps, as arrays for filters side by side."""

from collections.abc import Sequence

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.errors import BatchError
from icreckon.estimator.batch.front_end import FIX_VALUES, Measured
from icreckon.estimator.filter.samples import NO_STAMPS, wheels_of
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors.sensor_models import SensorModels


def measured_of(logs: Sequence[Log], robot: Robot, track_stamps: Stamps | None = None) -> Measured:
    """Track speeds, IMU and fixes of logs, in the axes and units of a robot's filter.

    Logs have the same stamps, except for track speeds that some may lack: those may have `track_stamps`
    (n,) [ns], None for all that occur.

    Raises:
        BatchError: the stamps differ, there is no IMU or it has no accelerometers, or there are
            measurements that filters side by side do not support.
    """
    for log in logs:
        if log.others:
            kinds = ", ".join(sorted({type(other).__name__ for other in log.others}))
            raise BatchError(
                f"the log {log.name!r} holds {kinds}, which filters side by side do not support"
            )
    imus, forces = zip(*map(_imu_and_forces, logs), strict=True)
    imu_stamps, fix_stamps = imus[0].stamps, _fix_stamps(logs[0])
    for log, imu in zip(logs, imus, strict=True):
        if not np.array_equal(imu.stamps, imu_stamps):
            raise BatchError(
                f"the IMU samples of {log.name!r} have other stamps than the first log's"
            )
        if not np.array_equal(_fix_stamps(log), fix_stamps):
            raise BatchError(f"the fixes of {log.name!r} have other stamps than the first log's")
    if track_stamps is None:
        track_stamps = logs[0].tracks.stamps
        if not all(np.array_equal(log.tracks.stamps, track_stamps) for log in logs):
            track_stamps = np.unique(np.concatenate([log.tracks.stamps for log in logs]))
    # Speeds of tracks, left wheels and right wheels of each log; NaN where it lacks a stamp.
    speeds = [(log.tracks.speeds, *wheels_of(log.tracks)) for log in logs]
    counts = [max(array.shape[1] for array in arrays) for arrays in zip(*speeds, strict=True)]
    filled = [np.full((len(logs), len(track_stamps), count), np.nan) for count in counts]
    for run, (log, arrays) in enumerate(zip(logs, speeds, strict=True)):
        stamps = log.tracks.stamps
        if not np.isin(stamps, track_stamps).all():
            raise BatchError(f"track speeds of {log.name!r} have stamps that no track speeds have")
        places = np.searchsorted(track_stamps, stamps)
        for values, array in zip(filled, arrays, strict=True):
            if values.shape[2] != array.shape[1]:
                raise BatchError(f"{log.name!r} has the speeds of other wheels than the first log")
            values[run, places] = array
    sensors = SensorModels(robot)
    rates = np.stack([sensors.rates(imu.angular_velocity) for imu in imus])
    along = np.stack([sensors.along_ground_of(force) for force in forces])
    fixes = np.zeros((len(logs), len(fix_stamps), FIX_VALUES))
    for run, log in enumerate(logs):
        series = log.fixes
        if series is not None and len(fix_stamps):
            fixes[run] = np.column_stack([series.poses, series.variances, series.lever_arms])
    tracks, left, right = filled
    return Measured(track_stamps, tracks, left, right, imu_stamps, rates, along, fix_stamps, fixes)


def _imu_and_forces(log: Log) -> tuple[ImuSeries, Floats]:
    """IMU samples of a log and its specific forces (m, 3); `BatchError` without them."""
    if log.imu is None or log.imu.linear_acceleration is None:
        raise BatchError(f"the log {log.name!r} holds no IMU with gyros and accelerometers")
    return log.imu, log.imu.linear_acceleration


def _fix_stamps(log: Log) -> Stamps:
    """Stamps (k,) of the fixes of a log [ns]; none without fixes."""
    return NO_STAMPS if log.fixes is None else log.fixes.stamps


def has_heading(fixes: Floats) -> bool:
    """Return True if fixes (..., 7) have headings; `BatchError` if only some have."""
    headed = np.isfinite(fixes[..., 2])
    if headed.any() and not headed.all():
        raise BatchError("some fixes have a heading and some have none")
    return bool(headed.any())
