"""What each sensor should read, by the state: one scalar measurement and its Jacobian row at a time.

A measurement is z = h(x) + noise. Each function here returns the residual z - h(x) at the present state,
the row dh/dx (SIZE,), and the variance of the noise. Where several are taken one after the other at one
linearisation, the later ones' residuals allow for what the earlier ones have moved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator import state as s
from estimator.ekf import TwistModel
from estimator.frames import Floats, wrap_angle
from estimator.measurements import ImuSample, Vector3
from estimator.robot import Robot

# What a standing robot's velocity is known to be zero within [m/s, m/s, rad/s].
STANDSTILL_SIGMA = (1e-3, 1e-3, 1e-4)
# Share of the change of the track speeds that may be wrong because it comes late.
ACCELERATION_DOUBT = 0.2


class Reading(NamedTuple):
    """A scalar measurement set against its prediction.

    Attributes:
        residual: measured less predicted.
        row: (SIZE,) derivative of the prediction by the state.
        variance: of the measurement.
    """

    residual: float
    row: Floats
    variance: float


class TrackChange(NamedTuple):
    """How the track speeds change, for sensors that show it.

    Attributes:
        acceleration: of the left and the right track [m/s²].
        window: time that this is an average of [s].
        speed_variance: of each track's speed, from its sensor's noise [m²/s²].
        age: of what the track speeds are an average of [s].
    """

    acceleration: tuple[float, float]
    window: float
    speed_variance: float
    age: float


class SensorModels:
    """The sensors of one robot.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._imu = robot.imu
        self._leftward: list[float]
        self._upward: list[float]
        _, self._leftward, self._upward = robot.imu_rotation.tolist()

    def yaw_rate(self, sample: ImuSample) -> float:
        """Rate about base_link's z axis as the gyros say [rad/s]."""
        if self._imu.gyro_axes == "z":
            return sample.angular_velocity[2] / (self._upward[2] * self._imu.gyro_scale)
        return _dot(self._upward, sample.angular_velocity) / self._imu.gyro_scale

    def gyro(
        self, rate: float, interval: float, model: TwistModel, x: Floats, change: TrackChange
    ) -> Reading:
        """Yaw rate times scale, plus bias.

        Args:
            rate: as `yaw_rate` returns it [rad/s].
            interval: time between samples [s].
            model: the twist at `x`.
            x: (SIZE,) the state.
            change: of the track speeds.
        """
        w, scale = model.twist.item(2), 1.0 + x.item(s.GYRO_SCALE)
        row = scale * model.jacobian[2]
        row[s.GYRO_BIAS] += 1.0
        row[s.GYRO_SCALE] += w
        # The newest track speeds are averages of the time before, so they come late.
        late = _dot(model.by_speeds[2].tolist(), change.acceleration) * change.age
        return Reading(
            rate - scale * w - x.item(s.GYRO_BIAS),
            row,
            self._imu.gyro_noise_density**2 / interval + late**2,
        )

    def accelerometer(
        self,
        force: Vector3,
        interval: float,
        model: TwistModel,
        linearised_at: Floats,
        x: Floats,
        change: TrackChange,
        slip_density: float,
    ) -> Reading:
        """Specific force to the left: dv_y/dt + w v_x at the IMU's place, plus bias.

        The forward one says little: it is the change of the track speeds, which are better known.

        Args:
            force: in the IMU's axes [m/s²].
            interval: time between samples [s].
            model: the twist at `linearised_at`.
            linearised_at: (SIZE,) a state.
            x: (SIZE,) the state.
            change: of the track speeds.
            slip_density: of the change of the sideways slip [m²/s³].
        """
        imu = self._imu
        v_x, _, w = model.twist.tolist()
        l_x, l_y, _ = imu.position
        # What the kinematics change by, from the change of the track speeds.
        _, by_left, by_turning = model.by_speeds.tolist()
        dv_y, dw = _dot(by_left, change.acceleration), _dot(by_turning, change.acceleration)
        measured = _dot(self._leftward, force)
        bias = linearised_at.item(s.ACCELEROMETER_BIAS)
        predicted = dv_y + w * v_x + dw * l_x - w * w * l_y + bias
        row = (v_x - 2.0 * w * l_y) * model.jacobian[2] + w * model.jacobian[0]
        row[s.ACCELEROMETER_BIAS] += 1.0
        # The slip's own change over the sample, what comes late of the derivative, and its noise.
        white = (imu.accelerometer_noise_density**2 + slip_density) / interval
        late = ACCELERATION_DOUBT * math.hypot(dv_y, dw * l_x)
        by_change = [
            left + l_x * turning for left, turning in zip(by_left, by_turning, strict=True)
        ]
        noise = change.speed_variance * _dot(by_change, by_change) / change.window**2
        moved = float(row.dot(x - linearised_at))
        return Reading(measured - predicted - moved, row, white + late**2 + noise)


def twist_component(
    axis: int,
    value: float,
    variance: float,
    model: TwistModel,
    linearised_at: Floats,
    x: Floats,
) -> Reading:
    """One component of the body velocity.

    Args:
        axis: 0 forward, 1 to the left, 2 counter-clockwise.
        value: what it is measured to be [m/s] or [rad/s].
        variance: of the measurement.
        model: the twist at `linearised_at`.
        linearised_at: (SIZE,) a state.
        x: (SIZE,) the state.
    """
    row = model.jacobian[axis]
    moved = float(row.dot(x - linearised_at))
    return Reading(value - model.twist.item(axis) - moved, row, variance)


def pose_component(axis: int, value: float, variance: float, x: Floats) -> Reading:
    """One component of the pose: `state.X`, `state.Y` [m] or `state.YAW` [rad], the nearest turn."""
    row = np.zeros(s.SIZE)
    row[axis] = 1.0
    residual = value - x.item(axis)
    return Reading(float(wrap_angle(residual)) if axis == s.YAW else residual, row, variance)


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(left * right for left, right in zip(a, b, strict=True))
