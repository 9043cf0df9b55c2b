"""Row readers: from messages of each type to the rows of numbers of a stream."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import quaternion_to_rpy, quaternion_to_yaw
from icreckon.replay.bags import message_types as ros
from icreckon.replay.mapping.field_paths import field_reader
from icreckon.replay.reading.stream import ABSENT, NAN, Readers, Row, RowReader, UnusableError

BODY_READERS: dict[str, RowReader] = {
    ros.ODOMETRY: lambda message: _speeds(message.twist.twist),
    ros.TWIST: lambda message: _speeds(message.twist),
    ros.TWIST_WITH_COVARIANCE: lambda message: _speeds(message.twist.twist),
}
"""Rows forward speed [m/s] and yaw rate [rad/s] of the robot, by types that need no names."""


def track_readers(joints: Sequence[str], positions: bool = False) -> dict[str, RowReader]:
    """Build the row readers of track speeds: `BODY_READERS`, and that of JointState.

    Rows of JointState are the values of the left `joints`, then of the right ones, in the message's unit:
    speeds, or `positions` (counts). Without joints there is no reader of JointState.
    """
    return BODY_READERS | ({ros.JOINT_STATE: JointReader(joints, positions)} if joints else {})


class JointReader:
    """Reader of JointState: values of the left joints, then of the right ones.

    Joints that a message does not have are NaN in its row; `wheels.interpolated` fills them in.
    """

    def __init__(self, joints: Sequence[str], positions: bool = False) -> None:
        self.seen: set[str] = set()  # names of the joints found so far
        self.positions = positions  # whether positions are used instead of velocities
        self.joints = joints  # names of the joints, those of the left side first
        self._places: dict[tuple[str, ...], dict[str, int]] = {}

    def __call__(self, message: Any) -> Row | None:  # noqa: D102
        names = tuple(message.name)
        places = self._places.get(names)
        if places is None:
            self.seen.update(names)
            mapped = [name for name in self.joints if name in names]
            places = self._places[names] = {name: names.index(name) for name in mapped}
        values = message.position if self.positions else message.velocity
        row = (float(values[places[name]]) if name in places else NAN for name in self.joints)
        return tuple(row) if places else None


def side_readers(names: Sequence[str], before: int, after: int, positions: bool) -> Readers:
    """Build readers of one side's topic (JointState, other types), NaN for the other."""

    def padded(read: RowReader) -> RowReader:
        def row(message: Any) -> Row | None:
            values = read(message)
            return None if values is None else (*[NAN] * before, *values, *[NAN] * after)

        return row

    return {ros.JOINT_STATE: padded(JointReader(names, positions))}, padded(field_reader(names))


def _speeds(twist: Any) -> Row:
    return (twist.linear.x, twist.angular.z)


def imu_row(message: Any) -> Row:
    """Angular velocity and specific force; NaN if the message marks them as absent."""
    rate, force = message.angular_velocity, message.linear_acceleration
    rates = (rate.x, rate.y, rate.z)
    forces = (force.x, force.y, force.z)
    if message.angular_velocity_covariance[0] == ABSENT:
        rates = (NAN, NAN, NAN)
    if message.linear_acceleration_covariance[0] == ABSENT:
        forces = (NAN, NAN, NAN)
    return (*rates, *forces)


def _planar(twist: Any) -> Row:
    return (twist.linear.x, twist.linear.y, twist.angular.z)


TWIST_READERS: dict[str, RowReader] = {ros.TWIST: lambda message: _planar(message.twist)}
"""Rows v_x, v_y, w of the body."""


def _variances(covariance: Any) -> Row:
    """Variances of position (the larger one) [m²] and yaw [rad²]; NaN if zero."""
    # A zero is unset. The covariance (36,) has rows of x, y, z, roll, pitch, yaw.
    return max(covariance[0], covariance[7]) or NAN, covariance[35] or NAN


def _pose_row(pose: Any, variances: Row = (NAN, NAN), twist: Row = (NAN, NAN, NAN)) -> Row:
    at, q = pose.position, pose.orientation
    return (at.x, at.y, q.x, q.y, q.z, q.w, *variances, *twist, at.z)


