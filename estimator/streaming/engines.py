"""Engines of a streaming filter: its steps compiled, or in Python."""

from __future__ import annotations

from icreckon.estimator.base.records import Record, shared_record
from icreckon.estimator.filter.ekf import Ekf
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.filter.step_engine import StepEngine, Steps
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Engine, Settings
from icreckon.estimator.sensors.standstill import QuietReadings


class NumbersEngine:
    """Engine on the steps of `icreckon.estimator.engine`.

    Args:
        compiles: compile them; otherwise they are executed in Python, to be read and debugged.
    """

    def __init__(self, *, compiles: bool) -> None:
        self._compiles = compiles

    def make_record(self, record: Record) -> Record:
        """Make a record of a filter, see `StepEngine`."""
        return shared_record(record) if self._compiles else record

    def make_steps(
        self,
        ekf: Ekf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        record: FilterRecord,
        readings: QuietReadings,
    ) -> Steps:
        """Make the steps of a filter, see `StepEngine`."""
        from icreckon.estimator.engine.lane_filter import LaneSteps

        parts = ekf, disturbances, robot, settings, record, readings
        return LaneSteps(*parts, compiles=self._compiles)


def engine_of(name: Engine) -> StepEngine:
    """Engine by its name in `Settings.engine`."""
    return NumbersEngine(compiles=name == "compiled")
