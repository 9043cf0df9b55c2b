"""Samples as arrays, and what was processed of them."""

from __future__ import annotations

from typing import Any, NamedTuple

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.log.input_checks import RANKS
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds


class SampleArrays(NamedTuple):
    """Track speeds and IMU samples of one robot.

    Attributes:
        track_stamps: (n,) stamps, ascending [ns].
        speeds: (n, 2) speeds of the left and the right track [m/s].
        left_wheels: (n, k) speeds of the left wheels [m/s]; k is 0 if they are not known.
        right_wheels: (n, l) speeds of the right wheels [m/s].
        imu_stamps: (m,) stamps, ascending [ns].
        angular_velocities: (m, 3) in the axes of the IMU [rad/s].
        forces: (m, 3) specific forces in the axes of the IMU [m/s²], NaN if there are none.
    """

    track_stamps: Stamps
    speeds: Floats
    left_wheels: Floats
    right_wheels: Floats
    imu_stamps: Stamps
    angular_velocities: Floats
    forces: Floats

    def newest(self, tracks: int, imu: int) -> tuple[int, int]:
        """Key of the last of so many track speeds and IMU samples, at least one."""
        streams = (TrackSpeeds, self.track_stamps, tracks), (ImuSample, self.imu_stamps, imu)
        return max((int(at[count - 1]), RANKS[kind]) for kind, at, count in streams if count)

    def after(self, tracks: int, imu: int) -> SampleArrays:
        """Samples without so many track speeds and IMU samples at the start."""
        left: Any = (*(one[tracks:] for one in self[:4]), *(one[imu:] for one in self[4:]))
        return SampleArrays(*left)


class Sampled(NamedTuple):
    """Samples that were processed.

    Attributes:
        tracks: number of track speeds.
        imu: number of IMU samples.
        rates_used: number of yaw rates that were used.
        stood: number of IMU samples at which the robot stood.
    """

    tracks: int
    imu: int
    rates_used: int
    stood: int
