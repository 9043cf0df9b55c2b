"""Interface to the filter's algebra, and to a whole compiled step."""

from __future__ import annotations

from typing import Protocol

from icreckon.estimator.base.records import Record
from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.standstill import QuietReadings


class WholeStep(Protocol):
    """Whole steps of a filter, compiled; they change its record as the reference does."""

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
            stamp: stamp of the sample, later than the estimate [ns].
            rate: yaw rate from the gyros [rad/s].
            force_x: specific force forward [m/s²], NaN if there is none.
            force_y: specific force to the left [m/s²], likewise.
            uses_force: update with the specific force, too.
        """
        ...

    def move(self, stamp: int) -> None:
        """Take a step without an IMU sample to a later stamp [ns]."""
        ...


class StepEngine(Protocol):
    """Factory of the filter's algebra, of its records, and of a whole step."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """Make the filter of a motion model."""
        ...

    def make_record(self, record: Record) -> Record:
        """Make a record of a filter from its initial values."""
        ...

    def make_step(
        self,
        ekf: IcrEkf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        record: FilterRecord,
        readings: QuietReadings,
    ) -> WholeStep | None:
        """Make the whole step of a filter; None if its parts are taken one at a time.

        Args:
            ekf: the filter.
            disturbances: its process noise.
            robot: its robot.
            settings: its settings.
            record: record of its inputs, from `make_record`.
            readings: yaw-rate readings of a standstill.
        """
        ...
