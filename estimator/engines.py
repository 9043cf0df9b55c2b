"""The two engines of the filter: plain Python, and the same compiled, imported when asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimator.ekf import IcrEkf
from estimator.gating import Gate
from estimator.motion_model import MotionModel
from estimator.process_noise import Disturbances
from estimator.sensor_models import SensorModels
from estimator.settings import Engine

if TYPE_CHECKING:
    from estimator.compiled_step import CompiledStep


def make_ekf(engine: Engine, model: MotionModel) -> IcrEkf:
    """A filter of an engine."""
    if engine == "plain":
        return IcrEkf(model)
    from estimator.compiled_ekf import CompiledEkf

    return CompiledEkf(model)


def make_step(
    engine: Engine,
    ekf: IcrEkf,
    disturbances: Disturbances,
    sensors: SensorModels,
    gyro: Gate,
    accelerometer: Gate,
) -> CompiledStep | None:
    """What takes an IMU sample at once, of an engine that has it; see `CompiledStep`."""
    if engine == "plain":
        return None
    from estimator.compiled_ekf import CompiledEkf
    from estimator.compiled_step import CompiledStep

    if not isinstance(ekf, CompiledEkf):
        return None
    return CompiledStep(ekf, disturbances, sensors, gyro, accelerometer)
