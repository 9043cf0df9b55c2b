"""Prior of a filter: motion model, initial state, process noise."""

import math
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import SettingError, nearest_hint
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.robot import variants
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import Variant, state_names


class Assumptions(NamedTuple):
    """Prior of a filter."""

    model: MotionModel  # a new motion model
    state: Floats  # (SIZE,) initial state, at the origin
    sigmas: Floats  # (SIZE,) its standard deviations; zero for pose and states not estimated
    disturbances: Disturbances  # the process noise


def assumptions(robot: Robot, variant: Variant, settings: Settings) -> Assumptions:
    """Make the prior of a filter; `EstimatorError` if considered states are unknown."""
    adaptation = settings.adaptation or variants.DEFAULT_ADAPTATION[variant.model]
    model = variants.motion_model(robot, variant)
    state, sigmas = np.zeros(s.SIZE), np.zeros(s.SIZE)
    state[s.PARAMETERS] = variants.initial_parameters(robot, variant)
    sigmas[s.PARAMETERS] = variants.parameter_sigmas(robot, variant, adaptation)
    state[s.GYRO_BIAS], state[s.TRACK_DIFFERENCE] = robot.imu.gyro_bias, robot.tracks.difference
    sigmas[s.GYRO_BIAS] = robot.imu.gyro_bias_sigma
    sigmas[s.ACCELEROMETER_BIASES] = robot.imu.accelerometer_bias_sigma
    sigmas[s.GRAVITY] = robot.slope.sigma
    sigmas[s.TRACK_SCALE] = robot.tracks.scale_sigma
    sigmas[s.TRACK_DIFFERENCE] = robot.tracks.difference_sigma
    sigmas[s.GYRO_SCALE] = robot.imu.gyro_scale_sigma
    slip = settings.slip or variants.slip_of(robot, variant)
    disturbances = Disturbances(robot, slip, sigmas[s.PARAMETERS] * adaptation.walk)
    if robot.imu.gyro_axes == "xyz":
        # Biases of roll and pitch rate may be as large as that of the yaw rate is.
        largest_bias = math.hypot(robot.imu.gyro_bias, robot.imu.gyro_bias_sigma)
        sigmas[[s.GYRO_BIAS_X, s.GYRO_BIAS_Y]] = largest_bias
        disturbances.bias_walk[[s.GYRO_BIAS_X, s.GYRO_BIAS_Y]] = robot.imu.gyro_bias_walk
    for index in considered_states(variant, settings):
        disturbances.bias_walk[index] = disturbances.parameter_walk[index] = 0.0
    return Assumptions(model, state, sigmas, disturbances)


def considered_states(variant: Variant, settings: Settings) -> tuple[int, ...]:
    """Indices of states that `Settings.considered` names; `SettingError` if unknown."""
    names = state_names(variant)
    allowed = [name for name in names[s.LEARNT] if name]  # unused parameters have no name
    for name in settings.considered:
        if name not in allowed:
            hint = nearest_hint(name, allowed)
            raise SettingError(f"Settings.considered cannot hold {name!r}{hint}")
    return tuple(sorted({names.index(name) for name in settings.considered}))
