"""Base frame: a point of the robot other than the centre of its tracks."""

from __future__ import annotations

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import compose, relative, rotate

CENTRE = (0.0, 0.0, 0.0)
Pose = tuple[float, float, float]


class BaseFrame:
    """Frame that is fixed to the robot, in place of that of the estimator.

    The estimator's frame is at the centre of the tracks' contact area, as everything in a robot file.
    `odom` is where the base frame was at the start.

    Args:
        offset: place of the base frame: forward, left of the centre [m], and its yaw [rad].
    """

    def __init__(self, offset: Pose = CENTRE) -> None:
        self._offset = np.array(offset, dtype=float)
        self._moves = any(offset)

    def pose_in_odom(self, pose: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Pose (3,) of the base frame in odom [m, rad] and its covariance (3, 3).

        Args:
            pose: (3,) of the centre, in the axes of its own start.
            covariance: (3, 3) its covariance.
        """
        if not self._moves:
            return pose, covariance
        placed, covariance = self.pose_in_map(pose, covariance)
        turn = self._turn()
        return relative(self._offset, placed), turn @ covariance @ turn.T

    def pose_in_map(self, pose: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Pose (3,) of the base frame in map [m, rad] and its covariance (3, 3).

        Args:
            pose: (3,) of the centre.
            covariance: (3, 3) its covariance.
        """
        if not self._moves:
            return pose, covariance
        x, y = rotate(self._offset[:2], pose[2]).tolist()
        jacobian = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        return compose(pose, self._offset), jacobian @ covariance @ jacobian.T

    def twist(self, twist: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Twist (3,) of the base frame in its own axes, and its covariance (3, 3).

        Args:
            twist: (3,) of the centre [m/s, m/s, rad/s].
            covariance: (3, 3) its covariance.
        """
        if not self._moves:
            return twist, covariance
        x, y, _ = self._offset.tolist()
        jacobian = self._turn() @ np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        return jacobian @ twist, jacobian @ covariance @ jacobian.T

    def centre(self, pose: Pose) -> Pose:
        """Pose of the centre if the base frame has this one: x, y [m], yaw [rad]."""
        if not self._moves:
            return pose
        x, y, yaw = compose(pose, relative(self._offset, CENTRE)).tolist()
        return (x, y, yaw)

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Point in the estimator's frame, in the base frame [m]."""
        if not self._moves:
            return (x, y)
        forward, left, _ = relative(self._offset, (x, y, 0.0)).tolist()
        return (forward, left)

    def _turn(self) -> Floats:
        """Rotation (3, 3) of x and y into the axes of the base frame."""
        rotation = np.eye(3)
        rotation[:2, :2] = rotate(np.eye(2), -self._offset[2]).T
        return rotation
