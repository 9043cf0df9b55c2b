"""Estimates and statuses to ROS 2 messages.

The functions fill messages that the caller makes, so that nothing here imports ROS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import compose, quaternion_to_yaw, relative
from icreckon.estimator.streaming.outputs import IcrPoints
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.message_types import KEY_VALUE, MARKER, POINT, STATUS
from icreckon.replay.bags.messages import ICR_MARKERS, planar_covariance
from icreckon.replay.base.diagnostic_status import DiagnosticStatus
from icreckon.replay.live.base_frame import Pose
from icreckon.replay.live.odometry import LiveEstimate

PLANAR = (0, 1, 5)
"""Rows and columns of x, y and yaw in a covariance of six axes."""


def fill_header(header: Any, stamp: int, frame: str) -> None:
    """Fill a std_msgs/Header with a stamp [ns] and a frame."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp, NANOSECONDS)
    header.frame_id = frame


def fill_odometry(message: Any, estimate: LiveEstimate, frame: str, child: str) -> Any:
    """Fill a nav_msgs/Odometry; non-planar axes have a variance of 1e6."""
    fill_header(message.header, estimate.stamp, frame)
    message.child_frame_id = child
    _fill_pose(message.pose.pose.position, message.pose.pose.orientation, estimate.pose)
    message.pose.covariance = planar_covariance(estimate.pose_covariance)
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    linear.x, linear.y, angular.z = estimate.twist.tolist()
    message.twist.covariance = planar_covariance(estimate.twist_covariance)
    return message


def fill_pose(message: Any, stamp: int, frame: str, pose: Floats, covariance: Floats) -> Any:
    """Fill a geometry_msgs/PoseWithCovarianceStamped."""
    fill_header(message.header, stamp, frame)
    _fill_pose(message.pose.pose.position, message.pose.pose.orientation, pose)
    message.pose.covariance = planar_covariance(covariance)
    return message


def pose_of(message: Any) -> tuple[Pose, list[list[float]]]:
    """Planar pose of a PoseWithCovarianceStamped: x, y [m], yaw [rad].

    Returns:
        The pose, and its covariance (3, 3).

    Raises:
        EstimatorError: its orientation is no rotation.
    """
    at, q = message.pose.pose.position, message.pose.pose.orientation
    size = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if not 1e-6 < size < math.inf:
        raise EstimatorError("its orientation is no rotation: all of it is zero, or not finite")
    yaw = float(quaternion_to_yaw([q.x / size, q.y / size, q.z / size, q.w / size]))
    entries = [float(one) for one in message.pose.covariance]
    return (at.x, at.y, yaw), [[entries[6 * row + column] for column in PLANAR] for row in PLANAR]


def fill_transform(message: Any, stamp: int, frame: str, child: str, pose: Floats) -> Any:
    """Fill a geometry_msgs/TransformStamped with a planar pose of `child` in `frame`."""
    fill_header(message.header, stamp, frame)
    message.child_frame_id = child
    _fill_pose(message.transform.translation, message.transform.rotation, pose)
    return message


def odom_in_map(estimate: LiveEstimate) -> Floats | None:
    """Pose (3,) of odom in map: x, y [m], yaw [rad]; None before the first fix."""
    if estimate.map_pose is None:
        return None
    return compose(estimate.map_pose, relative(estimate.pose, (0.0, 0.0, 0.0)))


def fill_diagnostics(
    array: Any,
    stamp: int,
    statuses: Sequence[DiagnosticStatus],
    hardware: str,
    new: Callable[[str], Any],
) -> Any:
    """Fill a diagnostic_msgs/DiagnosticArray.

    Args:
        array: the message.
        stamp: its time [ns].
        statuses: its statuses.
        hardware: name of the robot.
        new: maker of an empty message by its type.
    """
    fill_header(array.header, stamp, "")
    array.status = []
    for one in statuses:
        status = new(STATUS)
        status.level = bytes([one.level])
        status.name, status.message, status.hardware_id = one.name, one.message, hardware
        status.values = []
        for key, value in one.values.items():
            pair = new(KEY_VALUE)
            pair.key, pair.value = key, value
            status.values.append(pair)
        array.status.append(status)
    return array


def fill_icr_markers(
    array: Any, stamp: int, frame: str, icrs: IcrPoints, new: Callable[[str], Any]
) -> Any:
    """Fill a visualization_msgs/MarkerArray with both ICRs and the line between.

    Args:
        array: the message.
        stamp: its time [ns].
        frame: frame of base_link.
        icrs: ICRs of both tracks in base_link [m].
        new: maker of an empty message by its type.
    """
    array.markers = []
    for number, (kind, size) in enumerate(ICR_MARKERS):
        marker = new(MARKER)
        fill_header(marker.header, stamp, frame)
        marker.ns, marker.id, marker.type = "icrs", number, kind
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = size
        marker.color.r, marker.color.g, marker.color.a = 0.9, 0.4, 1.0
        marker.frame_locked = True
        for x, y in icrs:
            point = new(POINT)
            point.x, point.y = float(x), float(y)
            marker.points.append(point)
        array.markers.append(marker)
    return array


def _fill_pose(position: Any, rotation: Any, pose: Floats) -> None:
    x, y, yaw = pose.tolist()
    position.x, position.y = x, y
    rotation.z, rotation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
