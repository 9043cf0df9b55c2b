"""Pose and twist in three dimensions: height, and roll and pitch by gravity."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import rpy_to_quaternion
from icreckon.estimator.motion.icr import GRAVITY

# Rows of the states x, y, yaw and z (`s.MOVED`), and of roll and pitch, in x, y, z, roll, pitch, yaw.
ROWS_OF_MOVED, ROLL, PITCH = (0, 1, 5, 2), 3, 4


class Pose3d(NamedTuple):
    """Pose of base_link in odom, which is gravity-aligned (REP-103, REP-105).

    Attributes:
        position: (3,) x, y, z [m].
        rpy: (3,) fixed-axis roll, pitch, yaw [rad]; yaw counts full turns.
        covariance: (6, 6) covariance of position and `rpy`, in the order of geometry_msgs.
    """

    position: Floats
    rpy: Floats
    covariance: Floats

    @property
    def quaternion(self) -> Floats:
        """(4,) the attitude, in ROS order x, y, z, w."""
        return rpy_to_quaternion(*self.rpy)


class Twist3d(NamedTuple):
    """Velocity of base_link in its own axes.

    Attributes:
        linear: (3,) forward, left, up [m/s]; up is zero.
        angular: (3,) about these axes [rad/s]; NaN about the first two without gyros for them.
        covariance: (6, 6) covariance of both, in the order of geometry_msgs; NaN likewise, and of the
            velocity upward, which is not estimated.
    """

    linear: Floats
    angular: Floats
    covariance: Floats


def roll_pitch(gravity: ArrayLike) -> Floats:
    """Roll and pitch (..., 2) [rad] by gravity along the ground (..., 2) [m/s²]."""
    shares = np.clip(np.asarray(gravity, dtype=float) / GRAVITY, -0.99, 0.99)
    pitch = np.arcsin(shares[..., 0])
    roll = np.arcsin(np.clip(-shares[..., 1] / np.cos(pitch), -0.99, 0.99))
    return np.stack([roll, pitch], axis=-1)


def spatial_of(states: Floats, sigmas: Floats) -> tuple[Floats, Floats]:
    """Height, roll and pitch (n, 3) [m, rad, rad] of states (n, SIZE), and sigmas."""
    # Roll is by gravity to the left, pitch by that forward; sigmas are for small angles.
    tilt_sigmas = sigmas[:, [s.GRAVITY_Y, s.GRAVITY_X]] / GRAVITY
    spatial = np.column_stack([states[:, s.Z], roll_pitch(states[:, s.GRAVITY])])
    return spatial, np.column_stack([sigmas[:, s.Z], tilt_sigmas])


def pose3d_of(x: Floats, P: Floats) -> Pose3d:
    """Pose of a state (SIZE,) with its covariance (SIZE, SIZE)."""
    roll, pitch = roll_pitch(x[s.GRAVITY]).tolist()
    by_state = np.zeros((6, len(x)))
    by_state[ROWS_OF_MOVED, range(s.MOVED.start, s.MOVED.stop)] = 1.0
    # sin(pitch) = gravity_x / g, sin(roll) cos(pitch) = -gravity_y / g.
    pitch_by_x = 1.0 / (GRAVITY * math.cos(pitch))
    by_state[PITCH, s.GRAVITY_X] = pitch_by_x
    by_state[ROLL, s.GRAVITY_X] = math.tan(roll) * math.tan(pitch) * pitch_by_x
    by_state[ROLL, s.GRAVITY_Y] = -pitch_by_x / math.cos(roll)
    position, rpy = x[[s.X, s.Y, s.Z]], np.array([roll, pitch, x.item(s.YAW)])
    return Pose3d(position, rpy, by_state @ P @ by_state.T)


def twist3d_of(twist: Floats, twist_P: Floats, tilt_rates: Floats, rates_P: Floats) -> Twist3d:
    """Velocity of a planar twist (3,), and of rates of roll and pitch (2,) [rad/s]."""
    # Rows: forward, left, up, and the rates about them.
    covariance, planar = np.zeros((6, 6)), [0, 1, 5]
    covariance[np.ix_(planar, planar)] = twist_P
    covariance[3:5, 3:5], covariance[2, 2] = rates_P, np.nan
    linear, angular = np.append(twist[:2], 0.0), np.append(tilt_rates, twist[2])
    return Twist3d(linear, angular, covariance)
