"""Engines of a streaming filter: filterpy in Python, or the compiled step."""

from __future__ import annotations

from icreckon.estimator.base.records import Record, shared_record
from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.filter.step_engine import StepEngine, WholeStep
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Engine, Settings
from icreckon.estimator.sensors.standstill import QuietReadings


class PlainEngine:
    """Engine in Python: filterpy's EKF, one part of a step at a time."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """Make the filter of a motion model, see `StepEngine`."""
        from icreckon.estimator.streaming.plain_ekf import PlainEkf

        return PlainEkf(model)

    def make_record(self, record: Record) -> Record:
        """Make a record of a filter, see `StepEngine`."""
        return record

    def make_step(
        self,
        ekf: IcrEkf,  # noqa: ARG002
        disturbances: Disturbances,  # noqa: ARG002
        robot: Robot,  # noqa: ARG002
        settings: Settings,  # noqa: ARG002
        record: FilterRecord,  # noqa: ARG002
        readings: QuietReadings,  # noqa: ARG002
    ) -> None:
        """Make no whole step: its parts are made one at a time."""
        return


class CompiledEngine:
    """Compiled engine: motion model and whole step traced, for one lane."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """Make the filter of a motion model, see `StepEngine`."""
        from icreckon.estimator.engine.lane_filter import LaneEkf

        return LaneEkf(model)

    def make_record(self, record: Record) -> Record:
        """Make a record of a filter, see `StepEngine`."""
        return shared_record(record)

    def make_step(
        self,
        ekf: IcrEkf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        record: FilterRecord,
        readings: QuietReadings,
    ) -> WholeStep | None:
        """Make the whole step of a filter, see `StepEngine`."""
        from icreckon.estimator.engine.lane_filter import LaneEkf, LaneStep

        if not isinstance(ekf, LaneEkf) or ekf.compiled is None:
            return None
        return LaneStep(ekf, disturbances, robot, settings, record, readings)


def engine_of(name: Engine) -> StepEngine:
    """Engine by its name in `Settings.engine`."""
    return PlainEngine() if name == "plain" else CompiledEngine()
