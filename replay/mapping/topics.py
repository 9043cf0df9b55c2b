"""Topic mapping: topics of a bag for each stream.

The mapping is the `[log]` table of a robot file. If that table cannot describe a written bag, the bag
holds its own mapping, as JSON on `MAPPING_TOPIC`.
"""

import re
from typing import Annotated, Any, Literal

import msgspec

from icreckon.estimator.base.checks import Bound, Bounded, Latency, OnRobot, Positive, check_bounds
from icreckon.estimator.base.config import convert
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.mapping.columns import ColumnMap, ImuKeys, PoseKeys, TrackKeys
from icreckon.replay.mapping.geodesy import check_origin
from icreckon.replay.mapping.track_units import ANY_COUNTS, OF_GROUND

Clock = Literal["auto", "header", "recording"]
"""Clock of a stream: header stamps, time of recording, or the choice of
`icreckon.replay.reading.clocks`."""


def _check_frames(frames: tuple[str, str] | None) -> None:
    """Raise a ValueError unless a transform's frames are two names, or None."""
    if frames is not None and (not all(frames) or frames[0] == frames[1]):
        raise ValueError(
            f'frames must name two frames, as ["map", "base_link"], found {list(frames)!r}'
        )


class TrackTopic(TrackKeys, frozen=True):
    """The topic of the track speeds.

    Attributes:
        topic: name; sensor_msgs/JointState, nav_msgs/Odometry, geometry_msgs/TwistStamped or
            TwistWithCovarianceStamped, or any other type, if `left` and `right`, or `speed` and
            `yaw_rate`, name its fields, as "wheels.left.rate" or "data[0]".
        right_topic: topic of the right side, if each side has one; then `topic` is that of the left.
        time: clock of the stamps.
    """

    topic: str
    right_topic: str | None = None
    time: Clock = "auto"

    def __post_init__(self) -> None:
        if self.right_topic is not None and (not self.left or self.right_topic == self.topic):
            raise ValueError(
                "right_topic is for a topic of each side: it must differ from topic, and left and "
                "right must name fields or joints of these topics"
            )
        super().__post_init__()


class ImuTopic(ImuKeys, frozen=True):
    """The topic of the IMU.

    Attributes:
        topic: name; sensor_msgs/Imu, or any other type if `angular_velocity` names its fields.
        acceleration_topic: topic of the accelerations, if they come apart, as from some cameras: an Imu,
            or fields `linear_acceleration`; they are interpolated at the stamps of `topic`.
        time: clock of the stamps.
    """

    topic: str
    acceleration_topic: str | None = None
    time: Clock = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.names:
            self.check_axes("fields")
        are_apart = self.acceleration_topic is not None
        if self.acceleration_topic == self.topic:
            raise ValueError("acceleration_topic must differ from topic")
        if are_apart and bool(self.angular_velocity) != bool(self.linear_acceleration):
            raise ValueError(
                "acceleration_topic needs both angular_velocity and linear_acceleration, or none of them"
            )


class FixTopic(PoseKeys, frozen=True):
    """The topic of position or pose fixes in `odom`.

    Attributes:
        topic: name; geometry_msgs/PoseWithCovarianceStamped or PoseStamped, nav_msgs/Odometry,
            sensor_msgs/NavSatFix (then `odom` is east and north from `origin`), or tf
            (tf2_msgs/TFMessage, geometry_msgs/TransformStamped) with `frames`; or any other type, if
            `x` and `y`, or `latitude` and `longitude`, name its fields, as "position.x".
        frames: for tf, the frame of the fixes and that of the robot, ["map", "base_link"].
        time: clock of the stamps.
    """

    topic: str
    frames: tuple[str, str] | None = None
    time: Clock = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_frames(self.frames)
        if self.names:
            self.check_place("fields")


class HeadingTopic(Bounded, frozen=True):
    """The topic of a heading without a position: two antennas, a compass.

    Attributes:
        topic: name; sensor_msgs/Imu, of which only the orientation is read, or
            geometry_msgs/QuaternionStamped.
        sigma: standard deviation if a message has no covariance [rad].
        offset_deg: offset added to the measurement to get the direction of driving [deg].
        time: clock of the stamps.
        latency: latency of the stamps, subtracted from them [s].
    """

    topic: str
    sigma: Positive | None = None
    offset_deg: Annotated[float, Bound("a number")] = 0.0
    time: Clock = "auto"
    latency: Latency = 0.0


class VelocityTopic(Bounded, frozen=True):
    """The topic of another odometry, by camera, lidar or radar: a velocity.

    Attributes:
        topic: name; geometry_msgs/TwistStamped or TwistWithCovarianceStamped, or nav_msgs/Odometry,
            geometry_msgs/PoseStamped or PoseWithCovarianceStamped, of which the motion between successive
            poses is used.
        sigma: standard deviation of the velocity forward and to the left [m/s].
        position: place of the sensor in base_link, forward, left [m].
        yaw_deg: direction of its x axis in base_link [deg].
        time: clock of the stamps.
        latency: latency of the stamps, subtracted from them [s].
    """

    topic: str
    sigma: Positive
    position: tuple[OnRobot, OnRobot] = (0.0, 0.0)
    yaw_deg: Annotated[float, Bound("a number")] = 0.0
    time: Clock = "auto"
    latency: Latency = 0.0


class TruthTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topics of the truth.

    Attributes:
        topic: the pose; geometry_msgs/PoseStamped or PoseWithCovarianceStamped,
            nav_msgs/Odometry (which gives the twist too), or tf with `frames`; or sensor_msgs/NavSatFix,
            which has no headings.
        twist: the body velocity (geometry_msgs/TwistStamped), or None.
        tracks: the true track speeds (JointState, joints as in `[log.tracks]`), or None.
        source: name of the reference system ("lidar map"), for reports; the topic if left out.
        source_topic: a topic with that name (std_msgs/String), or None.
        frames: for tf, the frame of the truth and that of the robot.
        origin: latitude, longitude [deg], altitude [m] of the origin of NavSatFix; that of the fixes if
            left out, if they have one, otherwise the first position.
        time: clock of the stamps.
        latency: latency of the stamps, subtracted from them [s].
    """

    topic: str
    twist: str | None = None
    tracks: str | None = None
    source: str = ""
    source_topic: str | None = None
    frames: tuple[str, str] | None = None
    origin: tuple[float, float, float] | None = None
    time: Clock = "auto"
    latency: Latency = 0.0

    def __post_init__(self) -> None:
        _check_frames(self.frames)
        check_origin(self.origin)
        check_bounds(self)


class TopicMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Topics of each stream; None if a robot's logs lack the stream."""

    tracks: TrackTopic | None = None  # topic of the track speeds
    imu: ImuTopic | None = None  # topic of the IMU
    fixes: FixTopic | None = None  # topic of the fixes
    truth: TruthTopic | None = None  # topics of the truth
    heading: HeadingTopic | None = None  # topic of a heading without a position
    velocity: VelocityTopic | None = None  # topic of another odometry
    columns: ColumnMap | None = None  # columns of each stream, for tables (CSV, Parquet)

    def __post_init__(self) -> None:
        if self.truth and self.truth.tracks and not (self.tracks and self.tracks.left):
            raise ValueError("truth.tracks needs the joints left and right of tracks")

    def keys_of(self, purpose: Literal["tracks", "imu", "fixes", "heading", "velocity"]) -> Any:
        """Topic or columns of a stream, such as "fixes"; None if neither is mapped."""
        return getattr(self, purpose) or getattr(self.columns, purpose, None)

    @property
    def track_keys(self) -> TrackKeys | None:
        """Topic or columns of the track speeds."""
        keys: TrackKeys | None = self.keys_of("tracks")
        return keys

    @property
    def from_twist(self) -> bool:
        """True for track speeds that are computed from speed and yaw rate of the robot."""
        return (keys := self.track_keys) is not None and not keys.left

    @property
    def in_rates(self) -> bool:
        """True for track speeds that are multiplied by the sprocket radius."""
        keys = self.track_keys
        return keys is not None and bool(keys.left) and keys.unit not in OF_GROUND

    @property
    def lacks_counts_per_turn(self) -> bool:
        """True for counters whose counts of a turn are not filled in."""
        return self.track_keys is not None and self.track_keys.counts_per_turn == ANY_COUNTS


# Topics of written bags for streams that the robot file does not map.
DEFAULT_TRACKS = TrackTopic(
    "/joint_states", left=("left_track_joint",), right=("right_track_joint",)
)
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
LOG_KEY = re.compile(r"\[log\.(tracks|imu|fixes|truth|heading)\]")


def writable_topics(own: TopicMap) -> TopicMap:
    """Complete a mapping so that every stream can be written.

    Returns:
        That mapping, with `DEFAULT_TOPICS` for streams it does not map and for track speeds without
        joint names, which are written as JointState; `DEFAULT_TOPICS` alone if two streams would
        share a topic.
    """
    tracks, fixes, truth = own.tracks, own.fixes, DEFAULT_TRUTH
    # Track speeds are written as rates of joints on one topic, poses not as transforms.
    if tracks is None or not tracks.left or tracks.right_topic or tracks.unit != "rad/s":
        tracks = DEFAULT_TRACKS
    if fixes is None or fixes.frames is not None:
        fixes = DEFAULT_TOPICS.fixes
    if own.truth is not None and own.truth.frames is None:
        keys = msgspec.structs.asdict(own.truth) | {"latency": None}
        stated = {key: value for key, value in keys.items() if value is not None}
        truth = msgspec.structs.replace(DEFAULT_TRUTH, **stated)
    # Written stamps have no latency, and written speeds are as they are. A minus before a name is gone.
    left, right = tracks.names[: len(tracks.left)], tracks.names[len(tracks.left) :]
    complete = TopicMap(
        msgspec.structs.replace(tracks, latency=0.0, scale=1.0, left=left, right=right),
        ImuTopic(own.imu.topic, time=own.imu.time) if own.imu else DEFAULT_TOPICS.imu,
        fixes and msgspec.structs.replace(fixes, latency=0.0),
        truth,
    )
    streams = (complete.tracks, complete.imu, complete.fixes, truth)
    names = [stream.topic for stream in streams if stream]
    names += [name for name in (truth.twist, truth.tracks, truth.source_topic) if name]
    return complete if len(set(names)) == len(names) else DEFAULT_TOPICS


def with_column_keys(text: str, robot: Robot) -> str:
    """Message with keys of tables in place of those of bags, if the robot has them."""
    if not isinstance(robot.log.get("columns"), dict):
        return text
    text = LOG_KEY.sub(r"[log.columns.\1]", text)
    return text.replace(" its topic in [log.col", " its columns in [log.col")


def topic_map(robot: Robot) -> TopicMap:
    """Convert and check the `[log]` table of a robot.

    Raises:
        ReplayError: a misspelt key, a wrong type or a bad value.
    """
    return convert(robot.log, TopicMap, f"robot {robot.name!r}: [log]", ReplayError)
