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
    by_across: float  # derivative by the velocity across the axis [1/s]
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
        mounting: (6, 3) axes in the IMU along which readings are projected. Rows 0 to 2: rates of yaw,
            roll and pitch of base_link; roll and pitch are NaN with a gyro of one axis or on level
            ground. Row 3: reading of the most upright gyro. Rows 4 and 5: force forward and left.
    """

    def __init__(self, robot: Robot) -> None:
        imu = robot.imu
        self.imu_position = imu.position[:2]
        forward, leftward, upward = robot.imu_rotation.tolist()
        rows = np.array([upward, forward, leftward])  # rows of yaw, roll and pitch
        if imu.gyro_axes == "z":
            # One axis reads the yaw rate times the cosine of its tilt.
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

    With the IMU at (x, y) in base_link: a_x = dv_x/dt - w v_y - y dw/dt - x w² (forward),
    a_y = dv_y/dt + w v_x + x dw/dt - y w² (left).

    Args:
        position: position of the IMU in base_link, forward and left [m].
        axis: 0 for forward, 1 for left.
        density: noise density of the accelerometer [m²/s³].
        interval: time between samples [s].
        twist: (3,) twist of base_link.
        by_speeds: (3, 2) its derivative by the speeds of the left and the right track.
        change: change of the track speeds.
        slip_density: density of the change of the slip along the axis [m²/s³].
    """
    v_across, w = twist[1 - axis], twist[2]
    sign = 1.0 if axis else -1.0  # of w v and of dw/dt in the equation of the axis
    lever, along = sign * position[1 - axis], position[axis]
    # The forward speed is the mean of both tracks.
    v_by_speeds, w_by_speeds = (by_speeds[1] if axis else (0.5, 0.5)), by_speeds[2]
    dv, dw = _rate_of(v_by_speeds, change.acceleration), _rate_of(w_by_speeds, change.acceleration)
    tangential = dw * lever
    # Variances of noise, slip and model errors in turns; of the delay of dv and dw; of their noise.
    centripetal_square = w * w * (twist[0] * twist[0] + twist[1] * twist[1])
    white = (density + slip_density + CENTRIPETAL_DOUBT * centripetal_square) / interval
    late = (ACCELERATION_DOUBT * ACCELERATION_DOUBT) * (dv * dv + tangential * tangential)
    by_left = v_by_speeds[0] + lever * w_by_speeds[0]
    by_right = v_by_speeds[1] + lever * w_by_speeds[1]
    noise = change.variance * (by_left * by_left + by_right * by_right)
    predicted, by_across = dv + sign * w * v_across + tangential - w * w * along, sign * w
    by_w = sign * v_across - 2.0 * w * along
    return Forecast(predicted, by_across, by_w, white + late + noise)


def shift(row: Floats, x: Floats, since: Floats) -> float:
    """Change of a prediction by its Jacobian `row` (SIZE,) from state `since` to `x`."""
    # Summed in order, so that all callers agree to the last bit, numba too.
    shifted = 0.0
    for term in row * (x - since):
        shifted += term
    return float(shifted)


def _rate_of(by_speeds: Any, acceleration: tuple[float, float]) -> float:
    """Rate of change of a speed or yaw rate, by accelerations of the tracks [m/s²]."""
    return by_speeds[0] * acceleration[0] + by_speeds[1] * acceleration[1]  # type: ignore[no-any-return]


def _dot(a: Any, b: Any) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]
