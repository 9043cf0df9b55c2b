"""Estimates and statuses to ROS 2 messages.

The functions fill messages that the caller makes, so that nothing here imports ROS.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import quaternion_to_yaw
from icreckon.estimator.motion.pose3d import Pose3d
from icreckon.estimator.streaming.outputs import IcrPoints
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.message_types import KEY_VALUE, MARKER, POINT, STATUS
from icreckon.replay.bags.messages import ICR_MARKERS, PLANAR, planar_covariance, six_rows
from icreckon.replay.live.base_frame import Pose
from icreckon.replay.live.diagnostic_status import DiagnosticStatus
from icreckon.replay.live.odometry import LiveEstimate


def fill_header(header: Any, stamp: int, frame: str) -> None:
    """Fill a std_msgs/Header with a stamp [ns] and a frame."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp, NANOSECONDS)
    header.frame_id = frame


def fill_odometry(
    message: Any, estimate: LiveEstimate, frame: str, child: str, *, planar: bool = True
) -> Any:
    """Fill a nav_msgs/Odometry of the robot's frame `child` in the odom frame `frame`.

    Axes that are not estimated are zero with a variance of 1e6. A planar message omits height, roll and
    pitch, like robot_localization with `two_d_mode`.
    """
    fill_header(message.header, estimate.stamp, frame)
    message.child_frame_id = child
    pose = estimate.in_odom(planar=planar)
    _fill_pose(message.pose.pose.position, message.pose.pose.orientation, pose)
    message.pose.covariance = six_rows(pose.covariance)
    twist = message.twist.twist
    if planar:
        twist.linear.x, twist.linear.y, twist.angular.z = estimate.twist.tolist()
        message.twist.covariance = planar_covariance(estimate.twist_covariance)
        return message
    spatial = estimate.twist3d
    for part, values in ((twist.linear, spatial.linear), (twist.angular, spatial.angular)):
        part.x, part.y, part.z = (0.0 if math.isnan(value) else value for value in values.tolist())
    message.twist.covariance = six_rows(spatial.covariance)
    return message


def fill_pose(message: Any, stamp: int, frame: str, pose: Pose3d) -> Any:
    """Fill a geometry_msgs/PoseWithCovarianceStamped."""
    fill_header(message.header, stamp, frame)
    _fill_pose(message.pose.pose.position, message.pose.pose.orientation, pose)
    message.pose.covariance = six_rows(pose.covariance)
    return message


def pose_of(message: Any) -> tuple[Pose, list[list[float]]]:
    """Planar pose (x, y [m], yaw [rad]) and covariance (3, 3) of a message.

    Raises:
        EstimatorError: the orientation is no rotation.
    """
    at, q = message.pose.pose.position, message.pose.pose.orientation
    size = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if not 1e-6 < size < math.inf:
        raise EstimatorError("its orientation is no rotation: all of it is zero, or not finite")
    yaw = float(quaternion_to_yaw([q.x / size, q.y / size, q.z / size, q.w / size]))
    entries = [float(entry) for entry in message.pose.covariance]
    return (at.x, at.y, yaw), [[entries[6 * row + column] for column in PLANAR] for row in PLANAR]


def fill_transform(message: Any, stamp: int, frame: str, child: str, pose: Pose3d) -> Any:
    """Fill a geometry_msgs/TransformStamped with a pose of `child` in `frame`."""
    fill_header(message.header, stamp, frame)
    message.child_frame_id = child
    _fill_pose(message.transform.translation, message.transform.rotation, pose)
    return message


def fill_diagnostics(
    array: Any,
    stamp: int,
    statuses: Sequence[DiagnosticStatus],
    hardware: str,
    new: Callable[[str], Any],
) -> Any:
    """Fill a diagnostic_msgs/DiagnosticArray; `new` makes a message of a type."""
    fill_header(array.header, stamp, "")
    array.status = []
    for entry in statuses:
        status = new(STATUS)
        status.level = bytes([entry.level])  # rclpy has a `byte` as bytes
        status.name, status.message, status.hardware_id = entry.name, entry.message, hardware
        status.values = []
        for key, value in entry.values.items():
            pair = new(KEY_VALUE)
            pair.key, pair.value = key, value
            status.values.append(pair)
        array.status.append(status)
    return array


def fill_icr_markers(
    array: Any, stamp: int, frame: str, icrs: IcrPoints, new: Callable[[str], Any]
) -> Any:
    """Fill a visualization_msgs/MarkerArray with both ICRs and the line between."""
    array.markers = []
    for number, (kind, size) in enumerate(ICR_MARKERS):
        marker = new(MARKER)
        fill_header(marker.header, stamp, frame)
        marker.ns, marker.id, marker.type = "icrs", number, kind
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = size
        marker.color.r, marker.color.g, marker.color.a = 0.9, 0.4, 1.0
        marker.frame_locked = True  # moves with the frame between two messages
        for x, y in icrs:
            point = new(POINT)
            point.x, point.y = float(x), float(y)
            marker.points.append(point)
        array.markers.append(marker)
    return array


def _fill_pose(position: Any, rotation: Any, pose: Pose3d) -> None:
    position.x, position.y, position.z = pose.position.tolist()
    rotation.x, rotation.y, rotation.z, rotation.w = pose.quaternion.tolist()
