"""Measurement models of the IMU: z, H and R of the gyro and of the accelerometers."""

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.motion_model import TwistModel
from icreckon.estimator.sensors.imu_noise import ImuNoise
from icreckon.estimator.sensors.measurement_models import Linearised
from icreckon.estimator.sensors.sensor_models import TrackChange, accelerometer_forecast, shift


class StepTwist(NamedTuple):
    """Twist of a step, and the other inputs of the IMU's predicted measurements."""

    model: TwistModel  # the twist at `x`
    x: Floats  # (SIZE,) state of the linearisation
    interval: float  # time between samples [s]
    change: TrackChange  # change of the track speeds
    noise: ImuNoise  # noise of the IMU


def gyro(rate: float, at: StepTwist, turn: float) -> Linearised:
    """Compare a yaw rate with that of the robot times scale, plus bias.

    Args:
        rate: reading of the gyro [rad/s].
        at: twist and inputs.
        turn: yaw rate by which its scale counts, without the noise of the track speeds [rad/s].
    """
    model, x = at.model, at.x
    w, scale = model.twist.item(2), 1.0 + x.item(s.GYRO_SCALE)
    H = scale * model.jacobian[2:]
    H[0, s.GYRO_BIAS] += 1.0
    H[0, s.GYRO_SCALE] += turn
    z = rate - scale * w - x.item(s.GYRO_BIAS)
    return Linearised(np.array([z]), H, np.array([[at.noise.gyro / at.interval]]))


def accelerometer(
    position: tuple[float, float],
    axis: int,
    force: float,
    at: StepTwist,
    x: Floats,
    slip_density: float,
) -> Linearised:
    """Compare a specific force with acceleration less gravity, plus bias.

    Args:
        position: position of the IMU in base_link, forward and left [m].
        axis: axis of base_link, 0 for forward, 1 for left.
        force: specific force along the axis [m/s²].
        at: twist and inputs at the state of the linearisation.
        x: (SIZE,) the state, which updates may have moved since then.
        slip_density: density of the change of the slip along the axis [m²/s³].
    """
    model = at.model
    forecast = accelerometer_forecast(
        position,
        axis,
        at.noise[1 + axis],
        at.interval,
        model.twist.tolist(),
        model.by_speeds.tolist(),
        at.change,
        slip_density,
    )
    row = forecast.by_w * model.jacobian[2] + forecast.by_across * model.jacobian[1 - axis]
    gravity, bias = s.GRAVITY_X + axis, s.ACCELEROMETER_BIAS_X + axis
    row[gravity] -= 1.0
    row[bias] += 1.0
    predicted = forecast.predicted + at.x.item(bias) - at.x.item(gravity)
    z = force - predicted - shift(row, x, at.x)
    return Linearised(np.array([z]), row[None], np.array([[forecast.variance]]))
