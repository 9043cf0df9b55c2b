"""Topic mapping: topics of a bag for each stream.

It is the `[log]` table of a robot file. If that table cannot describe a written bag, the bag holds its
own mapping, as JSON on `MAPPING_TOPIC`.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal, TypeVar

import msgspec

from icreckon.estimator.base.checks import (
    Bound,
    Bounded,
    Latency,
    OnRobot,
    Positive,
    WanderSigma,
    WanderTime,
    check_bounds,
    require_wander,
)
from icreckon.estimator.base.config import convert
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.mapping.columns import (
    AccelerationUnit,
    ColumnMap,
    RateUnit,
    check_axes,
    check_place,
)
from icreckon.replay.mapping.geodesy import check_origin
from icreckon.replay.mapping.track_units import Held, TrackUnit, check_sides, check_unit

Clock = Literal["auto", "header", "recording"]
"""Clock of a stream: header stamps, time of recording, or the choice of
`icreckon.replay.reading.clocks`."""


def _check_frames(frames: tuple[str, str] | None) -> None:
    if frames is not None and (not all(frames) or frames[0] == frames[1]):
        raise ValueError(
            f'frames must name two frames, as ["map", "base_link"], found {list(frames)!r}'
        )


class TrackTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of the track speeds.

    Attributes:
        topic: name; sensor_msgs/JointState, nav_msgs/Odometry, geometry_msgs/TwistStamped, or any
            other type, if `left` and `right` name its fields.
        left: joints of the left side (JointState) or fields of a message of another type, as
            "wheels.left.rate" or "data[0]"; their mean is used.
        right: joints or fields of the right side.
        gauge: track gauge with which the robot's controller computes speed and yaw rate from track
            speeds [m] (Odometry, TwistStamped); the vehicle's if left out.
        unit: unit of the values of `left` and `right`; cumulative units ("counts", "rad", ...) use the
            position of the joints.
        counts_per_turn: encoder counts per turn of the sprocket, for unit "counts".
        wrap: range of the counter, in `unit`; None if it does not wrap.
        held: treatment of values that the log repeats until the next: "auto" interpolates them if they
            are repeated regularly, "interpolate" always, "keep" never.
        time: clock of the stamps.
        latency: latency of the stamps, subtracted from them [s].
    """

    topic: str
    left: tuple[str, ...] = ()
    right: tuple[str, ...] = ()
    gauge: Positive | None = None
    unit: TrackUnit = "rad/s"
    counts_per_turn: Positive | None = None
    wrap: Positive | None = None
    held: Held = "keep"
    time: Clock = "auto"
    latency: Latency = 0.0

    def __post_init__(self) -> None:
        if bool(self.left) != bool(self.right):
            raise ValueError("left and right must both name joints, or both be left out")
        check_bounds(self)
        check_sides(self.left, self.right)
        on_a_side = max(len(self.left), len(self.right))
        check_unit(self.unit, self.counts_per_turn, self.wrap, on_a_side)


class ImuTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of the IMU.

    Attributes:
        topic: name; sensor_msgs/Imu, or any other type if `angular_velocity` names its fields.
        angular_velocity: fields of x, y and z, or of z alone, as "gyro.z" or "data[0]"; empty for Imu.
        linear_acceleration: fields of x, y and z (specific force); empty for none, and for Imu.
        rate_unit: unit of the angular velocity.
        acceleration_unit: unit of the acceleration.
        time: clock of the stamps.
        latency: latency of the stamps, subtracted from them [s].
    """

    topic: str
    angular_velocity: tuple[str, ...] = ()
    linear_acceleration: tuple[str, ...] = ()
    rate_unit: RateUnit = "rad/s"
    acceleration_unit: AccelerationUnit = "m/s2"
    time: Clock = "auto"
    latency: Latency = 0.0

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.angular_velocity or self.linear_acceleration:
            check_axes(self.angular_velocity, self.linear_acceleration, "fields")


class FixTopic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The topic of position or pose fixes in `odom`.

    Attributes:
        topic: name; geometry_msgs/PoseWithCovarianceStamped or PoseStamped, nav_msgs/Odometry,
            sensor_msgs/NavSatFix (then `odom` is east and north from `origin`), or tf
            (tf2_msgs/TFMessage, geometry_msgs/TransformStamped) with `frames`; or any other type, if
            `x` and `y`, or `latitude` and `longitude`, name its fields.
        x: field of x [m], as "position.x"; the next ones likewise.
        y: field of y [m].
        yaw: field of the heading, counter-clockwise from x [rad], or None.
        latitude: field [deg].
        longitude: field [deg].
        altitude: field [m], or None.
        sigma: field of the standard deviation of each coordinate [m], or None.
        position_sigma: standard deviation of each coordinate if a message has no covariance [m]; with
            `wander_sigma` that of all fixes, since messages state their whole error.
        heading_sigma: standard deviation of yaw if a message has no covariance [rad]; if left out, such
            a message has no heading.
        least_sigma: lower bound of the messages' standard deviations [m]: errors of GPS are
            correlated over time, but a filter assumes independent fixes.
        height_sigma: standard deviation of the height of fixes [m]; without it their height is not used.
        wander_sigma: standard deviation of the part of the error that wanders [m], see `FixWander`.
        wander_time: its correlation time [s].
        frames: for tf, the frame of the fixes and that of the robot, ["map", "base_link"].
        origin: latitude, longitude [deg], altitude [m] of the origin of NavSatFix; the first fix
            if left out.
        position: the antenna or other measured point in base_link, forward and left [m].
        time: clock of the stamps.
        latency: latency of the stamps, subtracted from them [s].
    """

    topic: str
    x: str | None = None
    y: str | None = None
    yaw: str | None = None
    latitude: str | None = None
    longitude: str | None = None
    altitude: str | None = None
    sigma: str | None = None
    position_sigma: Positive | None = None
    heading_sigma: Positive | None = None
    least_sigma: Positive | None = None
    height_sigma: Positive | None = None
    wander_sigma: WanderSigma = 0.0
    wander_time: WanderTime = 0.0
    frames: tuple[str, str] | None = None
    origin: tuple[float, float, float] | None = None
    position: tuple[OnRobot, OnRobot] = (0.0, 0.0)
    time: Clock = "auto"
    latency: Latency = 0.0

    def __post_init__(self) -> None:
        check_bounds(self)
        require_wander("wander_sigma", self.wander_sigma, "wander_time", self.wander_time)
        _check_frames(self.frames)
        check_origin(self.origin)
        plane, globe = (self.x, self.y), (self.latitude, self.longitude)
        if any((*plane, *globe, self.yaw, self.altitude, self.sigma)):
            check_place(plane, globe, "fields")


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
    """Topics of each stream; None if a robot's logs lack the stream.

    Attributes:
        tracks: topic of the track speeds.
        imu: topic of the IMU.
        fixes: topic of the fixes.
        truth: topics of the truth.
        heading: topic of a heading without a position.
        columns: columns of each stream, for logs that are tables (CSV, Parquet).
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

# Topics of written bags for streams that the robot file does not map.
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
LOG_KEY = re.compile(r"\[log\.(tracks|imu|fixes|truth|heading)\]")


def writable_topics(own: TopicMap) -> TopicMap:
    """Complete a mapping so that every stream can be written.

    Returns:
        That mapping, with `DEFAULT_TOPICS` for streams it does not map and for track speeds without
        joint names, which are written as JointState; `DEFAULT_TOPICS` alone if two streams would
        share a topic.
    """
    tracks, fixes = own.tracks, own.fixes
    if tracks is None or not tracks.left or tracks.unit != "rad/s":
        tracks = DEFAULT_TRACKS
    if fixes is None or fixes.frames is not None:
        fixes = DEFAULT_TOPICS.fixes
    by_topic = own.truth is not None and own.truth.frames is None
    given = msgspec.structs.asdict(own.truth) if own.truth is not None and by_topic else {}
    truth = msgspec.structs.replace(
        DEFAULT_TRUTH, **{key: value for key, value in given.items() if value is not None}
    )
    # Written stamps have no latency, and written speeds are as they are.
    full = TopicMap(
        _in_time(msgspec.structs.replace(tracks, held="keep")),
        ImuTopic(own.imu.topic, time=own.imu.time) if own.imu else DEFAULT_TOPICS.imu,
        _in_time(fixes),
        _in_time(truth),
    )
    names = [stream.topic for stream in (full.tracks, full.imu, full.fixes, truth) if stream]
    names += [name for name in (truth.twist, truth.tracks, truth.source_topic) if name]
    return full if len(set(names)) == len(names) else DEFAULT_TOPICS


def _in_time(stream: _Topic) -> _Topic:
    return stream and msgspec.structs.replace(stream, latency=0.0)


def with_column_keys(text: str, robot: Robot) -> str:
    """Message with the keys of tables for those of bags, if the robot file has them."""
    streams = robot.log.get("columns")
    if not isinstance(streams, dict):
        return text
    text = LOG_KEY.sub(r"[log.columns.\1]", text)
    return text.replace(" its topic in [log.col", " its columns in [log.col")


def topic_map(robot: Robot, source: str) -> TopicMap:
    """Convert and check the `[log]` table of a robot file.

    Args:
        robot: the robot.
        source: name of its file, for error messages.

    Raises:
        ReplayError: a misspelt key, a wrong type or a bad value.
    """
    return convert(robot.log, TopicMap, f"{source}: [log]", ReplayError)
