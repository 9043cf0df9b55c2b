"""Settings of everything that turns samples into inputs of a step."""

from typing import NamedTuple

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings

MOST_FRICTION = 2.0  # coefficient of friction beyond that of any tyre, bumps included [-]
# Standard deviations within which a gyro's bias lies, and at least this [rad/s]: 20 deg/s, the
# zero-rate output of the coarsest gyros (data sheet of the MPU-6050).
BIAS_SIGMAS, LEAST_BIAS_RANGE = 5.0, 0.35
# Usual change of a gyro's bias between standstills, as a share of its initial standard deviation.
USUAL_CHANGE = 0.5


class InputSettings(NamedTuple):
    """Settings of held track speeds and standstill, for plain Python and for numba."""

    hold: float  # age from which track speeds are stale [s]
    hold_ns: int  # `hold` in whole nanoseconds
    gap_acceleration: float  # random walk of speeds that are stale or stuck [m/s/√s]
    fastest: float  # highest speed of a track [m/s]
    track_density: float  # error density of a track's speed by the noise of its sensor [m²/s]
    track_speed: float  # slower tracks are stopped [m/s]
    duration_ns: int  # duration of a standstill before it is detected [ns]
    quiet_gyro: float  # yaw rates within this of their mean are always quiet [rad/s]
    track_width: float  # effective track width by the robot file [m]
    yaw_acceleration: float  # upper bound of the angular acceleration by friction [rad/s²]
    gyro_range: float  # range of the gyro; 0 if unknown [rad/s]
    gyro_bias: float  # its bias at the start [rad/s]
    most_bias: float  # largest difference of any bias from `gyro_bias` [rad/s]
    usual_change: float  # usual change of the bias between standstills [rad/s]
    gyro_noise_density: float  # noise density of the gyro in the robot file [rad/s/√Hz]
    accelerometer_noise_density: float  # that of the accelerometers [m/s²/√Hz]
    undetected_share: float  # slip of both tracks that no sensor measures, over their speed [-]
    undetected_time: float  # time for which it lasts [s]


def input_settings(robot: Robot, settings: Settings) -> InputSettings:
    """Settings of a robot's filter."""
    standstill, vehicle = settings.standstill, robot.vehicle
    # Tracks that pull in opposite directions with all friction turn a plate of the contact's outline:
    # torque mu m g width / 2, moment of inertia m (width² + length²) / 12.
    width, length = vehicle.track_gauge, 2.0 * vehicle.half_contact_length
    yaw_acceleration = MOST_FRICTION * GRAVITY * 6.0 * width / (width * width + length * length)
    return InputSettings(
        float(settings.hold),
        int(settings.hold / NANOSECOND),
        float(settings.gap_acceleration),
        float(vehicle.max_track_speed),
        float(robot.tracks.speed_noise_density**2),
        float(standstill.track_speed),
        int(standstill.duration * 1e9),
        float(standstill.quiet_gyro),
        float(width * robot.indices.eta0),
        float(yaw_acceleration),
        float(robot.imu.gyro_range),
        float(robot.imu.gyro_bias),
        float(max(LEAST_BIAS_RANGE, BIAS_SIGMAS * robot.imu.gyro_bias_sigma)),
        float(USUAL_CHANGE * robot.imu.gyro_bias_sigma),
        float(robot.imu.gyro_noise_density),
        float(robot.imu.accelerometer_noise_density),
        float(robot.undetected_slip.share),
        float(robot.undetected_slip.time),
    )