POSE_READERS: dict[str, RowReader] = {
    ros.POSE: lambda message: _pose_row(message.pose),
    ros.POSE_WITH_COVARIANCE: lambda message: _pose_row(
        message.pose.pose, _variances(message.pose.covariance)
    ),
    ros.ODOMETRY: lambda message: _pose_row(
        message.pose.pose, _variances(message.pose.covariance), _planar(message.twist.twist)
    ),
}
VELOCITY_READERS: dict[str, RowReader] = POSE_READERS | {
    ros.TWIST: lambda message: (*[NAN] * 8, *_planar(message.twist), NAN),
    ros.TWIST_WITH_COVARIANCE: lambda message: (*[NAN] * 8, *_planar(message.twist.twist), NAN),
}
POSE_WIDTH = 12
"""Rows x, y, q_x, q_y, q_z, q_w, variance of position and of yaw, v_x, v_y, w, z; NaN for none."""
# Columns of these rows.
QUATERNION, VARIANCES, TWIST, Z = slice(2, 6), slice(6, 8), slice(8, 11), 11

PLANAR = 1e-6  # truths with a smaller range of z [m], roll and pitch [rad] are planar


def planar_poses(rows: Floats) -> Floats:
    """Convert `POSE_READERS` rows to (n, 3) x, y, yaw; yaw NaN for a zero quaternion."""
    return np.column_stack([rows[:, :2], quaternion_to_yaw(_unit_quaternions(rows))])


def pose_parts(rows: Floats) -> tuple[Floats, Floats, Floats]:
    """Convert `POSE_READERS` rows to poses (n, 3), variances (n, 2) and heights (n,)."""
    return planar_poses(rows), rows[:, VARIANCES].copy(), rows[:, Z]


def spatial_part(rows: Floats) -> Floats | None:
    """Convert `POSE_READERS` rows to (n, 3) z, roll, pitch; None if planar."""
    spatial = np.column_stack([rows[:, Z], quaternion_to_rpy(_unit_quaternions(rows))[:, :2]])
    if not len(spatial) or not np.isfinite(spatial).all() or np.ptp(spatial, axis=0).max() < PLANAR:
        return None
    return spatial


def _unit_quaternions(rows: Floats) -> Floats:
    quaternions = rows[:, QUATERNION]
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    norms[~((norms > 1e-6) & np.isfinite(norms))] = np.nan
    return np.asarray(quaternions / norms)


STATUS_NO_FIX, COVARIANCE_UNKNOWN = -1, 0  # constants of sensor_msgs/NavSatStatus and NavSatFix


def _navsatfix_row(message: Any) -> Row:
    if message.status.status <= STATUS_NO_FIX:
        raise UnusableError("receiver without a fix")
    variance = NAN
    if message.position_covariance_type != COVARIANCE_UNKNOWN:
        covariance = message.position_covariance
        variance = max(covariance[0], covariance[4])
        variance = variance if variance > 0.0 else NAN  # zero is unset
    return (message.latitude, message.longitude, message.altitude, variance)


GEODETIC_READERS: dict[str, RowReader] = {ros.NAVSATFIX: _navsatfix_row}
"""Rows latitude, longitude [deg], altitude [m], variance of position [m²]; NaN for unknown."""


def _heading_row(orientation: Any, yaw_variance: float) -> Row:
    """Row of `HEADING_READERS` from a geometry_msgs/Quaternion."""
    quaternion = np.array([orientation.x, orientation.y, orientation.z, orientation.w])
    norm = float(np.linalg.norm(quaternion))
    if not 1e-6 < norm < float("inf"):
        raise UnusableError("no orientation")
    return (float(quaternion_to_yaw(quaternion / norm)), yaw_variance)


def _imu_heading_row(message: Any) -> Row:
    covariance = message.orientation_covariance
    if covariance[0] == ABSENT:
        raise UnusableError("no orientation")
    return _heading_row(message.orientation, covariance[8] if covariance.any() else NAN)


HEADING_READERS: dict[str, RowReader] = {
    ros.IMU: _imu_heading_row,
    ros.QUATERNION: lambda message: _heading_row(message.quaternion, NAN),
}
"""Rows yaw [rad], its variance [rad²]; NaN for unknown."""
