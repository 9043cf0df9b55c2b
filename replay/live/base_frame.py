"""Base frame: a point of the robot other than the centre of its tracks."""

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import compose, matrix_to_rpy, relative, rotate, rpy_to_matrix
from icreckon.estimator.motion.pose3d import Pose3d, Twist3d
from icreckon.estimator.robot.robot_file import Imu
from icreckon.replay.bags.messages import PLANAR_BLOCK

CENTRE = (0.0, 0.0, 0.0)
Pose = tuple[float, float, float]


class BaseFrame:
    """Frame that is fixed to the robot, in place of that of the estimator.

    The estimator's frame is at the centre of the tracks' contact area, as everything in a robot file.
    `odom` is where the base frame was at the start. Methods convert what is estimated of the centre: a
    pose (3,) x, y [m], yaw [rad] or a twist (3,) v_x, v_y [m/s], w [rad/s], and its covariance (3, 3).
    The offset of the base frame from the centre is forward, left [m], and its yaw [rad].
    """

    def __init__(self, offset: Pose = CENTRE) -> None:
        self._offset = np.array(offset, dtype=float)
        self._moves = any(offset)
        # Rotation (3, 3) of x and y into the axes of the base frame.
        self._turn = rpy_to_matrix(0.0, 0.0, -self._offset[2])

    def pose_in_odom(self, pose: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Pose of the base frame in odom; the centre's is in the axes of its start."""
        placed, covariance = self.pose_in_map(pose, covariance)
        return relative(self._offset, placed), self._turn @ covariance @ self._turn.T

    def pose_in_map(self, pose: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Pose of the base frame in map, and its covariance."""
        x, y = rotate(self._offset[:2], pose[2]).tolist()
        jacobian = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        return compose(pose, self._offset), jacobian @ covariance @ jacobian.T

    def twist(self, twist: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Twist of the base frame in its own axes, and its covariance."""
        x, y, _ = self._offset.tolist()
        jacobian = self._turn @ np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        return jacobian @ twist, jacobian @ covariance @ jacobian.T

    def pose3d(self, pose: Pose3d, planar: Floats, covariance: Floats) -> Pose3d:
        """Pose of the base frame in three dimensions, from that of the centre.

        `planar` (3,) is the pose of the base frame seen from above, with its covariance (3, 3).
        """
        if not self._moves:
            return pose
        x, y, yaw = self._offset.tolist()
        roll, pitch, _ = pose.rpy.tolist()
        tilt = rpy_to_matrix(roll, pitch, 0.0)
        roll, pitch, _ = matrix_to_rpy(tilt @ rpy_to_matrix(0.0, 0.0, yaw))
        position = np.array([*planar[:2], pose.position[2] + tilt[2] @ (x, y, 0.0)])
        full = self._with_turned_tilt(pose.covariance, covariance)
        return Pose3d(position, np.array([roll, pitch, planar[2]]), full)

    def twist3d(self, twist: Twist3d, planar: Floats, covariance: Floats) -> Twist3d:
        """Twist of the base frame with rates of roll and pitch; arguments as of `pose3d`."""
        linear = np.array([*planar[:2], 0.0])
        angular = np.array([*(self._turn[:2, :2] @ twist.angular[:2]), planar[2]])
        return Twist3d(linear, angular, self._with_turned_tilt(twist.covariance, covariance))

    def _with_turned_tilt(self, full: Floats, planar: Floats) -> Floats:
        """Covariance (6, 6) with the planar part (3, 3) of the base frame."""
        turn, turned = self._turn[:2, :2], full.copy()
        turned[3:5] = turn @ turned[3:5]
        turned[:, 3:5] = turned[:, 3:5] @ turn.T
        turned[PLANAR_BLOCK] = planar
        return turned

    def centre(self, pose: Pose) -> Pose:
        """Pose of the centre if the base frame has this one: x, y [m], yaw [rad]."""
        x, y, yaw = compose(pose, relative(self._offset, CENTRE)).tolist()
        return (x, y, yaw)

    def mounted(self, imu: Imu, place: Floats, rotation: Floats) -> Imu:
        """IMU at a place (3,) [m] and with a rotation (3, 3) in the base frame."""
        x, y, _ = compose(self._offset, (*place[:2], 0.0)).tolist()
        roll, pitch, yaw = np.degrees(matrix_to_rpy(self._turn.T @ rotation)).tolist()
        position = x, y, float(place[2])
        return msgspec.structs.replace(imu, rotation_rpy_deg=(roll, pitch, yaw), position=position)

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Convert a point from the estimator's frame to the base frame [m]."""
        forward, left, _ = relative(self._offset, (x, y, 0.0)).tolist()
        return (forward, left)
