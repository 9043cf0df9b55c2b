"""Log writer: a log as a bag of standard messages."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.frames import yaw_to_quaternion
from icreckon.estimator.log import series
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.bags import message_types as ros
from icreckon.replay.bags.messages import (
    BASE_LINK,
    IMU_LINK,
    ODOM,
    UNUSED_VARIANCE,
    planar_covariance,
    planar_twist,
)
from icreckon.replay.bags.writer import MARK, Outbox, bag_path, write_bag
from icreckon.replay.bags.writer import Format as Format
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.base.outputs import check_replaceable
from icreckon.replay.mapping.columns import TrackKeys
from icreckon.replay.mapping.topics import MAPPING_TOPIC, TopicMap, topic_map, writable_topics
from icreckon.replay.reading.stream import ABSENT


def write_log(
    log: Log,
    path: Path | str,
    format: Format,  # noqa: A002
    robot: Robot,
    *,
    overwrite: bool = False,
) -> Path:
    """Write a log as a bag, on the topics of the robot's mapping.

    Streams without a mapping, or with one that cannot be written, go to
    `icreckon.replay.mapping.topics.DEFAULT_TOPICS`. The bag then holds its own mapping for reading it.
    The result is the path of the bag.

    `read_log` with the same robot restores the log: stamps exactly, track speeds up to the rounding of
    sprocket_radius, yaw up to that of the quaternion.

    Args:
        log: the log.
        path: target; a ROS 2 folder, or with the suffix `.mcap` or `.db3` the bare file. A ROS 1
            bag gets the suffix `.bag` if it is missing.
        format: "mcap" or "sqlite3" (ROS 2), or "ros1".
        robot: the robot, for its topic mapping, joint names and sprocket radius.
        overwrite: whether an existing bag may be replaced.

    Raises:
        ReplayError: a bad mapping, stamps that ROS cannot hold, the path exists, or the file system
            refuses.
    """
    robot_topics = topic_map(robot)
    topics = _with_antenna(writable_topics(robot_topics), log)
    outboxes, radius = [], robot.vehicle.sprocket_radius
    tracks, truth = topics.tracks, topics.truth
    if tracks and len(log.tracks.stamps):
        outboxes.append(_joint_states(tracks.topic, log.tracks, tracks, radius))
    if topics.imu and log.imu is not None:
        outboxes.append(_imu_messages(topics.imu.topic, log.imu))
    if topics.fixes and log.fixes is not None:
        outboxes.append(fix_messages(topics.fixes.topic, log.fixes))
    if truth and log.truth is not None:
        outboxes.append(pose_messages(truth.topic, log.truth.poses))
        if truth.source_topic:
            first = log.truth.poses.stamps[:1]
            outboxes.append(_text_message(truth.source_topic, first, log.truth.source))
        if truth.twist and log.truth.twists is not None:
            outboxes.append(_twist_messages(truth.twist, log.truth.twists))
        if tracks and truth.tracks and log.truth.tracks is not None:
            outboxes.append(_joint_states(truth.tracks, log.truth.tracks, tracks, radius))
    if topics != robot_topics:
        # `read_log` reads the bag by the mapping of the streams that the log has.
        names = [name for name in ("imu", "fixes", "truth") if getattr(log, name) is not None]
        used = TopicMap(topics.tracks, **{name: getattr(topics, name) for name in names})
        text = msgspec.json.encode(used).decode()
        outboxes.append(_text_message(MAPPING_TOPIC, np.array([log.start]), text))
    return write_bag(Path(path), format, outboxes, overwrite=overwrite)


def check_place(path: Path, format: Format, robot: Robot, *, overwrite: bool = False) -> None:  # noqa: A002
    """Refuse a mapping or place that `write_log` would refuse, before a long run."""
    topic_map(robot)
    check_replaceable(bag_path(path, format), overwrite=overwrite, mark=MARK.encode())


def _with_antenna(topics: TopicMap, log: Log) -> TopicMap:
    """Mapping with the position of the one antenna that all fixes of the log are of."""
    if log.fixes is None or topics.fixes is None or not len(log.fixes.stamps):
        return topics
    antennas = np.unique(log.fixes.lever_arms, axis=0).tolist()
    if len(antennas) > 1:
        problem = f"fixes of antennas at {antennas} m; a bag holds fixes of one, drop the others"
        raise ReplayError(f"{log.name}: {problem}")
    fixes = msgspec.structs.replace(topics.fixes, position=tuple(antennas[0]))
    return msgspec.structs.replace(topics, fixes=fixes)


def _text_message(topic: str, stamps: Stamps, text: str) -> Outbox:
    """Text as a latched std_msgs/String at each of some stamps (here one) [ns]."""
    return Outbox(topic, ros.STRING, stamps, lambda _: {"data": text}, latched=True)


def _joint_states(
    topic: str, tracks: series.TrackSpeedSeries, mapped: TrackKeys, sprocket_radius: float
) -> Outbox:
    """Track speeds over the radius [m] as sensor_msgs/JointState, joint by joint."""
    names = list(mapped.names)
    columns = [0] * len(mapped.left) + [1] * len(mapped.right)

    def fields(stamp: int, rates: Floats) -> dict[str, Any]:
        return {"header": (stamp, ""), "name": names, "velocity": rates}

    # rosbags serialises contiguous rows only.
    rates = np.ascontiguousarray((tracks.speeds / sprocket_radius)[:, columns])
    return Outbox(topic, ros.JOINT_STATE, tracks.stamps, fields, (rates,))


def _imu_messages(topic: str, imu: series.ImuSeries) -> Outbox:
    """IMU samples as sensor_msgs/Imu; covariances mark missing measurements."""
    absent, unknown = np.zeros(9), np.zeros(9)
    absent[0] = ABSENT
    forces = imu.linear_acceleration

    def fields(stamp: int, rates: Floats, force: Any = (0.0, 0.0, 0.0)) -> dict[str, Any]:
        return {
            "header": (stamp, IMU_LINK),
            "orientation": (0.0, 0.0, 0.0, 1.0),
            "orientation_covariance": absent,
            "angular_velocity": rates,
            "angular_velocity_covariance": unknown,
            "linear_acceleration": force,
            "linear_acceleration_covariance": absent if forces is None else unknown,
        }

    columns = (imu.angular_velocity,) if forces is None else (imu.angular_velocity, forces)
    return Outbox(topic, ros.IMU, imu.stamps, fields, columns)


def fix_messages(topic: str, fixes: series.FixSeries) -> Outbox:
    """Fixes as geometry_msgs/PoseWithCovarianceStamped in odom."""
    no_heading = np.isnan(fixes.poses[:, 2])
    quaternions = yaw_to_quaternion(np.where(no_heading, 0.0, fixes.poses[:, 2]))
    yaw_variances = np.where(no_heading, UNUSED_VARIANCE, fixes.variances[:, 1])

    def fields(stamp: int, xy: Floats, quaternion: Floats, *variances: float) -> dict[str, Any]:
        position_variance, yaw_variance = variances
        covariance = np.diag([position_variance, position_variance, yaw_variance])
        pose = (*xy, 0.0), quaternion
        return {"header": (stamp, ODOM), "pose": (pose, planar_covariance(covariance))}

    columns = fixes.poses[:, :2], quaternions, fixes.variances[:, 0], yaw_variances
    return Outbox(topic, ros.POSE_WITH_COVARIANCE, fixes.stamps, fields, columns)


def pose_messages(topic: str, poses: series.PoseSeries) -> Outbox:
    """Poses as geometry_msgs/PoseStamped in odom."""

    def fields(stamp: int, *pose: Floats) -> dict[str, Any]:
        return {"header": (stamp, ODOM), "pose": pose}

    return Outbox(topic, ros.POSE, poses.stamps, fields, (poses.positions, poses.quaternions))


def _twist_messages(topic: str, twists: series.TwistSeries) -> Outbox:
    """Body velocities as geometry_msgs/TwistStamped in base_link."""

    def fields(stamp: int, twist: Floats) -> dict[str, Any]:
        return {"header": (stamp, BASE_LINK), "twist": planar_twist(twist)}

    return Outbox(topic, ros.TWIST, twists.stamps, fields, (twists.twists,))
