"""Interface to the steps of a filter, compiled or in Python."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.records import Record
from icreckon.estimator.filter.ekf import Ekf
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.log.input_checks import RANKS
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.standstill import QuietReadings


class PositionUpdate(NamedTuple):
    """Update with a position fix.

    Attributes:
        z: innovation, x and y [m].
        S: its covariance, xx, xy and yy [m²].
        admitted: the gate admitted it.
        lost: it was not used, and the filter is to be relocated.
        used: it was used.
        predicted: place of the antenna and yaw before it [m, m, rad].
        updated: the same after it.
    """

    z: tuple[float, float]
    S: tuple[float, float, float]
    admitted: bool
    lost: bool
    used: bool
    predicted: tuple[float, float, float]
    updated: tuple[float, float, float]


class SampleArrays(NamedTuple):
    """Track speeds and IMU samples of one robot.

    Attributes:
        track_stamps: (n,) stamps, ascending [ns].
        speeds: (n, 2) speeds of the left and the right track [m/s].
        imu_stamps: (m,) stamps, ascending [ns].
        rates: (m,) yaw rates by the gyros [rad/s].
        forces: (m, 2) specific forces forward and to the left [m/s²], NaN if there are none.
    """

    track_stamps: Stamps
    speeds: Floats
    imu_stamps: Stamps
    rates: Floats
    forces: Floats

    def newest(self, tracks: int, imu: int) -> tuple[int, int]:
        """Key of the last of so many track speeds and IMU samples, at least one."""
        streams = (TrackSpeeds, self.track_stamps, tracks), (ImuSample, self.imu_stamps, imu)
        return max((int(at[count - 1]), RANKS[kind]) for kind, at, count in streams if count)

    def after(self, tracks: int, imu: int) -> SampleArrays:
        """Samples without so many track speeds and IMU samples at the start."""
        first, second = slice(tracks, None), slice(imu, None)
        return SampleArrays(
            self.track_stamps[first],
            self.speeds[first],
            self.imu_stamps[second],
            self.rates[second],
            self.forces[second],
        )


class Sampled(NamedTuple):
    """Samples that were processed.

    Attributes:
        tracks: number of track speeds.
        imu: number of IMU samples.
        rates_used: number of yaw rates that were used.
        stuck: number of tracks that were newly found stuck.
        stood: number of IMU samples at which the robot stood.
    """

    tracks: int
    imu: int
    rates_used: int
    stuck: int
    stood: int


class Steps(Protocol):
    """Steps of a filter, which change its state and its record."""

    def take_track_speeds(self, stamp: int, left: float, right: float) -> int:
        """Add track speeds.

        See `icreckon.estimator.filter.filter_record.take_track_speeds`.
        """
        ...

    def take_imu(
        self, stamp: int, rate: float, force_x: float, force_y: float, *, uses_force: bool
    ) -> bool:
        """Add an IMU sample, and take the step that it ends; True if the yaw rate is used.

        Args:
            stamp: stamp of the sample, not before the estimate [ns].
            rate: yaw rate from the gyros [rad/s].
            force_x: specific force forward [m/s²], NaN if there is none.
            force_y: specific force to the left [m/s²], likewise.
            uses_force: update with the specific force, too.
        """
        ...

    def move(self, stamp: int) -> None:
        """Take a step without an IMU sample to a later stamp [ns]."""
        ...

    def begin(self, stamp: int) -> None:
        """Begin a step to a later stamp [ns], with a new fast slip."""
        ...

    def propagate(self, stamp: int) -> None:
        """Finish a step that `begin` has begun to the same stamp [ns]."""
        ...

    def take_samples(self, samples: SampleArrays, *, uses_force: bool) -> Sampled:
        """Take the steps of samples; stop before one that needs more than a step."""
        ...

    def take_position(
        self,
        stamp: int,
        fix: tuple[float, float, float],
        antenna: tuple[float, float],
        *,
        ahead: bool,
        mode: int,
        interval: float,
        rejected_for: float,
    ) -> PositionUpdate:
        """Update with a position fix.

        Args:
            stamp: its stamp [ns].
            fix: x, y [m] and the variance of each [m²].
            antenna: place of the antenna in base_link, forward and left [m].
            ahead: it lies ahead of the estimate, before the end of the next step.
            mode: one of `icreckon.estimator.engine.fixes`: skipped, gated or forced.
            interval: time since the fix before, as far as the gate counts it [s].
            rejected_for: time of rejected fixes so far [s].
        """
        ...


class StepEngine(Protocol):
    """Factory of the records and steps of a filter."""

    def make_record(self, record: Record) -> Record:
        """Make a record of a filter from its initial values."""
        ...

    def make_steps(
        self,
        ekf: Ekf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        record: FilterRecord,
        readings: QuietReadings,
    ) -> Steps:
        """Make the steps of a filter.

        Args:
            ekf: the filter; its consider states and wander are set.
            disturbances: its process noise.
            robot: its robot.
            settings: its settings.
            record: record of its inputs, from `make_record`.
            readings: yaw-rate readings of a standstill.
        """
        ...
