"""Attitude of a run: roll and pitch by the estimated slope, and yaw."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import yaw_to_quaternion
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.streaming.outputs import Run
from icreckon.replay.bags.messages import UNUSED_VARIANCE


class Attitude(NamedTuple):
    """Attitude of base_link in odom.

    Attributes:
        quaternions: (n, 4) in ROS order x, y, z, w.
        variances: (n, 2) of roll and pitch [rad²]; 1e6 if they are not estimated.
    """

    quaternions: Floats
    variances: Floats


def planar_attitude(yaw: Floats) -> Attitude:
    """Attitude on level ground, of (n,) yaw [rad]."""
    return Attitude(yaw_to_quaternion(yaw), np.full((len(yaw), 2), UNUSED_VARIANCE))


def attitude_of(one: Run) -> Attitude:
    """Attitude of the rows of a run.

    Roll and pitch are those of gravity along the ground, which the filter estimates unless the ground is
    level by the robot file.

    Args:
        one: the run.
    """
    yaw, sigmas = one.trajectory.poses[:, 2], one.state_sigmas[:, s.GRAVITY].astype(float)
    if not sigmas.any():
        return planar_attitude(yaw)
    forward, left = np.clip(one.states[:, s.GRAVITY].astype(float).T / GRAVITY, -0.99, 0.99)
    pitch = np.arcsin(forward)
    roll = np.arcsin(np.clip(-left / np.cos(pitch), -1.0, 1.0))
    variances = (sigmas / (GRAVITY * np.cos(pitch)[:, None])) ** 2
    return Attitude(_quaternions(roll, pitch, yaw), variances[:, ::-1])


def _quaternions(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """Quaternions (n, 4) of fixed-axis roll, pitch, yaw (n,) [rad]."""
    (c_r, s_r), (c_p, s_p), (c_y, s_y) = (
        (np.cos(0.5 * angle), np.sin(0.5 * angle)) for angle in (roll, pitch, yaw)
    )
    return np.column_stack(
        [
            s_r * c_p * c_y - c_r * s_p * s_y,
            c_r * s_p * c_y + s_r * c_p * s_y,
            c_r * c_p * s_y - s_r * s_p * c_y,
            c_r * c_p * c_y + s_r * s_p * s_y,
        ]
    )
