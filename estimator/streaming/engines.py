"""Engines of the filter: filterpy in Python, or the traced step at one lane."""

from __future__ import annotations

from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.filter.gate import Gate
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.filter.step_engine import StepEngine, WholeStep
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Engine, Settings


class PlainEngine:
    """filterpy's EKF, one measurement at a time."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """See `StepEngine`."""
        return IcrEkf(model)

    def make_step(
        self,
        ekf: IcrEkf,  # noqa: ARG002
        disturbances: Disturbances,  # noqa: ARG002
        robot: Robot,  # noqa: ARG002
        settings: Settings,  # noqa: ARG002
        gyro: Gate,  # noqa: ARG002
        accelerometer: Gate,  # noqa: ARG002
    ) -> None:
        """See `StepEngine`."""
        return


class CompiledEngine:
    """Motion model and whole step traced and compiled, for one lane."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """See `StepEngine`."""
        from icreckon.estimator.engine.lane_filter import LaneEkf

        return LaneEkf(model)

    def make_step(
        self,
        ekf: IcrEkf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        gyro: Gate,
        accelerometer: Gate,
    ) -> WholeStep | None:
        """See `StepEngine`."""
        from icreckon.estimator.engine.lane_filter import LaneEkf, LaneStep

        if not isinstance(ekf, LaneEkf):
            return None
        return LaneStep(ekf, disturbances, robot, settings, gyro, accelerometer)


def engine_of(name: Engine) -> StepEngine:
    """Engine by the name that `Settings.engine` has for it."""
    return PlainEngine() if name == "plain" else CompiledEngine()
