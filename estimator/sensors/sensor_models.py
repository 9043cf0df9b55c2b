"""What each sensor should read, by the state: one scalar measurement and its Jacobian row at a time.

A measurement is z = h(x) + noise. Each function here returns the residual z - h(x) at the present state,
the row dh/dx (SIZE,), and the variance of the noise. Where several are taken one after the other at one
linearisation, the later ones' residuals allow for what the earlier ones have moved.

What the IMU should read is written for plain Python and for numba (`estimator.tracing.jit_kernel`), in
functions of numbers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.measurements import STANDSTILL_SIGMA, ImuSample, Vector3
from icreckon.estimator.motion.motion_model import TwistModel
from icreckon.estimator.robot.robot_file import Robot

# Of a standing robot's velocity.
STANDSTILL_VARIANCE = tuple(sigma * sigma for sigma in STANDSTILL_SIGMA)
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


class ImuConstants(NamedTuple):
    """What the readings of an IMU depend on.

    Attributes:
        gyro_density: of its noise [rad²/s].
        accelerometer_density: of its noise [m²/s³].
        x: of the IMU in base_link, forward [m].
        y: to the left [m].
    """

    gyro_density: float
    accelerometer_density: float
    x: float
    y: float


class Forecast(NamedTuple):
    """What an accelerometer should read.

    Attributes:
        predicted: without its bias [m/s²].
        by_v_x: derivative by the speed forward [1/s].
        by_w: derivative by the yaw rate [m/s].
        variance: of the reading [m²/s⁴].
    """

    predicted: float
    by_v_x: float
    by_w: float
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

    Attributes:
        constants: of its IMU.
    """

    def __init__(self, robot: Robot) -> None:
        imu = self._imu = robot.imu
        self.constants = ImuConstants(
            imu.gyro_noise_density**2,
            imu.accelerometer_noise_density**2,
            imu.position[0],
            imu.position[1],
        )
        self._leftward: list[float]
        self._upward: list[float]
        _, self._leftward, self._upward = robot.imu_rotation.tolist()

    def yaw_rate(self, sample: ImuSample) -> float:
        """Rate about base_link's z axis as the gyros say [rad/s]."""
        if self._imu.gyro_axes == "z":
            return sample.angular_velocity[2] / (self._upward[2] * self._imu.gyro_scale)
        return _dot(self._upward, sample.angular_velocity) / self._imu.gyro_scale

    def yaw_rates(self, angular_velocities: Floats) -> Floats:
        """The same of samples (n, 3) [rad/s]."""
        x, y, z = angular_velocities.T
        if self._imu.gyro_axes == "z":
            return np.asarray(z / (self._upward[2] * self._imu.gyro_scale))
        return np.asarray(_dot(self._upward, (x, y, z)) / self._imu.gyro_scale)

    def to_the_left_of(self, forces: Floats) -> Floats:
        """Of specific forces (n, 3), what `to_the_left` says [m/s²]."""
        return np.asarray(_dot(self._leftward, forces.T))

    def to_the_left(self, force: Vector3) -> float:
        """Of a specific force in the IMU's axes, the part to the left of base_link [m/s²]."""
        return _dot(self._leftward, force)

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
        by_turning = model.by_speeds[2].tolist()
        variance = gyro_variance(self.constants, interval, by_turning, change)
        return Reading(rate - scale * w - x.item(s.GYRO_BIAS), row, variance)

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
        forecast = accelerometer_forecast(
            self.constants,
            interval,
            model.twist.tolist(),
            model.by_speeds.tolist(),
            change,
            slip_density,
        )
        row = forecast.by_w * model.jacobian[2] + forecast.by_v_x * model.jacobian[0]
        row[s.ACCELEROMETER_BIAS] += 1.0
        predicted = forecast.predicted + linearised_at.item(s.ACCELEROMETER_BIAS)
        residual = self.to_the_left(force) - predicted - shift(row, x, linearised_at)
        return Reading(residual, row, forecast.variance)


def twist_component(
    axis: int, value: float, variance: float, model: TwistModel, linearised_at: Floats, x: Floats
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
    return Reading(value - model.twist.item(axis) - shift(row, x, linearised_at), row, variance)


def gyro_variance(
    imu: ImuConstants, interval: float, by_turning: Any, change: TrackChange
) -> float:
    """Of a reading of the gyro against the yaw rate of the model.

    Args:
        imu: the IMU.
        interval: time between samples [s].
        by_turning: (2,) derivative of the yaw rate by the track speeds.
        change: of the track speeds.
    """
    # The newest track speeds are averages of the time before, so they come late.
    late = _along(by_turning, change.acceleration) * change.age
    return imu.gyro_density / interval + late * late


def accelerometer_forecast(
    imu: ImuConstants,
    interval: float,
    twist: Any,
    by_speeds: Any,
    change: TrackChange,
    slip_density: float,
) -> Forecast:
    """What the accelerometer should read; arguments as those of `SensorModels.accelerometer`.

    Args:
        imu: the IMU.
        interval: time between samples [s].
        twist: (3,) of base_link.
        by_speeds: (3, 2) its derivative by the track speeds.
        change: of the track speeds.
        slip_density: of the change of the sideways slip [m²/s³].
    """
    v_x, w = twist[0], twist[2]
    by_left, by_turning = by_speeds[1], by_speeds[2]
    # What the kinematics change by, from the change of the track speeds.
    dv_y, dw = _along(by_left, change.acceleration), _along(by_turning, change.acceleration)
    # The slip's own change over the sample, what comes late of the derivative, and its noise.
    white = (imu.accelerometer_density + slip_density) / interval
    turning = dw * imu.x
    late = (ACCELERATION_DOUBT * ACCELERATION_DOUBT) * (dv_y * dv_y + turning * turning)
    of_left, of_right = by_left[0] + imu.x * by_turning[0], by_left[1] + imu.x * by_turning[1]
    noise = change.speed_variance * (of_left * of_left + of_right * of_right)
    return Forecast(
        dv_y + w * v_x + turning - w * w * imu.y,
        w,
        v_x - 2.0 * w * imu.y,
        white + late + noise / (change.window * change.window),
    )


def shift(row: Floats, x: Floats, since: Floats) -> float:
    """How far a prediction has moved with the state since an earlier one; for numba, too.

    Added up in order, so that it is the same to the last bit whoever does it.

    Args:
        row: (SIZE,) Jacobian of the prediction.
        x: (SIZE,) the state.
        since: (SIZE,) the earlier state.
    """
    moved = 0.0
    for part in row * (x - since):
        moved += part
    return float(moved)


def _along(by_speeds: Any, acceleration: tuple[float, float]) -> float:
    return by_speeds[0] * acceleration[0] + by_speeds[1] * acceleration[1]  # type: ignore[no-any-return]


def _dot(a: Any, b: Any) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]
