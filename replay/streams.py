"""From messages to rows of numbers: what each stream takes of each message type."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimator.frames import quaternion_to_yaw
from estimator.log import Floats, Stamps
from replay.decoding import NANOSECONDS, decoder
from replay.errors import ReplayError
from replay.records import Channel, Record
from replay.topics import Clock

Row = tuple[float, ...]
RowReader = Callable[[Any], Row | None]

JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/TwistStamped"
STRING = "std_msgs/msg/String"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"

NAN = float("nan")
ABSENT = -1.0
"""Element 0 of a sensor_msgs/Imu covariance whose quantity the sensor does not measure."""


@dataclass
class Stream:
    """The rows gathered of one topic for one purpose.

    Attributes:
        purpose: "tracks", "imu", "fixes", "truth", ...; the name in the counts of dropped samples.
        topic: the topic.
        source: name of the bag, for messages.
        time: which clock stamps the rows.
        readers: for each message type that will do, what to take of a message: a row of numbers,
            or None for a message that is none of this stream's business.
        msgtype: the type that was found, "" before the first message.
        undecodable: how many messages were no such message.
    """

    purpose: str
    topic: str
    source: str
    time: Clock
    readers: Mapping[str, RowReader]
    msgtype: str = ""
    undecodable: int = 0
    _decode: dict[Channel, Callable[[bytes], Any]] = field(default_factory=dict)
    _recorded: list[int] = field(default_factory=list)
    _stamped: list[int] = field(default_factory=list)
    _rows: list[Row] = field(default_factory=list)

    def take(self, record: Record) -> None:
        """Add a message.

        Raises:
            ReplayError: a message type that this stream cannot be read from, or no definition.
        """
        channel = record.channel
        decode = self._decode.get(channel)
        if decode is None:
            if channel.msgtype not in self.readers:
                raise ReplayError(
                    f"{self.source}: topic {self.topic!r} is of type {channel.msgtype!r}, of which "
                    f"{self.purpose} cannot be read; readable are {', '.join(self.readers)}"
                )
            if self.msgtype not in ("", channel.msgtype):
                raise ReplayError(
                    f"{self.source}: topic {self.topic!r} carries two types of message, "
                    f"{self.msgtype!r} and {channel.msgtype!r}"
                )
            decode = self._decode[channel] = decoder(channel, self.source)
            self.msgtype = channel.msgtype
        try:
            message = decode(record.data)
            row = self.readers[channel.msgtype](message)
            stamp = message.header.stamp
        except Exception:
            # Whatever rosbags or a reader stumbles over, the bytes are no message of this type.
            self.undecodable += 1
            return
        if row is not None:
            self._recorded.append(record.time)
            self._stamped.append(stamp.sec * NANOSECONDS + stamp.nanosec)
            self._rows.append(row)

    def arrays(self) -> tuple[Stamps, Floats]:
        """(n,) stamps [ns] and (n, k) rows, in the order of recording.

        Raises:
            ReplayError: stamps of the headers were asked for, and all are zero.
        """
        recorded = np.array(self._recorded, dtype=np.int64)
        order = np.argsort(recorded, kind="stable")
        stamps = recorded
        if self.time == "header":
            stamps = np.array(self._stamped, dtype=np.int64)
            if len(stamps) > 1 and not stamps.any():
                raise ReplayError(
                    f"{self.source}: topic {self.topic!r}: the header stamps are all zero; "
                    'set time = "recording" for it in the robot file'
                )
        width = len(self._rows[0]) if self._rows else 0
        rows = np.array(self._rows, dtype=float).reshape(len(stamps), width)
        return stamps[order], rows[order]


def track_readers(left: Sequence[str], right: Sequence[str]) -> dict[str, RowReader]:
    """Rows for track speeds.

    Args:
        left: joints of the left side.
        right: joints of the right side.

    Returns:
        Of JointState the mean rates (left, right) [rad/s]; of Odometry and TwistStamped the forward
        speed [m/s] and the yaw rate [rad/s].
    """
    readers: dict[str, RowReader] = {ODOMETRY: _odometry_speeds, TWIST: _twist_speeds}
    if left and right:
        readers[JOINT_STATE] = JointReader(left, right)
    return readers


class JointReader:
    """Called with a JointState: mean rates (left, right) [rad/s]; None if it has no such joint.

    Attributes:
        seen: names of the joints that were met.
    """

    def __init__(self, left: Sequence[str], right: Sequence[str]) -> None:
        self.seen: set[str] = set()
        self._sides = (left, right)
        self._places: dict[tuple[str, ...], list[list[int]]] = {}

    def __call__(self, message: Any) -> Row | None:  # noqa: D102
        names = tuple(message.name)
        places = self._places.get(names)
        if places is None:
            places = self._places[names] = self._find(names)
        if not places:
            return None
        rates = message.velocity
        left, right = (sum(float(rates[i]) for i in side) / len(side) for side in places)
        return (left, right)

    def _find(self, names: tuple[str, ...]) -> list[list[int]]:
        self.seen.update(names)
        if not any(name in names for side in self._sides for name in side):
            return []
        return [[names.index(name) for name in side] for side in self._sides]


def _odometry_speeds(message: Any) -> Row:
    twist = message.twist.twist
    return (twist.linear.x, twist.angular.z)


def _twist_speeds(message: Any) -> Row:
    return (message.twist.linear.x, message.twist.angular.z)


def imu_row(message: Any) -> Row:
    """Angular velocity and specific force, NaN where the message says that it has none."""
    rate, force = message.angular_velocity, message.linear_acceleration
    rates = (rate.x, rate.y, rate.z)
    forces = (force.x, force.y, force.z)
    if message.angular_velocity_covariance[0] == ABSENT:
        rates = (NAN, NAN, NAN)
    if message.linear_acceleration_covariance[0] == ABSENT:
        forces = (NAN, NAN, NAN)
    return (*rates, *forces)


def twist_row(message: Any) -> Row:
    """Body velocity v_x, v_y, w of a TwistStamped."""
    twist = message.twist
    return (twist.linear.x, twist.linear.y, twist.angular.z)


def _pose(pose: Any) -> Row:
    at, q = pose.position, pose.orientation
    return (at.x, at.y, q.x, q.y, q.z, q.w)


def _variances(covariance: Any) -> Row:
    """Of position (the larger one) and yaw; NaN where the covariance is left at zeros: unknown."""
    variances = (max(covariance[0], covariance[7]), covariance[35])
    return variances if any(variances) else (NAN, NAN)


def _pose_stamped_row(message: Any) -> Row:
    return (*_pose(message.pose), NAN, NAN, NAN, NAN, NAN)


def _pose_with_covariance_row(message: Any) -> Row:
    return (*_pose(message.pose.pose), *_variances(message.pose.covariance), NAN, NAN, NAN)


def _odometry_row(message: Any) -> Row:
    twist = message.twist.twist
    return (
        *_pose(message.pose.pose),
        *_variances(message.pose.covariance),
        twist.linear.x,
        twist.linear.y,
        twist.angular.z,
    )


POSE_READERS: dict[str, RowReader] = {
    POSE: _pose_stamped_row,
    POSE_WITH_COVARIANCE: _pose_with_covariance_row,
    ODOMETRY: _odometry_row,
}
"""Rows x, y, q_x, q_y, q_z, q_w, variance of position and of yaw, v_x, v_y, w; NaN for none."""


def planar_poses(rows: Floats) -> Floats:
    """(n, 3) x, y, yaw of rows of `POSE_READERS`; yaw NaN where the quaternion is zero."""
    quaternions = rows[:, 2:6]
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    norms[~((norms > 1e-6) & np.isfinite(norms))] = np.nan
    return np.column_stack([rows[:, :2], quaternion_to_yaw(quaternions / norms)])
