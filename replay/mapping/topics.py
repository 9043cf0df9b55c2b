"""The topic mapping: which topic of a bag is which stream.

It is the `[log]` table of a robot file. Where that cannot say all that a bag is written with, the bag
itself holds its mapping, as JSON on `MAPPING_TOPIC`.
"""

from __future__ import annotations

import math
from typing import Literal, TypeVar

import msgspec

from icreckon.estimator.base.config import convert
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.mapping.columns import ColumnMap
from icreckon.replay.mapping.geodesy import check_origin
from icreckon.replay.mapping.track_units import TrackUnit, check_latency, check_unit

Clock = Literal["auto", "header", "recording"]
"""What stamps a stream: header stamps, the time of recording, or what `replay.reading.clocks` chooses."""


def _require_positive(name: str, value: float | None) -> None:
    if value is not None and not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be a positive number, found {value!r}")


def _check_frames(frames: tuple[str, str] | None) -> None:
    if frames is not None and (not all(frames) or frames[0] == frames[1]):
        raise ValueError(
            f'frames must name two frames, as ["map", "base_link"], found {list(frames)!r}'
        )


class TrackTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of the track speeds.

    Attributes:
        topic: name; sensor_msgs/JointState, nav_msgs/Odometry, geometry_msgs/TwistStamped, or any
            other type whose fields `left` and `right` name.
        left: joints of the left side (JointState), which are averaged, or the fields of it in a
            message of another type, as "wheels.left.rate" or "data[0]".
        right: those of the right side.
        gauge: track gauge by which the robot's controller made speed and yaw rate of track speeds
            [m] (Odometry, TwistStamped); the vehicle's where left out.
        unit: of the values of `left` and `right`; what adds up ("counts", "rad", ...) is taken from
            the position of the joints.
        counts_per_turn: of the sprocket, for unit "counts".
        wrap: where the counter starts again, in `unit`; None if it does not.
        time: which clock stamps it.
        latency: how late these stamps are, which is taken off them [s].
    """

    topic: str
    left: tuple[str, ...] = ()
    right: tuple[str, ...] = ()
    gauge: float | None = None
    unit: TrackUnit = "rad/s"
    counts_per_turn: float | None = None
    wrap: float | None = None
    time: Clock = "auto"
    latency: float = 0.0

    def __post_init__(self) -> None:
        if bool(self.left) != bool(self.right):
            raise ValueError("left and right must both name joints, or both be left out")
        _require_positive("gauge", self.gauge)
        on_a_side = max(len(self.left), len(self.right))
        check_unit(self.unit, self.counts_per_turn, self.wrap, on_a_side)
        check_latency(self.latency)


class ImuTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of the IMU (sensor_msgs/Imu).

    Attributes:
        topic: name.
        time: which clock stamps it.
        latency: how late these stamps are, which is taken off them [s].
    """

    topic: str
    time: Clock = "auto"
    latency: float = 0.0

    def __post_init__(self) -> None:
        check_latency(self.latency)


class FixTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of position or pose fixes in `odom`.

    Attributes:
        topic: name; geometry_msgs/PoseWithCovarianceStamped or PoseStamped, nav_msgs/Odometry,
            sensor_msgs/NavSatFix (then `odom` is east and north from `origin`), or tf
            (tf2_msgs/TFMessage, geometry_msgs/TransformStamped) with `frames`.
        position_sigma: standard deviation of each coordinate where a message has no covariance [m].
        heading_sigma: the same of yaw [rad]; where left out, such a message has no heading.
        least_sigma: what messages that claim to be better are taken for [m]: errors of GPS wander, and
            a filter takes each fix for an independent one.
        frames: of tf, the frame that the fixes are in and that of the robot, ["map", "base_link"].
        origin: latitude, longitude [deg], altitude [m] of the origin of NavSatFix; the first fix
            where left out.
        time: which clock stamps it.
        latency: how late these stamps are, which is taken off them [s].
    """

    topic: str
    position_sigma: float | None = None
    heading_sigma: float | None = None
    least_sigma: float | None = None
    frames: tuple[str, str] | None = None
    origin: tuple[float, float, float] | None = None
    time: Clock = "auto"
    latency: float = 0.0

    def __post_init__(self) -> None:
        _require_positive("position_sigma", self.position_sigma)
        _require_positive("heading_sigma", self.heading_sigma)
        _require_positive("least_sigma", self.least_sigma)
        _check_frames(self.frames)
        check_origin(self.origin)
        check_latency(self.latency)


class HeadingTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of a heading without a position: two antennas, a compass.

    Attributes:
        topic: name; sensor_msgs/Imu, of which only the orientation is read, or
            geometry_msgs/QuaternionStamped.
        sigma: standard deviation where a message has no covariance [rad].
        offset_deg: what to add to get the direction of driving from what is measured [deg].
        time: which clock stamps it.
        latency: how late these stamps are, which is taken off them [s].
    """

    topic: str
    sigma: float | None = None
    offset_deg: float = 0.0
    time: Clock = "auto"
    latency: float = 0.0

    def __post_init__(self) -> None:
        _require_positive("sigma", self.sigma)
        if not math.isfinite(self.offset_deg):
            raise ValueError(f"offset_deg must be a number, found {self.offset_deg!r}")
        check_latency(self.latency)


class TruthTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topics of the truth.

    Attributes:
        topic: the pose; geometry_msgs/PoseStamped or PoseWithCovarianceStamped,
            nav_msgs/Odometry (which gives the twist too), or tf with `frames`.
        twist: the body velocity (geometry_msgs/TwistStamped), or None.
        tracks: the true track speeds (JointState, joints as in `[log.tracks]`), or None.
        source: what the truth is ("lidar map", say), for reports; the topic where left out.
        source_topic: a topic that says it instead (std_msgs/String), or None.
        frames: of tf, the frame that the truth is in and that of the robot.
        time: which clock stamps it.
        latency: how late these stamps are, which is taken off them [s].
    """

    topic: str
    twist: str | None = None
    tracks: str | None = None
    source: str = ""
    source_topic: str | None = None
    frames: tuple[str, str] | None = None
    time: Clock = "auto"
    latency: float = 0.0

    def __post_init__(self) -> None:
        _check_frames(self.frames)
        check_latency(self.latency)


class TopicMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a robot's logs keep each stream; None where they have none of it.

    Attributes:
        tracks: topic of the track speeds.
        imu: topic of the IMU.
        fixes: topic of the fixes.
        truth: topics of the truth.
        heading: topic of a heading without a position.
        columns: the same for logs that are tables (CSV, Parquet).
    """

    tracks: TrackTopic | None = None
    imu: ImuTopic | None = None
    fixes: FixTopic | None = None
    truth: TruthTopic | None = None
    heading: HeadingTopic | None = None
    columns: ColumnMap | None = None

    def __post_init__(self) -> None:
        if self.truth and self.truth.tracks and not (self.tracks and self.tracks.left):
            raise ValueError("truth.tracks needs the joints left and right of tracks")


_Topic = TypeVar("_Topic", TrackTopic, ImuTopic | None, FixTopic | None, TruthTopic)

# Where bags that are written keep what the robot's file does not say.
DEFAULT_TRACKS = TrackTopic("/joint_states", ("left_track_joint",), ("right_track_joint",))
DEFAULT_TRUTH = TruthTopic(
    "/ground_truth/pose",
    twist="/ground_truth/twist",
    tracks="/ground_truth/joint_states",
    source_topic="/ground_truth/source",
)
DEFAULT_TOPICS = TopicMap(
    DEFAULT_TRACKS, ImuTopic("/imu/data_raw"), FixTopic("/fix/pose"), truth=DEFAULT_TRUTH
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
    tracks, fixes = own.tracks, own.fixes
    if tracks is None or not tracks.left or tracks.unit != "rad/s":
        tracks = DEFAULT_TRACKS
    if fixes is None or fixes.frames is not None:
        fixes = DEFAULT_TOPICS.fixes
    by_topic = own.truth is not None and own.truth.frames is None
    said = msgspec.structs.asdict(own.truth) if own.truth is not None and by_topic else {}
    truth = msgspec.structs.replace(
        DEFAULT_TRUTH, **{key: value for key, value in said.items() if value is not None}
    )
    # What is written is stamped in time.
    full = TopicMap(
        _in_time(tracks), _in_time(own.imu or DEFAULT_TOPICS.imu), _in_time(fixes), _in_time(truth)
    )
    names = [stream.topic for stream in (full.tracks, full.imu, full.fixes, truth) if stream]
    names += [name for name in (truth.twist, truth.tracks, truth.source_topic) if name]
    return full if len(set(names)) == len(names) else DEFAULT_TOPICS


def _in_time(stream: _Topic) -> _Topic:
    return stream and msgspec.structs.replace(stream, latency=0.0)


def topic_map(robot: Robot, source: str) -> TopicMap:
    """The `[log]` table of a robot file, checked.

    Args:
        robot: the robot.
        source: name of its file, for messages.

    Raises:
        ReplayError: a misspelt key, a wrong type or a bad value.
    """
    return convert(robot.log, TopicMap, f"{source}: [log]", ReplayError)
