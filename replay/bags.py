"""Reading logs: bags of ROS 1 and ROS 2 into the in-memory log, screened, by a topic mapping."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from estimator.log import (
    FixSeries,
    Floats,
    ImuSeries,
    Log,
    PoseSeries,
    Stamps,
    TrackSpeedSeries,
    Truth,
    TwistSeries,
    screen,
)
from estimator.robot import Robot
from replay.bag_files import Bag, over_bag
from replay.decoding import decoder
from replay.errors import ReplayError
from replay.streams import (
    IMU,
    JOINT_STATE,
    POSE_READERS,
    STRING,
    TWIST,
    JointReader,
    RowReader,
    Stream,
    imu_row,
    planar_poses,
    track_readers,
    twist_row,
)
from replay.topics import (
    MAPPING_TOPIC,
    FixTopic,
    TopicMap,
    TrackTopic,
    TruthTopic,
    topic_map,
)

NO_HEADING_VARIANCE = 1e3
"""Yaw variance [rad²] from which on a fix is taken to have no heading."""


def read_log(path: Path | str, robot: Robot, *, topics: TopicMap | None = None) -> Log:
    """Read a bag as a log.

    ROS 1 `.bag` files, ROS 2 folders, and bare `.mcap` and `.db3` files. A bag that was cut short
    is read up to the break, and `notes` says so. Every stream is screened, and `dropped` says what
    was lost.

    Args:
        path: the bag. If it holds its own mapping (see `write_log`), that is used and noted.
        robot: the robot, for its topic mapping and its sprocket radius and gauge.
        topics: a mapping to use instead of the robot file's and the bag's.

    Returns:
        The log, named after the file. Where the mapping has no track speeds, they are empty.

    Raises:
        ReplayError: no bag, no topic or no usable message for the track speeds, or a message type
            that a stream cannot be read from. Other streams that are not there are left out and
            noted.
    """
    path = Path(path)
    mapping = topics if topics is not None else topic_map(robot, f"robot {robot.name!r}")

    def work(bag: Bag) -> Log:
        reading = _Reading(path, robot, mapping, bag)
        if topics is None:
            reading.use_own_mapping()
        return reading.log()

    return over_bag(path, work)


@dataclass
class _Reading:
    path: Path
    robot: Robot
    topics: TopicMap
    bag: Bag
    dropped: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def use_own_mapping(self) -> None:
        """Take the mapping that the bag holds, if it holds one, in place of the robot file's."""
        if all(channel.topic != MAPPING_TOPIC for channel in self.bag.counts):
            return
        text = self._first_text(MAPPING_TOPIC)
        if text is None:
            return
        try:
            self.topics = msgspec.json.decode(text, type=TopicMap)
        except msgspec.DecodeError as problem:
            self.notes.append(f"topic {MAPPING_TOPIC!r} cannot be read: {problem}")
        else:
            self.notes.append(
                f"topics as the bag itself names them ({MAPPING_TOPIC}), not as the robot file does"
            )

    def log(self) -> Log:
        streams = self._gather()
        tracks = self._tracks(streams.get("tracks"), self.topics.tracks)
        if tracks is None:
            self.notes.append("no track speeds: the robot file maps no topic for them")
            tracks = TrackSpeedSeries(np.empty(0, np.int64), np.empty((0, 2)))
        imu = self._imu(streams.get("imu"))
        fixes = self._fixes(streams.get("fixes"), self.topics.fixes)
        truth = self._truth(streams)
        return Log(
            name=self.path.stem if self.path.is_file() else self.path.name,
            tracks=tracks,
            imu=imu,
            fixes=fixes,
            truth=truth,
            dropped=self.dropped,
            notes=(*self.bag.notes, *self.notes),
        )

    def _wanted(self) -> list[Stream]:
        topics, source = self.topics, str(self.path)
        wanted = []
        joints: dict[str, RowReader] = {}
        if tracks := topics.tracks:
            readers = track_readers(tracks.left, tracks.right)
            joints = {name: reader for name, reader in readers.items() if name == JOINT_STATE}
            wanted.append(Stream("tracks", tracks.topic, source, tracks.time, readers))
        if imu := topics.imu:
            wanted.append(Stream("imu", imu.topic, source, imu.time, {IMU: imu_row}))
        if fixes := topics.fixes:
            wanted.append(Stream("fixes", fixes.topic, source, fixes.time, POSE_READERS))
        if truth := topics.truth:
            wanted.append(Stream("truth", truth.topic, source, truth.time, POSE_READERS))
            if truth.twist:
                twists: dict[str, RowReader] = {TWIST: twist_row}
                wanted.append(Stream("truth twist", truth.twist, source, truth.time, twists))
            if truth.tracks:
                wanted.append(Stream("truth tracks", truth.tracks, source, truth.time, joints))
        return wanted

    def _gather(self) -> dict[str, Stream]:
        """The streams that are in the bag, filled, by their purpose."""
        counts: dict[str, int] = {}
        for channel, count in self.bag.counts.items():
            counts[channel.topic] = counts.get(channel.topic, 0) + count
        streams: dict[str, Stream] = {}
        by_topic: dict[str, list[Stream]] = {}
        for stream in self._wanted():
            if counts.get(stream.topic):
                streams[stream.purpose] = stream
                by_topic.setdefault(stream.topic, []).append(stream)
                continue
            found = "has no messages" if stream.topic in counts else "is not in the bag"
            missing = f"topic {stream.topic!r} for {stream.purpose} {found}"
            if stream.purpose == "tracks":
                raise ReplayError(
                    f"{self.path}: {missing}; there is {self._topics_found()}. Name the right one "
                    "in the robot file's [log.tracks], or leave that table out"
                )
            self.notes.append(f"{missing}; there is {self._topics_found()}")
        for record in self.bag.messages(by_topic):
            for stream in by_topic[record.channel.topic]:
                stream.take(record)
        for stream in streams.values():
            if stream.undecodable:
                self.dropped[f"{stream.purpose}: cannot be decoded"] = stream.undecodable
        return streams

    def _topics_found(self) -> str:
        found = sorted((channel.topic, channel.msgtype) for channel in self.bag.counts)
        return ", ".join(f"{topic} ({msgtype})" for topic, msgtype in found) or "none at all"

    def _screened(
        self, stream: Stream, stamps: Stamps, values: Floats, positive: Floats | None = None
    ) -> NDArray[np.bool_]:
        keep, reasons = np.empty(0, dtype=bool), dict[str, int]()
        if len(stamps):
            keep, reasons = screen(stream.purpose, stamps, values, positive=positive)
        self.dropped.update(reasons)
        if not keep.any():
            losses = "".join(f", {count} x {reason}" for reason, count in reasons.items())
            if stream.undecodable:
                losses += f", {stream.undecodable} x cannot be decoded"
            self.notes.append(
                f"no usable message for {stream.purpose} on topic {stream.topic!r}{losses}"
            )
        return keep

    def _tracks(self, stream: Stream | None, mapped: TrackTopic | None) -> TrackSpeedSeries | None:
        if stream is None or mapped is None:
            return None
        stamps, rows = stream.arrays()
        vehicle = self.robot.vehicle
        rows = rows.reshape(-1, 2)
        if stream.msgtype == JOINT_STATE:
            speeds = rows * vehicle.sprocket_radius
        else:
            gauge = mapped.gauge if mapped.gauge is not None else vehicle.track_gauge
            half = 0.5 * gauge * rows[:, 1]
            speeds = np.column_stack([rows[:, 0] - half, rows[:, 0] + half])
        keep = self._screened(stream, stamps, speeds)
        if keep.any():
            return TrackSpeedSeries(stamps[keep], speeds[keep])
        if stream.purpose == "tracks":
            raise ReplayError(f"{self.path}: {self.notes[-1]}{_joints_hint(stream, mapped)}")
        return None

    def _imu(self, stream: Stream | None) -> ImuSeries | None:
        if stream is None:
            return None
        stamps, rows = stream.arrays()
        rows = rows.reshape(-1, 6)
        rates, forces = rows[:, :3], rows[:, 3:]
        has_forces = bool(len(forces)) and not np.isnan(forces).all()
        keep = self._screened(stream, stamps, rows if has_forces else rates)
        if not keep.any():
            return None
        return ImuSeries(stamps[keep], rates[keep], forces[keep] if has_forces else None)

    def _fixes(self, stream: Stream | None, mapped: FixTopic | None) -> FixSeries | None:
        if stream is None or mapped is None:
            return None
        stamps, rows = stream.arrays()
        rows = rows.reshape(-1, 11)
        poses, variances = planar_poses(rows), rows[:, 6:8].copy()
        unknown = np.isnan(variances).all(axis=1)
        if mapped.position_sigma is not None:
            variances[unknown, 0] = mapped.position_sigma**2
            if mapped.heading_sigma is not None:
                variances[unknown, 1] = mapped.heading_sigma**2
            else:
                poses[unknown, 2] = np.nan
        elif len(stamps) and unknown.all():
            raise ReplayError(
                f"{self.path}: topic {stream.topic!r}: the fixes carry no covariance; give "
                "position_sigma [m], and heading_sigma [rad] if their heading is to be used, in "
                "[log.fixes]"
            )
        poses[variances[:, 1] >= NO_HEADING_VARIANCE, 2] = np.nan
        no_heading = np.isnan(poses[:, 2])
        needed = np.where(no_heading[:, None], variances[:, :1], variances)
        keep = self._screened(stream, stamps, poses[:, :2], positive=needed)
        if not keep.any():
            return None
        return FixSeries(stamps[keep], poses[keep], variances[keep])

    def _truth(self, streams: dict[str, Stream]) -> Truth | None:
        stream = streams.get("truth")
        mapped = self.topics.truth
        if stream is None or mapped is None:
            return None
        stamps, rows = stream.arrays()
        rows = rows.reshape(-1, 11)
        poses, twists = planar_poses(rows), rows[:, 8:]
        keep = self._screened(stream, stamps, poses)
        if not keep.any():
            return None
        own_twist = bool(np.isfinite(twists[keep]).all())
        twist_stream = streams.get("truth twist")
        return Truth(
            poses=PoseSeries(stamps[keep], poses[keep]),
            twists=(
                self._twists(twist_stream)
                if twist_stream is not None
                else TwistSeries(stamps[keep], twists[keep])
                if own_twist
                else None
            ),
            tracks=self._tracks(streams.get("truth tracks"), self.topics.tracks),
            source=self._truth_source(mapped),
        )

    def _truth_source(self, mapped: TruthTopic) -> str:
        """What the truth is: as the bag says, as the mapping says, or else its topic."""
        if mapped.source_topic:
            text = self._first_text(mapped.source_topic)
            if text is not None:
                return text
        return mapped.source or mapped.topic

    def _first_text(self, topic: str) -> str | None:
        """The first std_msgs/String on a topic that can be read, or None."""
        for record in self.bag.messages([topic]):
            if record.channel.msgtype != STRING:
                break
            try:
                return str(decoder(record.channel, str(self.path))(record.data).data)
            except Exception as problem:
                self.notes.append(f"topic {topic!r} cannot be read: {problem}")
        return None

    def _twists(self, stream: Stream) -> TwistSeries | None:
        stamps, rows = stream.arrays()
        rows = rows.reshape(-1, 3)
        keep = self._screened(stream, stamps, rows)
        return TwistSeries(stamps[keep], rows[keep]) if keep.any() else None


def _joints_hint(stream: Stream, mapped: TrackTopic) -> str:
    reader = stream.readers.get(JOINT_STATE)
    if not isinstance(reader, JointReader):
        return ""
    wanted, found = ", ".join((*mapped.left, *mapped.right)), ", ".join(sorted(reader.seen))
    return f"; wanted are the velocities of the joints {wanted}, found were {found or 'no joints'}"
