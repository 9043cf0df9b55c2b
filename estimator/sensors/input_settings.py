"""Settings of everything that turns samples into inputs of a step."""

from __future__ import annotations

from typing import NamedTuple

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import Variant

# Standard deviations within which a gyro's bias lies, and at least so much [rad/s].
OF_BIAS, LEAST_TURN = 5.0, 0.1


class InputSettings(NamedTuple):
    """Settings of held track speeds and standstill, for plain Python and for numba.

    Attributes:
        hold: age from which track speeds are stale [s].
        hold_ns: `hold` in whole nanoseconds.
        gap_acceleration: random walk of stale speeds [m/s/√s].
        fastest: highest speed of a track [m/s].
        track_density: density of the error of a track's speed, from the noise of its sensor [m²/s].
        track_speed: slower tracks are stopped [m/s].
        duration_ns: duration of a standstill before it is detected [ns].
        quiet_gyro: largest distance of quiet yaw-rate readings from their mean [rad/s].
        gyro_range: range of the gyro; 0 if unknown [rad/s].
        gyro_bias: its bias at the start [rad/s].
        most_bias: no bias is further from that [rad/s].
        gyro_noise_density: noise density of the gyro in the robot file [rad/s/√Hz].
        accelerometer_noise_density: that of the accelerometers [m/s²/√Hz].
        undetected_share: slip of both tracks that nothing shows, as a share of their speed [-].
        undetected_time: how long it lasts [s].
        weighs_tracks: the motion model has the loads of the tracks, and explains one that slides for want
            of load.
    """

    hold: float
    hold_ns: int
    gap_acceleration: float
    fastest: float
    track_density: float
    track_speed: float
    duration_ns: int
    quiet_gyro: float
    gyro_range: float
    gyro_bias: float
    most_bias: float
    gyro_noise_density: float
    accelerometer_noise_density: float
    undetected_share: float
    undetected_time: float
    weighs_tracks: bool


def input_settings(robot: Robot, settings: Settings, variant: Variant) -> InputSettings:
    """Settings of a robot's filter."""
    standstill = settings.standstill
    return InputSettings(
        float(settings.hold),
        int(settings.hold / NANOSECOND),
        float(settings.gap_acceleration),
        float(robot.vehicle.max_track_speed),
        float(robot.tracks.speed_noise_density**2),
        float(standstill.track_speed),
        int(standstill.duration * 1e9),
        float(standstill.quiet_gyro),
        float(robot.imu.gyro_range),
        float(robot.imu.gyro_bias),
        float(max(LEAST_TURN, OF_BIAS * robot.imu.gyro_bias_sigma)),
        float(robot.imu.gyro_noise_density),
        float(robot.imu.accelerometer_noise_density),
        float(robot.undetected_slip.share),
        float(robot.undetected_slip.time),
        variant.weighs_tracks,
    )
