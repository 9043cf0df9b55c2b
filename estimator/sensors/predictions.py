"""Predicted pose and twist: now, or a little after the newest step.

A measurement between two IMU samples must not end the step: the pose would follow the track speeds alone,
and since the IMU does not move the pose, the next sample could not correct the slip. Such a measurement
is compared with a prediction ahead, and corrects the present state. Until its stamp the twist is assumed
constant, except for a new fast slip of unknown value.
"""

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.motion.motion_model import TwistModel
from icreckon.estimator.motion.propagation import step_on_se2

NO_NOISE = np.zeros((3, 3))


class Prediction(NamedTuple):
    """Predicted pose or twist at a stamp."""

    values: Floats  # (n,) x, y [m], yaw [rad], or v_x, v_y [m/s], w [rad/s], or z [m]
    H: Floats  # (n, SIZE) Jacobian by the present state
    R: Floats  # (n, n) covariance of the fast slip until then, which the state does not hold


def pose_now(x: Floats) -> Prediction:
    """Pose of a state (SIZE,)."""
    return Prediction(x[s.POSE].copy(), np.eye(3, len(x)), NO_NOISE)


def height_now(x: Floats) -> Prediction:
    """Height of a state (SIZE,)."""
    H = np.zeros((1, len(x)))
    H[0, s.Z] = 1.0
    return Prediction(x[[s.Z]], H, NO_NOISE[:1, :1])


def pose_ahead(x: Floats, model: TwistModel, density: Floats, elapsed: float) -> Prediction:
    """Predict the pose of a state (SIZE,) after some seconds at constant twist.

    `density` (3, 3) is that of the fast slip, see `filter.process_noise`.
    """
    twist, jacobian = _without_fast_slip(x, model)
    step, by_yaw, step_by_motion = step_on_se2(x.item(s.YAW), (twist * elapsed).tolist())
    by_motion = np.array(step_by_motion)
    H = by_motion @ jacobian * elapsed
    H[s.POSE, s.POSE] += np.eye(3)
    H[s.POSITION, s.YAW] += by_yaw
    return Prediction(x[s.POSE] + step, H, by_motion @ density @ by_motion.T * elapsed)


def point_on_robot(pose: Prediction, gravity: Floats, place: tuple[float, ...]) -> Prediction:
    """Position in odom of a point of the robot, by a predicted pose and gravity.

    Args:
        pose: pose of base_link.
        gravity: (2,) the states forward and left [m/s²]: a point above base_link leans over by them.
        place: the point in base_link, forward, left and up [m].
    """
    lean_by_gravity, yaw = place[2] / GRAVITY, pose.values.item(2)
    from_base = rotate(np.array(place[:2]) + lean_by_gravity * gravity, yaw)  # in odom [m]
    by_pose = np.eye(3)
    by_pose[:2, 2] = -from_base[1], from_base[0]
    values, H = pose.values.copy(), by_pose @ pose.H
    values[:2] += from_base
    H[:2, s.GRAVITY] += lean_by_gravity * rotate(np.eye(2), yaw).T
    return Prediction(values, H, by_pose @ pose.R @ by_pose.T)


def twist_now(model: TwistModel) -> Prediction:
    """Twist of the present step."""
    return Prediction(model.twist, model.jacobian, NO_NOISE)


def twist_ahead(x: Floats, model: TwistModel, density: Floats, interval: float) -> Prediction:
    """Predict the twist of the next step, of an expected length [s], as `pose_ahead`."""
    return Prediction(*_without_fast_slip(x, model), density / interval)


def _without_fast_slip(x: Floats, model: TwistModel) -> tuple[Floats, Floats]:
    """Twist (3,) and its Jacobian (3, SIZE) if the fast slip is zero."""
    jacobian = model.jacobian.copy()
    jacobian[:, s.FAST_SLIP] = 0.0
    return model.twist - model.jacobian[:, s.FAST_SLIP] @ x[s.FAST_SLIP], jacobian
