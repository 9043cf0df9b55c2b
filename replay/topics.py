"""The topic mapping: which topic of a bag is which stream.

It is the `[log]` table of a robot file. Where that cannot say all that a bag is written with, the bag
itself holds its mapping, as JSON on `MAPPING_TOPIC`.
"""

from __future__ import annotations

import math
from typing import Literal

import msgspec

from estimator.config import convert
from estimator.robot import Robot
from replay.errors import ReplayError

Clock = Literal["header", "recording"]


def _require_positive(name: str, value: float | None) -> None:
    if value is not None and not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be a positive number, found {value!r}")


class TrackTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of the track speeds.

    Attributes:
        topic: name; sensor_msgs/JointState, nav_msgs/Odometry or geometry_msgs/TwistStamped.
        left: joints of the left side (JointState), whose rates are averaged.
        right: joints of the right side (JointState).
        gauge: track gauge by which the robot's controller made speed and yaw rate of track speeds
            [m] (Odometry, TwistStamped); the vehicle's where left out.
        time: stamps from the message's header, or the time of recording.
    """

    topic: str
    left: tuple[str, ...] = ()
    right: tuple[str, ...] = ()
    gauge: float | None = None
    time: Clock = "header"

    def __post_init__(self) -> None:
        if bool(self.left) != bool(self.right):
            raise ValueError("left and right must both name joints, or both be left out")
        _require_positive("gauge", self.gauge)


class ImuTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of the IMU (sensor_msgs/Imu).

    Attributes:
        topic: name.
        time: stamps from the message's header, or the time of recording.
    """

    topic: str
    time: Clock = "header"


class FixTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of position or pose fixes in `odom`.

    Attributes:
        topic: name; geometry_msgs/PoseWithCovarianceStamped or PoseStamped, or nav_msgs/Odometry.
        position_sigma: standard deviation of each coordinate where a message has no covariance [m].
        heading_sigma: the same of yaw [rad]; where left out, such a message has no heading.
        time: stamps from the message's header, or the time of recording.
    """

    topic: str
    position_sigma: float | None = None
    heading_sigma: float | None = None
    time: Clock = "header"

    def __post_init__(self) -> None:
        _require_positive("position_sigma", self.position_sigma)
        _require_positive("heading_sigma", self.heading_sigma)


class TruthTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topics of the truth.

    Attributes:
        topic: the pose; geometry_msgs/PoseStamped or PoseWithCovarianceStamped, or
            nav_msgs/Odometry (which gives the twist too).
        twist: the body velocity (geometry_msgs/TwistStamped), or None.
        tracks: the true track speeds (JointState, joints as in `[log.tracks]`), or None.
        source: what the truth is ("lidar map", say), for reports; the topic where left out.
        source_topic: a topic that says it instead (std_msgs/String), or None.
        time: stamps from the messages' headers, or the time of recording.
    """

    topic: str
    twist: str | None = None
    tracks: str | None = None
    source: str = ""
    source_topic: str | None = None
    time: Clock = "header"


class TopicMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a robot's logs keep each stream; None where they have none of it."""

    tracks: TrackTopic | None = None
    imu: ImuTopic | None = None
    fixes: FixTopic | None = None
    truth: TruthTopic | None = None

    def __post_init__(self) -> None:
        if self.truth and self.truth.tracks and not (self.tracks and self.tracks.left):
            raise ValueError("truth.tracks needs the joints left and right of tracks")


# Where bags that are written keep what the robot's file does not say.
DEFAULT_TRACKS = TrackTopic("/joint_states", ("left_track_joint",), ("right_track_joint",))
DEFAULT_TRUTH = TruthTopic(
    "/ground_truth/pose",
    twist="/ground_truth/twist",
    tracks="/ground_truth/joint_states",
    source_topic="/ground_truth/source",
)
DEFAULT_TOPICS = TopicMap(
    DEFAULT_TRACKS, ImuTopic("/imu/data_raw"), FixTopic("/fix/pose"), DEFAULT_TRUTH
)
MAPPING_TOPIC = "/icreckon/topics"


def writable_topics(own: TopicMap) -> TopicMap:
    """A mapping on which every stream can be written.

    Args:
        own: the robot file's mapping.

    Returns:
        The same, with `DEFAULT_TOPICS` for what it does not name and for track speeds without joint
        names, which are written as JointState; `DEFAULT_TOPICS` altogether where two streams would
        come to share a topic.
    """
    tracks = own.tracks if own.tracks is not None and own.tracks.left else DEFAULT_TRACKS
    said = {} if own.truth is None else msgspec.structs.asdict(own.truth)
    truth = msgspec.structs.replace(
        DEFAULT_TRUTH, **{key: value for key, value in said.items() if value is not None}
    )
    full = TopicMap(tracks, own.imu or DEFAULT_TOPICS.imu, own.fixes or DEFAULT_TOPICS.fixes, truth)
    names = [stream.topic for stream in (full.tracks, full.imu, full.fixes, truth) if stream]
    names += [name for name in (truth.twist, truth.tracks, truth.source_topic) if name]
    return full if len(set(names)) == len(names) else DEFAULT_TOPICS


def topic_map(robot: Robot, source: str) -> TopicMap:
    """The `[log]` table of a robot file, checked.

    Args:
        robot: the robot.
        source: name of its file, for messages.

    Raises:
        ReplayError: a misspelt key, a wrong type or a bad value.
    """
    return convert(robot.log, TopicMap, f"{source}: [log]", ReplayError)
