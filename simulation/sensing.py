"""Sensor readings of a true motion: error-free readings, then errors."""

from typing import NamedTuple

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.series import (
    FixSeries,
    PoseSeries,
    TrackSpeedSeries,
    Truth,
    TwistSeries,
)
from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.base.random_streams import Streams
from icreckon.simulation.base.sampling import sample_times, to_stamps
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.encoders import with_encoder_errors
from icreckon.simulation.sensors.fixes import shown_times, with_fix_errors
from icreckon.simulation.sensors.imu import Imu, perfect_readings, with_inertial_errors
from icreckon.simulation.sensors.specs import (
    accelerometer_errors,
    encoder_errors,
    fix_errors,
    gyro_errors,
    noise_preset,
)
from icreckon.simulation.truth.true_motion import TrueMotion


class Perfect(NamedTuple):
    """Error-free sensor readings of a true motion.

    Attributes:
        tracks: (n, 2) mean speeds of the tracks since the sample before [m/s].
        imu: angular velocities (m, 3) [rad/s] and specific forces (m, 3) [m/s²] in the IMU's axes.
        fixes: (k, 3) poses [m, m, rad], those of outages included.
    """

    tracks: Floats
    imu: tuple[Floats, Floats]
    fixes: Floats


class Sensed(NamedTuple):
    """Sensor readings: track speeds, IMU, and fixes if the scenario has any."""

    tracks: TrackSpeedSeries
    imu: Imu
    fixes: FixSeries | None


def perfect(motion: TrueMotion, scenario: Scenario, robot: Robot) -> Perfect:
    """Error-free readings of a true motion at the sample times of a scenario."""
    duration, rate = scenario.duration, scenario.imu_rate
    errors = fix_errors(scenario.fixes, noise_preset(scenario.noise))
    return Perfect(
        motion.mean_track_speeds(sample_times(duration, scenario.track_rate)),
        perfect_readings(motion, sample_times(duration, rate), rate, robot),
        motion.poses_at(shown_times(_fix_times(scenario), errors)),
    )


def sensed(true: Perfect, scenario: Scenario, robot: Robot, streams: Streams) -> Sensed:
    """Add the sensor errors of a scenario to error-free readings.

    Args:
        true: error-free readings.
        scenario: rates and errors of the sensors.
        robot: the robot that carries the sensors.
        streams: draw the errors.
    """
    duration, preset = scenario.duration, noise_preset(scenario.noise)
    tracks = with_encoder_errors(
        true.tracks,
        sample_times(duration, scenario.track_rate),
        scenario.track_rate,
        encoder_errors(robot, scenario.encoders, preset),
        streams.tracks,
    )
    imu = with_inertial_errors(
        true.imu,
        sample_times(duration, scenario.imu_rate),
        scenario.imu_rate,
        robot,
        gyro_errors(robot, scenario.gyro, preset),
        accelerometer_errors(robot, scenario.accelerometer, preset),
        streams.gyro,
        streams.accelerometer,
    )
    if scenario.fix_rate == 0.0:
        return Sensed(tracks, imu, None)
    errors = fix_errors(scenario.fixes, preset)
    times = _fix_times(scenario)
    return Sensed(
        tracks, imu, with_fix_errors(true.fixes, times, errors, scenario.outages, streams.fixes)
    )


def truth_of(motion: TrueMotion, times: Floats) -> Truth:
    """Truth at given times (n,) [s], as stored in a log."""
    stamps, spatial = to_stamps(times), motion.spatial_at(times)
    return Truth(
        poses=PoseSeries(stamps, motion.poses_at(times), spatial),
        twists=TwistSeries(stamps, motion.twists_at(times)),
        tracks=TrackSpeedSeries(stamps, motion.track_speeds_at(times)),
        source=motion.source,
    )


def _fix_times(scenario: Scenario) -> Floats:
    """Arrival times of fixes, those in outages included [s]."""
    if scenario.fix_rate == 0.0:
        return sample_times(0.0, 1.0)[:0]
    return sample_times(scenario.duration, scenario.fix_rate)
