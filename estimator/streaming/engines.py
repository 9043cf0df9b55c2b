"""The two engines of the filter: plain Python, and the same compiled, imported when asked for."""

from __future__ import annotations

from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.filter.gate import Gate
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.filter.step_engine import StepEngine, WholeStep
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.robot.settings import Engine
from icreckon.estimator.sensors.sensor_models import SensorModels


class PlainEngine:
    """filterpy's EKF, one thing at a time."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """See `StepEngine`."""
        return IcrEkf(model)

    def make_step(
        self,
        ekf: IcrEkf,  # noqa: ARG002
        disturbances: Disturbances,  # noqa: ARG002
        sensors: SensorModels,  # noqa: ARG002
        gyro: Gate,  # noqa: ARG002
        accelerometer: Gate,  # noqa: ARG002
    ) -> None:
        """See `StepEngine`."""
        return


class CompiledEngine:
    """Algebra and step compiled by numba."""

    def make_ekf(self, model: MotionModel) -> IcrEkf:
        """See `StepEngine`."""
        from icreckon.estimator.scalar_engine.compiled_ekf import CompiledEkf

        return CompiledEkf(model)

    def make_step(
        self,
        ekf: IcrEkf,
        disturbances: Disturbances,
        sensors: SensorModels,
        gyro: Gate,
        accelerometer: Gate,
    ) -> WholeStep | None:
        """See `StepEngine`."""
        from icreckon.estimator.scalar_engine.compiled_ekf import CompiledEkf
        from icreckon.estimator.scalar_engine.compiled_step import CompiledStep

        if not isinstance(ekf, CompiledEkf):
            return None
        return CompiledStep(ekf, disturbances, sensors, gyro, accelerometer)


def engine_of(name: Engine) -> StepEngine:
    """Engine by the name that `Settings.engine` has for it."""
    return PlainEngine() if name == "plain" else CompiledEngine()
