"""Writing bags: logs and estimates as standard messages, for ROS, Foxglove and PlotJuggler."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from heapq import merge
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from estimator.frames import Floats, yaw_to_quaternion
from estimator.log import (
    FixSeries,
    ImuSeries,
    Log,
    PoseSeries,
    Stamps,
    TrackSpeedSeries,
    TwistSeries,
)
from estimator.robot import Robot
from estimator.trajectory import Trajectory
from replay.decoding import NANOSECONDS
from replay.errors import ReplayError
from replay.outputs import check_replaceable, written_beside
from replay.streams import (
    ABSENT,
    IMU,
    JOINT_STATE,
    ODOMETRY,
    POSE,
    POSE_WITH_COVARIANCE,
    STRING,
    TWIST,
)
from replay.topics import MAPPING_TOPIC, TopicMap, TrackTopic, topic_map, writable_topics

Format = Literal["mcap", "sqlite3", "ros1"]

PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}

MAGICS = (b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V2.0\n")
"""First bytes of the files that may be replaced by a bag."""

LARGEST_STAMP = 2**31 * NANOSECONDS
"""Both ROS 1 and ROS 2 keep the seconds of a stamp in 32 bits."""

UNUSED_VARIANCE = 1e6
"""For what an estimate says nothing about: finite, so that other programs can invert the matrix."""

ODOM, BASE_LINK, IMU_LINK = "odom", "base_link", "imu_link"
TRUTH_TOPIC = "/ground_truth/pose"
PLANAR = (0, 1, 5)
"""x, y and yaw among the rows and columns of a 6x6 covariance."""


class _Outbox(NamedTuple):
    """Messages of one topic: their stamps and what makes the i-th of them."""

    topic: str
    msgtype: str
    stamps: Stamps
    make: Callable[[_Messages, int], Any]


def write_log(
    log: Log,
    path: Path | str,
    format: Format,  # noqa: A002
    robot: Robot,
    *,
    overwrite: bool = False,
) -> Path:
    """Write a log as a bag, on the topics of the robot's mapping.

    Streams that the robot's file does not map, or maps in a way that cannot be written, go to
    `replay.topics.DEFAULT_TOPICS`, and the bag then holds its mapping, by which it is read.

    `read_log` with the same robot gives back what was written: stamps exact, track speeds up to
    the rounding of sprocket_radius, yaw up to that of the quaternion.

    Args:
        log: the log.
        path: where to; a ROS 2 folder, or with the suffix `.mcap` or `.db3` the bare file. A ROS 1
            bag gets the suffix `.bag` where it is missing.
        format: "mcap" or "sqlite3" (ROS 2), or "ros1".
        robot: the robot, for its topic mapping, joint names and sprocket radius.
        overwrite: whether a bag that is there may be replaced.

    Returns:
        The path that was written.

    Raises:
        ReplayError: a bad mapping, stamps that ROS cannot hold, something is there already, or the
            file system refuses.
    """
    own = topic_map(robot, f"robot {robot.name!r}")
    topics = writable_topics(own)
    outboxes = _log_outboxes(log, topics, robot.vehicle.sprocket_radius)
    if topics != own:
        outboxes.append(_mapping(log, topics))
    return _write(Path(path), format, outboxes, overwrite=overwrite)


def check_place(
    path: Path,
    format: Format,  # noqa: A002
    robot: Robot,
    *,
    overwrite: bool = False,
) -> None:
    """Refuse before a long run what `write_log` would refuse after it; arguments as there.

    Raises:
        ReplayError: a bad mapping, or something is there already that may not be replaced.
    """
    topic_map(robot, f"robot {robot.name!r}")
    check_replaceable(_bag_path(path, format), overwrite=overwrite, starts=MAGICS)


def write_odometry(
    path: Path,
    estimates: Mapping[str, Trajectory],
    truth: PoseSeries | None,
    *,
    overwrite: bool = False,
) -> Path:
    """Write estimates as nav_msgs/Odometry (odom -> base_link) into an MCAP bag.

    Args:
        path: where to; a ROS 2 folder, or with the suffix `.mcap` the bare file.
        estimates: the estimate of each variant, which goes to the topic `/<variant>/odom` with `-`
            replaced by `_`.
        truth: the truth, in the frame of the estimates, for `/ground_truth/pose`; or None.
        overwrite: whether a bag that is there may be replaced.

    Returns:
        The path.

    Raises:
        ReplayError: stamps that ROS cannot hold, something is there already, or the file system
            refuses.
    """
    outboxes = [
        _odometry(f"/{variant.replace('-', '_')}/odom", trajectory)
        for variant, trajectory in estimates.items()
    ]
    if truth is not None:
        outboxes.append(_poses(TRUTH_TOPIC, truth))
    return _write(path, "mcap", outboxes, overwrite=overwrite)


def _log_outboxes(log: Log, topics: TopicMap, radius: float) -> list[_Outbox]:
    """What to send; `topics` names all streams (see `writable_topics`)."""
    outboxes = []
    tracks, truth = topics.tracks, topics.truth
    if tracks and len(log.tracks.stamps):
        outboxes.append(_joint_states(tracks.topic, log.tracks, tracks, radius))
    if topics.imu and log.imu is not None:
        outboxes.append(_imu(topics.imu.topic, log.imu))
    if topics.fixes and log.fixes is not None:
        outboxes.append(_fixes(topics.fixes.topic, log.fixes))
    if truth and log.truth is not None:
        outboxes.append(_poses(truth.topic, log.truth.poses))
        if truth.source_topic:
            outboxes.append(_text(truth.source_topic, log.truth.poses.stamps[:1], log.truth.source))
        if truth.twist and log.truth.twists is not None:
            outboxes.append(_twists(truth.twist, log.truth.twists))
        if tracks and truth.tracks and log.truth.tracks is not None:
            outboxes.append(_joint_states(truth.tracks, log.truth.tracks, tracks, radius))
    return outboxes


def _mapping(log: Log, topics: TopicMap) -> _Outbox:
    """The mapping of those streams that the log has."""
    used = TopicMap(
        topics.tracks,
        topics.imu if log.imu is not None else None,
        topics.fixes if log.fixes is not None else None,
        topics.truth if log.truth is not None else None,
    )
    return _text(MAPPING_TOPIC, np.array([log.start]), msgspec.json.encode(used).decode())


def _text(topic: str, stamps: Stamps, text: str) -> _Outbox:
    return _Outbox(topic, STRING, stamps, lambda messages, _: messages.new(STRING, data=text))


def _joint_states(
    topic: str, tracks: TrackSpeedSeries, mapped: TrackTopic, sprocket_radius: float
) -> _Outbox:
    names = [*mapped.left, *mapped.right]
    sides = [0] * len(mapped.left) + [1] * len(mapped.right)
    # rosbags serialises contiguous rows only.
    rates = np.ascontiguousarray((tracks.speeds / sprocket_radius)[:, sides])
    nothing = np.empty(0)

    def make(messages: _Messages, i: int) -> Any:
        return messages.new(
            JOINT_STATE,
            header=messages.header(tracks.stamps[i], ""),
            name=names,
            position=nothing,
            velocity=rates[i],
            effort=nothing,
        )

    return _Outbox(topic, JOINT_STATE, tracks.stamps, make)


def _imu(topic: str, imu: ImuSeries) -> _Outbox:
    absent, unknown = np.zeros(9), np.zeros(9)
    absent[0] = ABSENT
    forces = imu.linear_acceleration
    no_force = (0.0, 0.0, 0.0)

    def make(messages: _Messages, i: int) -> Any:
        return messages.new(
            IMU,
            header=messages.header(imu.stamps[i], IMU_LINK),
            orientation=messages.quaternion((0.0, 0.0, 0.0, 1.0)),
            orientation_covariance=absent,
            angular_velocity=messages.vector(imu.angular_velocity[i]),
            angular_velocity_covariance=unknown,
            linear_acceleration=messages.vector(no_force if forces is None else forces[i]),
            linear_acceleration_covariance=absent if forces is None else unknown,
        )

    return _Outbox(topic, IMU, imu.stamps, make)


def _fixes(topic: str, fixes: FixSeries) -> _Outbox:
    no_heading = np.isnan(fixes.poses[:, 2])
    quaternions = yaw_to_quaternion(np.where(no_heading, 0.0, fixes.poses[:, 2]))
    yaw_variances = np.where(no_heading, UNUSED_VARIANCE, fixes.variances[:, 1])

    def make(messages: _Messages, i: int) -> Any:
        position_variance = fixes.variances[i, 0]
        covariance = np.diag([position_variance, position_variance, yaw_variances[i]])
        return messages.new(
            POSE_WITH_COVARIANCE,
            header=messages.header(fixes.stamps[i], ODOM),
            pose=messages.pose_with_covariance(fixes.poses[i], quaternions[i], covariance),
        )

    return _Outbox(topic, POSE_WITH_COVARIANCE, fixes.stamps, make)


def _poses(topic: str, poses: PoseSeries) -> _Outbox:
    quaternions = yaw_to_quaternion(poses.poses[:, 2])

    def make(messages: _Messages, i: int) -> Any:
        return messages.new(
            POSE,
            header=messages.header(poses.stamps[i], ODOM),
            pose=messages.pose(poses.poses[i], quaternions[i]),
        )

    return _Outbox(topic, POSE, poses.stamps, make)


def _twists(topic: str, twists: TwistSeries) -> _Outbox:
    def make(messages: _Messages, i: int) -> Any:
        return messages.new(
            TWIST,
            header=messages.header(twists.stamps[i], BASE_LINK),
            twist=messages.twist(twists.twists[i]),
        )

    return _Outbox(topic, TWIST, twists.stamps, make)


def _odometry(topic: str, trajectory: Trajectory) -> _Outbox:
    quaternions = yaw_to_quaternion(trajectory.poses[:, 2])

    def make(messages: _Messages, i: int) -> Any:
        twist = messages.new(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=messages.twist(trajectory.twists[i]),
            covariance=_planar_covariance(trajectory.twist_covariances[i]),
        )
        return messages.new(
            ODOMETRY,
            header=messages.header(trajectory.stamps[i], ODOM),
            child_frame_id=BASE_LINK,
            pose=messages.pose_with_covariance(
                trajectory.poses[i], quaternions[i], trajectory.pose_covariances[i]
            ),
            twist=twist,
        )

    return _Outbox(topic, ODOMETRY, trajectory.stamps, make)


def _planar_covariance(covariance: Floats) -> Floats:
    """(36,) row-major 6x6 covariance of a (3, 3) one of x, y, yaw."""
    full = np.diag(np.full(6, UNUSED_VARIANCE))
    full[np.ix_(PLANAR, PLANAR)] = covariance
    return full.ravel()


class _Messages:
    """Makes messages of a ROS version, and serialises them."""

    def __init__(self, store: Typestore, ros1: bool) -> None:
        self.store = store
        self.ros1 = ros1
        self.serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
        self._sequence = {"seq": 0} if ros1 else {}

    def new(self, msgtype: str, **fields: Any) -> Any:
        return self.store.types[msgtype](**fields)

    def header(self, stamp: int, frame_id: str) -> Any:
        seconds, nanoseconds = divmod(int(stamp), NANOSECONDS)
        time = self.new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self.new("std_msgs/msg/Header", **self._sequence, stamp=time, frame_id=frame_id)

    def vector(self, xyz: Any) -> Any:
        x, y, z = xyz
        return self.new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def quaternion(self, xyzw: Any) -> Any:
        x, y, z, w = (float(part) for part in xyzw)
        return self.new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, pose: Floats, quaternion: Floats) -> Any:
        x, y = float(pose[0]), float(pose[1])
        return self.new(
            "geometry_msgs/msg/Pose",
            position=self.new("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
            orientation=self.quaternion(quaternion),
        )

    def pose_with_covariance(self, pose: Floats, quaternion: Floats, covariance: Floats) -> Any:
        return self.new(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=self.pose(pose, quaternion),
            covariance=_planar_covariance(covariance),
        )

    def twist(self, twist: Floats) -> Any:
        v_x, v_y, w = twist
        return self.new(
            "geometry_msgs/msg/Twist",
            linear=self.vector((v_x, v_y, 0.0)),
            angular=self.vector((0.0, 0.0, w)),
        )


def _write(path: Path, kind: Format, outboxes: list[_Outbox], *, overwrite: bool) -> Path:
    for outbox in outboxes:
        _check_stamps(outbox)
    path = _bag_path(path, kind)
    if kind == "ros1":
        opened = _ros1_writer
    else:
        opened = partial(_ros2_writer, plugin=PLUGINS[kind], bare=path.suffix == SUFFIXES[kind])
    try:
        with (
            written_beside(path, overwrite=overwrite, starts=MAGICS) as new,
            opened(new) as (writer, messages),
        ):
            _send(outboxes, writer, messages)
    except (OSError, rosbag1.WriterError, rosbag2.WriterError) as problem:
        raise ReplayError(f"{path}: cannot be written: {problem}") from problem
    return path


def _bag_path(path: Path, kind: Format) -> Path:
    if kind != "ros1" or path.suffix == ".bag":
        return path
    return path.with_name(f"{path.name}.bag")


def _send(outboxes: list[_Outbox], writer: Any, messages: _Messages) -> None:
    """Write the messages of all outboxes in the order of their stamps."""

    def packed(outbox: _Outbox) -> Iterator[tuple[int, Any, Any]]:
        connection = writer.add_connection(outbox.topic, outbox.msgtype, typestore=messages.store)
        return (
            (stamp, connection, messages.serialize(outbox.make(messages, i), outbox.msgtype))
            for i, stamp in enumerate(outbox.stamps.tolist())
        )

    for stamp, connection, data in merge(*map(packed, outboxes), key=lambda item: item[0]):
        writer.write(connection, stamp, data)


@contextmanager
def _ros1_writer(path: Path) -> Iterator[tuple[Any, _Messages]]:
    with rosbag1.Writer(path) as writer:
        yield writer, _Messages(get_typestore(Stores.ROS1_NOETIC), ros1=True)


@contextmanager
def _ros2_writer(path: Path, plugin: StoragePlugin, bare: bool) -> Iterator[tuple[Any, _Messages]]:
    """A ROS 2 bag: a folder, or only the storage file out of it."""
    folder = path.with_suffix("") if bare else path
    writer = rosbag2.Writer(folder, version=9, storage_plugin=plugin)
    if plugin is StoragePlugin.MCAP:
        # Covariances are mostly zeros: this makes odometry five times smaller.
        writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        yield writer, _Messages(get_typestore(Stores.ROS2_HUMBLE), ros1=False)
    if bare:
        (folder / path.name).rename(path)


def _check_stamps(outbox: _Outbox) -> None:
    stamps = outbox.stamps
    if len(stamps) and not (stamps.min() >= 0 and stamps.max() < LARGEST_STAMP):
        bad = stamps[(stamps < 0) | (stamps >= LARGEST_STAMP)][0]
        raise ReplayError(
            f"topic {outbox.topic!r}: the stamp {bad} ns cannot be written; stamps in bags are "
            f"from 0 to {LARGEST_STAMP - 1} ns"
        )
