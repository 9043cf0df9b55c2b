"""Samples as arrays, and rows of estimates between them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Flags, Floats, Stamps
from icreckon.estimator.log.input_checks import ABSURD_FORCE, ABSURD_RATE, ABSURD_SPEED, RANKS
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.log.series import TrackSpeedSeries

NO_STAMPS: Stamps = np.zeros(0, dtype=np.int64)
COUNT, WRITTEN, DUE, NEWEST = range(4)  # places in `RunRows.progress`, in the order of its comment


class SampleArrays(NamedTuple):
    """Track speeds and IMU samples of one robot."""

    track_stamps: Stamps  # (n,) stamps, ascending [ns]
    speeds: Floats  # (n, 2) speeds of the left and the right track [m/s]
    left_wheels: Floats  # (n, k) speeds of the left wheels [m/s]; k is 0 if they are not known
    right_wheels: Floats  # (n, l) speeds of the right wheels [m/s]
    imu_stamps: Stamps  # (m,) stamps, ascending [ns]
    angular_velocities: Floats  # (m, 3) in the axes of the IMU [rad/s]
    forces: Floats  # (m, 3) specific forces in the axes of the IMU [m/s²], NaN if there are none

    def newest(self, tracks: int, imu: int) -> tuple[int, int]:
        """Key of the newest of the first `tracks` track speeds and `imu` IMU samples."""
        streams = (TrackSpeeds, self.track_stamps, tracks), (ImuSample, self.imu_stamps, imu)
        return max((int(stamps[n - 1]), RANKS[kind]) for kind, stamps, n in streams if n)

    @property
    def first(self) -> int | None:
        """Stamp of the first sample [ns]; None if there is none."""
        filled = [stamps for stamps in (self.track_stamps, self.imu_stamps) if len(stamps)]
        return min((int(stamps[0]) for stamps in filled), default=None)

    def split(self, stamp: int) -> tuple[SampleArrays, SampleArrays]:
        """Samples up to a stamp [ns], and those after it."""
        tracks = int(np.searchsorted(self.track_stamps, stamp, "right"))
        imu = int(np.searchsorted(self.imu_stamps, stamp, "right"))
        # The first four fields are of the track speeds, the others of the IMU.
        up_to: Any = [*(array[:tracks] for array in self[:4]), *(array[:imu] for array in self[4:])]
        return SampleArrays(*up_to), self.after(tracks, imu)

    def after(self, tracks: int, imu: int) -> SampleArrays:
        """Samples after the first `tracks` track speeds and the first `imu` IMU samples."""
        rest: Any = [*(array[tracks:] for array in self[:4]), *(array[imu:] for array in self[4:])]
        return SampleArrays(*rest)


class Sampled(NamedTuple):
    """Samples that were processed."""

    tracks: int  # number of track speeds
    imu: int  # number of IMU samples
    rates_used: int  # number of yaw rates that were used
    stood: int  # number of IMU samples at which the robot stood


class RunRows(NamedTuple):
    """Rows of a run, one after each pair of track speeds, as arrays."""

    stamps: Stamps  # (n,) stamps of the estimates [ns]
    states: Floats  # (n, SIZE) states
    sigmas: Floats  # (n, SIZE) their standard deviations
    pose_covariances: Floats  # (n, 3, 3) covariances of the pose
    twists: Floats  # (n, 3) v_x, v_y [m/s], w [rad/s]
    twist_covariances: Floats  # (n, 3, 3) their covariances
    indices: Floats  # (n, 3) zeta [m], epsilon [m], eta [-]
    # (n, 3) newest normalised innovation of each gate of the IMU since the row before, or NaN
    innovations: Floats
    faults: Flags  # (n, k) 1 for each fault that lasts, see `FAULT_COLUMNS`
    judged: Stamps  # (3,) stamps of the newest of `innovations` that are in a row [ns]
    # (4,) number of filled rows, stamp of the newest [ns], 1 if a row is due, newest measurement [ns]
    progress: Stamps


def samples_of(log: Log) -> SampleArrays:
    """Track speeds and IMU samples of a log, in contiguous arrays that are writable."""
    tracks, imu = log.tracks, log.imu
    stamps, rates, forces = NO_STAMPS, np.zeros((0, 3)), np.zeros((0, 3))
    if imu is not None:
        stamps, rates, measured_forces = imu.stamps, imu.angular_velocity, imu.linear_acceleration
        forces = np.full(rates.shape, np.nan) if measured_forces is None else measured_forces
    arrays: Any = (tracks.stamps, tracks.speeds, *wheels_of(tracks), stamps, rates, forces)
    return SampleArrays(*(np.require(array, requirements=("C", "W")) for array in arrays))


def wheels_of(tracks: TrackSpeedSeries) -> tuple[Floats, Floats]:
    """Speeds (n, k) and (n, m) of the left and the right wheels [m/s], if known."""
    if tracks.left_wheels is None or tracks.right_wheels is None:
        return np.zeros((len(tracks.stamps), 0)), np.zeros((len(tracks.stamps), 0))
    return tracks.left_wheels, tracks.right_wheels


def are_in_order(samples: SampleArrays) -> bool:
    """Return True if the stamps of both streams rise."""
    streams = samples.track_stamps, samples.imu_stamps
    return all((np.diff(stamps) > 0).all() for stamps in streams)


def has_absurd_readings(log: Log, max_track_speed: float) -> bool:
    """Return True if a log has readings that are rejected before the gates."""
    imu, fastest = log.imu, ABSURD_SPEED * max_track_speed
    readings = [(values, fastest) for values in (log.tracks.speeds, *wheels_of(log.tracks))]
    if imu is not None:
        readings.append((imu.angular_velocity, ABSURD_RATE))
        if imu.linear_acceleration is not None:
            # NaN stands for no reading there, and becomes 0; infinity becomes absurdly large.
            readings.append((np.nan_to_num(imu.linear_acceleration), ABSURD_FORCE))
    # "not <=" in place of ">": NaN is absurd, too.
    return any(not np.abs(values).max(initial=0.0) <= most for values, most in readings)
