"""Live inputs: messages of the mapped topics to measurements."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import compose
from icreckon.estimator.log.body_velocities import LEAST
from icreckon.estimator.log.measurements import (
    HeadingFix,
    ImuSample,
    Measurement,
    PositionFix,
    TrackSpeeds,
)
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.bags.decoding import NANOSECONDS, stamp_of
from icreckon.replay.bags.message_types import JOINT_STATE, NAVSATFIX
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.live.apart_messages import ApartMessages
from icreckon.replay.live.base_frame import CENTRE, Pose
from icreckon.replay.live.clock_watch import ClockWatch
from icreckon.replay.live.silence import missing_joints
from icreckon.replay.mapping.geodesy import Origin, east_north, on_globe
from icreckon.replay.mapping.topics import FixTopic, TopicMap, TrackTopic, VelocityTopic
from icreckon.replay.mapping.track_units import differences
from icreckon.replay.reading import conversions
from icreckon.replay.reading.clocks import (
    CLOCKS_APART,
    Choice,
    Evidence,
    choose_clocks,
    clocks_agree,
)
from icreckon.replay.reading.gather import wanted_streams
from icreckon.replay.reading.message_rows import JointReader, pose_parts
from icreckon.replay.reading.stream import Row, Stream, TopicReader, UnusableError, unreadable
from icreckon.replay.reading.tf import TransformStream
from icreckon.replay.reading.wheels import mean_of_sides

PURPOSES = ("tracks", "imu", "fixes", "heading", "velocity")  # streams that a live estimator uses
WATCHED = ("tracks", "imu")  # streams whose stamps show that a clock was set forward
WITNESSES = 5  # messages of each stream of tracks and IMU after which the clocks are chosen
LONGEST_WAIT = 2.0  # time after the first message at which the clocks are chosen at the latest [s]
PROMPT = 0.9  # quantile of header stamp minus arrival that stands for a stream [-]
LEFT_OVER, AHEAD = 2 * NANOSECONDS, NANOSECONDS
"""Time after the clock went back in which messages so far ahead are left over [ns]."""
TRANSFORM_MEMORY = 2 * NANOSECONDS  # age of the oldest transforms that are kept [ns]


class Subscription(NamedTuple):
    """Topic that is subscribed to."""

    purpose: str  # one of `PURPOSES`
    topic: str  # its name
    types: tuple[str, ...]  # supported message types; empty if any type is read by field paths
    latched: bool = False  # True if late subscribers get the last messages, as of /tf_static


class _Arrived(NamedTuple):
    """Row of a message; times in ns, header None without a stamp or with a stamp of 0."""

    purpose: str
    msgtype: str
    header: int | None
    arrival: int
    row: Row


@dataclass
class LiveInputs:
    """Converter of live messages to measurements.

    Header stamps are used where the clocks of the streams agree, as in a replay
    (`icreckon.replay.reading.clocks`); until that is known, for the first messages, measurements are held
    back.
    """

    robot: Robot  # the robot
    mapping: TopicMap  # topics of its streams
    lost: dict[str, int] = field(default_factory=dict)  # unusable messages by "purpose: reason"
    clocks: dict[str, Choice] = field(default_factory=dict)  # chosen clock of each stream
    origin: Origin | None = None  # origin of NavSatFix: that of the robot file, or the first fix
    geodetic: bool = False  # whether fixes come as NavSatFix
    fix_frame: str = ""  # frame of the newest fix by its header, empty if it names none
    # pose x, y [m], yaw [rad] in map of the frame that poses are in
    place_of_frame: Callable[[str], Pose] = lambda _: CENTRE
    heard: dict[str, int] = field(default_factory=dict)  # first arrival on each topic [ns]
    clock_step: int = 0  # by which the stamps' clock was set forward at the newest message [ns]
    _watch: ClockWatch[_Arrived] = field(default_factory=ClockWatch)
    _streams: dict[str, Stream] = field(default_factory=dict)
    _waiting: list[_Arrived] = field(default_factory=list)
    _begun: int | None = None  # arrival of the first message [ns]
    _wheels: ApartMessages = field(default_factory=ApartMessages)
    _forces: ApartMessages = field(default_factory=lambda: ApartMessages(at=0))
    _counter: tuple[int, Floats] | None = None  # newest positions of wheels, with their stamp [ns]
    _odometry: tuple[int, Floats] | None = None  # newest row of another odometry, stamp [ns]
    _newest_transform: int = -1  # its stamp [ns]; -1 before the first
    _went_back: int | None = None  # time to which the clock of arrivals went back [ns]
    _ahead_ns: int = 0  # header stamp minus arrival of the newest message

    def __post_init__(self) -> None:
        """Refuse a mapping without track speeds (ReplayError)."""
        if self.mapping.tracks is None:
            raise ReplayError(
                f"the robot file of {self.robot.name!r} maps no track speeds: add [log.tracks] with "
                'topic = "/joint_states", left = ["..."] and right = ["..."]'
            )
        self._streams = {
            stream.purpose: stream
            for stream in wanted_streams(self.mapping, f"robot {self.robot.name!r}", (), {})
            if stream.purpose in PURPOSES
        }
        if self.mapping.fixes is not None:
            self.origin = self.mapping.fixes.origin

    def subscriptions(self) -> list[Subscription]:
        """Topics to subscribe to."""
        subscriptions = []
        for purpose, stream in self._streams.items():
            types = () if stream.any_reader is not None else tuple(stream.readers)
            subscriptions += [
                Subscription(purpose, topic, types, not is_needed)
                for topic, is_needed in stream.topics.items()
            ]
        return subscriptions

    def fitting_types(self, subscription: Subscription) -> tuple[str, ...]:
        """Message types that can be read for a stream without the names of their fields."""
        return tuple(self._streams[subscription.purpose].readers)

    def missing_joints(self, now: int) -> str:
        """Text on mapped joints that no message has had so far; empty if there are none.

        The text is empty, too, until `now` [ns] is `LONGEST_WAIT` after the first message.
        """
        stream = self._streams["tracks"]
        first, reader = self.heard.get(stream.topic), stream.readers.get(JOINT_STATE)
        if first is None or (now - first) * NANOSECOND < LONGEST_WAIT:
            return ""
        if not isinstance(reader, JointReader) or not reader.seen:
            return ""
        return missing_joints(stream.topic, reader.joints, reader.seen)

    def take(
        self,
        subscription: Subscription,
        msgtype: str,
        message: Any,
        arrival: int,
        steady: int | None = None,
    ) -> list[Measurement]:
        """Convert a message to measurements; arguments as of `LiveOdometry.take`.

        There are none while the clocks are not chosen, then several. `clock_step` is that before these.

        Raises:
            ReplayError: the type cannot be read for this stream, or a mapped field is missing.
        """
        stream = self._streams[subscription.purpose]
        self.heard.setdefault(subscription.topic, arrival)
        topic = subscription.topic
        if isinstance(stream, TransformStream):
            arrived = self._transforms(stream, topic, msgtype, message, arrival)
        else:
            arrived = self._read(stream.side(topic), msgtype, message, arrival)
        self.clock_step = 0
        arrived = [self._stamped(row) for row in arrived]
        if subscription.purpose in WATCHED:
            steady = arrival if steady is None else steady
            arrived = [ready for row in arrived for ready in self._watched(row, steady)]
        if not arrived:
            return []
        self._waiting += arrived
        if self._begun is None:
            self._begun = arrival
        return self._ready(arrival)

    def flush(self, now: int) -> list[Measurement]:
        """Measurements that are ready at `now` [ns], by the clock of the arrivals."""
        return self._ready(now) if self._waiting else []

    def restart(self, now: int | None = None) -> None:
        """Forget the clocks and all waiting messages.

        `now` is the time to which the clock of arrivals went back [ns], if it did: messages that were
        sent before and arrive late are then dropped.
        """
        self._went_back = now
        self.clocks.clear()
        self._watch = ClockWatch()
        self._waiting.clear()
        self._wheels, self._forces = ApartMessages(), ApartMessages(at=0)
        self._begun, self._counter, self._newest_transform, self._ahead_ns = None, None, -1, 0
        self._odometry = None
        for stream in self._streams.values():
            if isinstance(stream, TransformStream):
                stream.forget_transforms()

    # --- rows ------------------------------------------------------------------------------------

    def _read(self, side: TopicReader, msgtype: str, message: Any, arrival: int) -> list[_Arrived]:
        """Read a message to a list of one; to none if it has nothing that can be used."""
        purpose, reader = side.purpose, side.readers.get(msgtype, side.any_reader)
        if reader is None:
            raise ReplayError(unreadable(side.topic, [msgtype], purpose, side.readers))
        try:
            row = reader(message)
        except UnusableError as problem:
            return self._lose(purpose, str(problem))
        except (IndexError, ValueError):
            return self._lose(purpose, "cannot be read")
        if row is None:
            return []
        header = getattr(message, "header", None)
        if header is not None and purpose == "fixes":
            self.fix_frame = header.frame_id.removeprefix("/")
        stamp = None if header is None else stamp_of(header) or None  # 0 is no stamp
        if stamp is not None and self._is_left_over(stamp, arrival):
            return self._lose(purpose, "from before the clock went back")
        return [_Arrived(purpose, msgtype, stamp, arrival, row)]

    def _transforms(
        self, stream: TransformStream, topic: str, msgtype: str, message: Any, arrival: int
    ) -> list[_Arrived]:
        """Poses that the newest transforms of a chain of frames complete."""
        stream.add_transforms(topic, arrival, message)
        stream.forget_transforms(TRANSFORM_MEMORY)
        try:
            stamps, rows = stream.arrays("header")
        except ReplayError:
            return []  # the chain of frames is not complete yet
        new = stamps > self._newest_transform
        if new.any():
            self._newest_transform = int(stamps[-1])
        return [
            _Arrived(stream.purpose, msgtype, stamp or None, arrival, tuple(row))
            for stamp, row in zip(stamps[new].tolist(), rows[new].tolist(), strict=True)
        ]

    def _stamped(self, arrived: _Arrived) -> _Arrived:
        """Convert the arrival to the clock of the headers where it serves as the stamp."""
        converted = arrived.arrival + self._ahead_ns
        if self._is_by_header(arrived):
            return arrived._replace(header=converted) if arrived.header is None else arrived
        if abs(self._ahead_ns) * NANOSECOND <= CLOCKS_APART:
            return arrived
        return arrived._replace(arrival=converted)

    def _is_by_header(self, arrived: _Arrived) -> bool:
        choice = self.clocks.get(arrived.purpose)
        return choice is not None and choice.clock == "header"

    def _watched(self, arrived: _Arrived, steady: int) -> list[_Arrived]:
        """Messages, held back until it is certain whether a clock was set forward."""
        if arrived.purpose not in self.clocks:
            return [arrived]
        stamp = arrived.header if self._is_by_header(arrived) else None
        stamp = arrived.arrival if stamp is None else stamp
        watched = self._watch.take(arrived.purpose, stamp, steady, arrived)
        for _ in range(watched.lost):
            self._lose(arrived.purpose, "stamp far ahead")
        self.clock_step = watched.step
        for ready in watched.ready:
            if self._is_by_header(ready) and ready.header is not None:
                self._ahead_ns = ready.header - ready.arrival
        return watched.ready

    def _is_left_over(self, stamp: int, arrival: int) -> bool:
        """True for a message that was sent before the clock went back a short time ago."""
        back = self._went_back
        if back is None or arrival - back > LEFT_OVER:
            self._went_back = None
            return False
        return stamp - arrival > AHEAD

    def _lose(self, purpose: str, reason: str) -> list[_Arrived]:
        """Count a message as lost; return no message, for the caller to return."""
        name = f"{purpose}: {reason}"
        self.lost[name] = self.lost.get(name, 0) + 1
        return []

    # --- clocks ----------------------------------------------------------------------------------

    def _ready(self, now: int) -> list[Measurement]:
        """Measurements of all waiting messages; none until the clock of each is chosen."""
        has_clocks = all(waiting.purpose in self.clocks for waiting in self._waiting)
        if not has_clocks and not self._choose(now):
            return []
        ready = list(chain.from_iterable(map(self._measurements, self._waiting)))
        self._waiting.clear()
        return ready

    def _choose(self, now: int) -> bool:
        """Choose the clocks of streams that have none; return False if it is too early.

        Earlier choices remain. If clocks disagree, the choice waits until `LONGEST_WAIT`: a computer that
        is busy at the start takes the messages of one topic seconds after those of another.
        """
        watched = WATCHED if self.mapping.imu else ("tracks",)
        purposes = [waiting.purpose for waiting in self._waiting]
        counts = {name: purposes.count(name) for name in watched}
        are_chosen = all(name in self.clocks for name in watched)
        waited = (now - (self._begun or now)) * NANOSECOND
        may_wait = not are_chosen and waited < LONGEST_WAIT
        if may_wait and min(counts.values()) < WITNESSES:
            return False
        evidence = self._evidence()
        if may_wait and not clocks_agree(evidence):
            return False
        for purpose, choice in choose_clocks(evidence).items():
            self.clocks.setdefault(purpose, choice)
        return True

    def _evidence(self) -> dict[str, Evidence]:
        """Evidence about the clocks of the streams, those that are chosen included."""
        evidence = {}
        for purpose, stream in self._streams.items():
            rows = [waiting for waiting in self._waiting if waiting.purpose == purpose]
            if purpose in self.clocks:
                evidence[purpose] = Evidence(stream.time, 0.0)
            elif rows:
                offsets = [row.header - row.arrival for row in rows if row.header is not None]
                offset = None
                if len(offsets) == len(rows):
                    # That of a message that did not wait long.
                    offset = float(np.quantile(offsets, PROMPT, method="lower")) * NANOSECOND
                constant = len(rows) > 1 and len({row.header for row in rows}) == 1
                evidence[purpose] = Evidence(stream.time, offset, constant)
        return evidence

    # --- measurements ------------------------------------------------------------------------------

    def _measurements(self, arrived: _Arrived) -> Iterator[Measurement]:
        """Measurements of a message, at its stamp less the latency of its stream."""
        _, msgtype, header, arrival, row = arrived
        is_recording = self.clocks[arrived.purpose].clock == "recording"
        mapped = getattr(self.mapping, arrived.purpose)
        stamp = arrival if is_recording or header is None else header
        stamp -= round(mapped.latency / NANOSECOND)
        rows = np.array([row], dtype=float)
        match arrived.purpose:
            case "tracks":
                yield from self._tracks(stamp, rows, msgtype, mapped)
            case "imu":
                complete = [(stamp, rows[0])]
                if mapped.acceleration_topic:
                    complete = self._forces.take(stamp, rows[0], None)
                for row_stamp, values in complete:
                    x, y, z, a_x, a_y, a_z = values.tolist()
                    yield ImuSample(row_stamp, (x, y, z), (a_x, a_y, a_z))
            case "fixes":
                yield from self._fix(stamp, rows, msgtype, mapped)
            case "velocity":
                yield from self._velocity(stamp, rows, mapped)
            case _:
                yaw, variances = conversions.headings(rows, mapped)
                if np.isnan(variances).any():
                    self._lose("heading", "no covariance, and no sigma given")
                else:
                    yield HeadingFix(stamp, float(yaw[0]), float(variances[0]))

    def _tracks(
        self, stamp: int, rows: Any, msgtype: str, mapped: TrackTopic
    ) -> Iterator[Measurement]:
        """Track speeds, once all wheels have come; from positions, from the second on."""
        vehicle = self.robot.vehicle
        wheels = conversions.wheel_values(rows, msgtype, mapped, vehicle)
        for row_stamp, values in self._wheels.take(stamp, wheels.values[0], wheels.wrap):
            if not wheels.are_counters:
                yield _track_speeds(row_stamp, values, wheels.left_count)
                continue
            last, self._counter = self._counter, (row_stamp, values)
            last_stamp, last_values = last or (row_stamp, values)
            if row_stamp <= last_stamp:
                continue
            stamps, readings = np.array([last_stamp, row_stamp]), np.stack([last_values, values])
            ends, speeds, lost = differences(stamps, readings, wheels.wrap, vehicle.max_track_speed)
            for reason in lost:
                self._lose("tracks", reason)
            for end, wheel_speeds in zip(ends.tolist(), speeds, strict=True):
                yield _track_speeds(end, wheel_speeds, wheels.left_count)

    def _fix(self, stamp: int, rows: Any, msgtype: str, mapped: FixTopic) -> Iterator[Measurement]:
        if msgtype == NAVSATFIX or mapped.latitude:
            self.geodetic = True
            if not on_globe(rows).all():
                self._lose("fixes", "not a place on the globe")
                return
            if self.origin is None:
                latitude, longitude, altitude = rows[0, :3].tolist()
                self.origin = (latitude, longitude, altitude if np.isfinite(altitude) else 0.0)
            poses = np.full((1, 3), np.nan)
            poses[:, :2] = east_north(rows[:, :3], self.origin)
            variances = np.array([[rows[0, 3], np.nan]])
            heights = rows[:, 2] - self.origin[2]
        else:
            poses, variances, heights = pose_parts(rows)
        if conversions.fill_variances(variances, mapped).any():
            self._lose("fixes", "no covariance, and no position_sigma given")
            return
        known = conversions.without_unknown_headings(poses, variances)[0]
        place = CENTRE if self.geodetic else self.place_of_frame(self.fix_frame)
        x, y, yaw = compose(place, known).tolist()
        variance, yaw_variance = variances[0].tolist()
        yield PositionFix(stamp, x, y, variance, *mapped.position)
        if np.isfinite(yaw):
            yield HeadingFix(stamp, yaw, yaw_variance)
        yield from conversions.fix_heights(np.array([stamp]), heights, mapped)

    def _velocity(self, stamp: int, rows: Floats, mapped: VelocityTopic) -> Iterator[Measurement]:
        """Velocity by a row, or of poses by the row before and this one."""
        stamps, last = np.array([stamp]), self._odometry
        if np.isfinite(rows[0, 0]):
            if last is not None:
                if abs(stamp - last[0]) < LEAST:
                    return
                stamps, rows = np.array([last[0], stamp]), np.stack([last[1], rows[0]])
            self._odometry = stamp, rows[-1]
        yield from conversions.velocities(stamps, rows, mapped)


def _track_speeds(stamp: int, wheel_speeds: Floats, left_count: int) -> TrackSpeeds:
    """Track speeds from wheel speeds (k,) [m/s], left wheels first."""
    left, right = mean_of_sides(wheel_speeds[None], left_count)[0].tolist()
    wheels = tuple(wheel_speeds.tolist())
    if len(wheels) == 2:
        return TrackSpeeds(stamp, left, right)
    return TrackSpeeds(stamp, left, right, wheels[:left_count], wheels[left_count:])
