"""Readings of a true motion by one sensor, errors included."""

from typing import Any

from numpy.random import Generator

from icreckon import FixSeries, Robot, TrackSpeedSeries
from icreckon.estimator.base.array_types import Floats
from icreckon.simulation.sensors.encoders import EncoderErrors, with_encoder_errors
from icreckon.simulation.sensors.fixes import FixErrors, measured_pose_times, with_fix_errors
from icreckon.simulation.sensors.imu import Imu, perfect_imu, with_inertial_errors
from icreckon.simulation.truth.true_motion import TrueMotion


def read_tracks(
    motion: TrueMotion, times: Floats, rate: float, errors: EncoderErrors, rng: Generator
) -> TrackSpeedSeries:
    return with_encoder_errors(motion.mean_track_speeds(times), times, rate, errors, rng)


def read_fixes(
    motion: TrueMotion, times: Floats, errors: FixErrors, outages: Any, rng: Generator
) -> FixSeries:
    poses = motion.poses_at(measured_pose_times(times, errors))
    return with_fix_errors(poses, times, errors, outages, rng)


def read_imu(motion: TrueMotion, times: Floats, rate: float, robot: Robot, *errors: Any) -> Imu:
    """With errors of gyro and accelerometer, and the generators of both."""
    perfect = perfect_imu(motion, times, rate, robot)
    return with_inertial_errors(perfect, times, rate, robot, *errors)
