"""IMU: mounting, and equations of its predicted measurements.

The equations serve plain Python and compiled code (`icreckon.estimator.tracing`).
"""

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.measurements import STANDSTILL_SIGMA
from icreckon.estimator.robot.robot_file import Robot

# Variances of a standing robot's velocity about zero.
STANDSTILL_VARIANCE = tuple(sigma * sigma for sigma in STANDSTILL_SIGMA)
ACCELERATION_DOUBT = 0.3  # relative uncertainty of the change of the track speeds, due to its delay
# Time for which an error lasts that is as large as the centripetal acceleration [s]. In turns the
# accelerometers show errors of the model, which are not to be taken for slopes and biases.
CENTRIPETAL_DOUBT = 1.0


class Forecast(NamedTuple):
    """Predicted measurement of an accelerometer."""

    predicted: float  # prediction without gravity and bias [m/s²]
    by_across: float  # derivative by the velocity across the axis, to the left or forward [1/s]
    by_w: float  # derivative by the yaw rate [m/s]
    variance: float  # variance of the reading [m²/s⁴]


class TrackChange(NamedTuple):
    """Change of the track speeds, an input of IMU predictions."""

    acceleration: tuple[float, float]  # averaged, of the left and the right track [m/s²]
    variance: float  # variance of each, by the noise of the speeds [m²/s⁴]


class SensorModels:
    """Mounting of one robot's IMU.

    Attributes:
        imu_position: position of the IMU in base_link, forward and left [m].
        mounting: (6, 3) rates of base_link by the gyros: yaw, roll and pitch, these NaN with a gyro of
            one axis or on level ground; the reading of the gyro that shows most of the yaw; specific
            force forward and left by the accelerometers.
    """

    def __init__(self, robot: Robot) -> None:
        imu = robot.imu
        self.imu_position = imu.position[:2]
        forward, leftward, upward = robot.imu_rotation.tolist()
        rows = np.array([upward, forward, leftward])  # rows of yaw, roll and pitch
        if imu.gyro_axes == "z":
            rows[0] = 0.0, 0.0, 1.0 / upward[2]
        if imu.gyro_axes == "z" or robot.slope.sigma == 0.0:
            rows[1:] = np.nan
        most_upright = np.eye(3)[2 if imu.gyro_axes == "z" else np.argmax(np.abs(upward))]
        self.mounting = np.vstack([rows / imu.gyro_scale, most_upright, forward, leftward])

    def yaw_rates(self, angular_velocities: Floats) -> Floats:
        """Rates (...) about base_link's z axis of gyro samples (..., 3) [rad/s]."""
        return np.asarray(_dot(self.mounting[0], angular_velocities.T))

    def along_ground_of(self, forces: Floats) -> Floats:
        """Components (..., 2) forward and left of specific forces (..., 3) [m/s²]."""
        return np.stack([_dot(row, forces.T) for row in self.mounting[4:]], axis=-1)

    def rates(self, angular_velocities: Floats) -> Floats:
        """Rates (..., 4) of gyro samples (..., 3) [rad/s], see `mounting`."""
        return np.stack([_dot(row, angular_velocities.T) for row in self.mounting[:4]], axis=-1)


def accelerometer_forecast(
    position: Any,
    axis: int,
    density: float,
    interval: float,
    twist: Any,
    by_speeds: Any,
    change: TrackChange,
    slip_density: float,
) -> Forecast:
    """Predict the accelerometer measurement; see `reference.imu.accelerometer`.

    With v across the axis to the left (for the forward axis) or forward (for that to the left), and the
    IMU at (x, y): a_x = dv_x/dt - w v_y - y dw/dt - x w², a_y = dv_y/dt + w v_x + x dw/dt - y w².

    Args:
        position: position of the IMU in base_link, forward and left [m].
        axis: 0 for forward, 1 for left.
        density: noise density of the accelerometer [m²/s³].
        interval: time between samples [s].
        twist: (3,) twist of base_link.
        by_speeds: (3, 2) its derivative by the track speeds.
        change: change of the track speeds.
        slip_density: density of the change of the slip along the axis [m²/s³].
    """
    across, w = twist[1 - axis], twist[2]
    side = 1.0 if axis else -1.0
    lever, along = side * position[1 - axis], position[axis]
    by_axis, by_turning = (by_speeds[1] if axis else (0.5, 0.5)), by_speeds[2]
    # Change of the kinematic twist, from the change of the track speeds.
    dv, dw = _along(by_axis, change.acceleration), _along(by_turning, change.acceleration)
    # Variances of the slip's own change over the sample, of the derivative's delay, and of its noise.
    centripetal = w * w * (twist[0] * twist[0] + twist[1] * twist[1])
    white = (density + slip_density + CENTRIPETAL_DOUBT * centripetal) / interval
    turning = dw * lever
    late = (ACCELERATION_DOUBT * ACCELERATION_DOUBT) * (dv * dv + turning * turning)
    by_left, by_right = by_axis[0] + lever * by_turning[0], by_axis[1] + lever * by_turning[1]
    noise = change.variance * (by_left * by_left + by_right * by_right)
    predicted, by_across = dv + side * w * across + turning - w * w * along, side * w
    by_w = side * across - 2.0 * w * along
    return Forecast(predicted, by_across, by_w, white + late + noise)


def shift(row: Floats, x: Floats, since: Floats) -> float:
    """Change of a prediction by its Jacobian `row` (SIZE,) from state `since` to `x`."""
    # Summed in order, so that all callers agree to the last bit, numba too.
    shifted = 0.0
    for term in row * (x - since):
        shifted += term
    return float(shifted)


def _along(by_speeds: Any, acceleration: tuple[float, float]) -> float:
    """Rate of change by the accelerations of both tracks [m/s²]."""
    return by_speeds[0] * acceleration[0] + by_speeds[1] * acceleration[1]  # type: ignore[no-any-return]


def _dot(a: Any, b: Any) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]
