"""Streams: rows of numbers gathered from a topic's messages for one purpose."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.replay.bags.decoding import Definitions, decoder, stamp_of
from icreckon.replay.bags.records import Channel, Record
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.mapping.topics import Clock
from icreckon.replay.reading.clocks import Evidence, UsedClock
from icreckon.replay.reading.stamps import APART, LATE, arrival_in_order, without_steps

Row = tuple[float, ...]
RowReader = Callable[[Any], Row | None]
Readers = tuple[dict[str, RowReader], RowReader | None]
"""Readers of a topic by message type, and that of all other types, or None to refuse them."""

COLUMNS = "columns"  # placeholder for the message type of rows from a table

NAN = float("nan")
# Element 0 of a sensor_msgs/Imu covariance whose quantity the sensor does not measure.
ABSENT = -1.0


class UnusableError(Exception):
    """A message is unusable; the text is the reason for the counts of lost messages."""


def unreadable(topic: str, types: Iterable[str], purpose: str, readable: Iterable[str]) -> str:
    """Describe a topic whose messages cannot be read for a stream."""
    text = (
        f"topic {topic!r} is of type {', '.join(map(repr, types))}, of which {purpose} cannot be read; "
        f"readable are {', '.join(readable)}"
    )
    keys = BY_FIELDS.get(purpose)
    return f"{text}; or name its fields: {keys} in [log.{purpose}]" if keys else text


BY_FIELDS = {"tracks": "left and right", "imu": "angular_velocity", "fixes": "x and y"}
"""Keys by which streams are read from any type."""
OVERLAP = 1.0  # longest overlap of two parts of one log [s]


class Span(NamedTuple):
    """Start and end [ns] of a stream in a file."""

    start: int
    end: int
    source: str


def _check_parts_of_one_log(purpose: str, first: Span, other: Span) -> None:
    """Raise a ReplayError if two recordings overlap, or are days apart."""
    overlap = (min(first.end, other.end) - max(first.start, other.start)) * NANOSECOND
    advice = "; give them one by one, each as a log of its own"
    if overlap > OVERLAP:
        raise ReplayError(
            f"{first.source} and {other.source} both hold {purpose} for the same {overlap:.0f} s: two "
            f"recordings, not two parts of one{advice}"
        )
    if -overlap > APART:
        raise ReplayError(
            f"{first.source} and {other.source} are {-overlap / APART:.0f} days apart, by their "
            f"{purpose}: no parts of one log{advice}"
        )


@dataclass
class Rows:
    """Rows of numbers, with the times at which they were recorded and stamped [ns]."""

    recorded: array[int] = field(default_factory=lambda: array("q"))
    stamped: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def extend(self, other: Rows) -> None:
        """Append other rows."""
        self.recorded.extend(other.recorded)
        self.stamped.extend(other.stamped)
        self.values.extend(other.values)


@dataclass
class TopicReader:
    """A topic with the readers of its messages, or the columns of a table."""

    purpose: str  # "tracks", "imu", "fixes", "truth", ...; also in counts of dropped samples
    topic: str  # name of the topic, or of the columns
    # by message type: from a message to a row of numbers, or to None if it is not of the stream
    readers: Mapping[str, RowReader] = field(default_factory=dict)
    any_reader: RowReader | None = None  # reader of all other types; None to refuse them
    msgtype: str = ""  # the type that was found, "" before the first message


@dataclass(kw_only=True)
class Stream(TopicReader):
    """Rows gathered for one purpose: from a topic, maybe a second one, or tables."""

    source: str  # name of the bag, for messages
    time: Clock  # requested clock of the stamps
    # topic of the right side, or of an IMU's accelerations: rows have NaN for what the other topic has
    second: TopicReader | None = None
    definitions: Definitions = ()  # definitions of message types that the bag may lack
    from_table: bool = False  # whether the rows come from a table
    lost: Counter[str] = field(default_factory=Counter)  # numbers of unusable messages, by reason
    notes: list[str] = field(default_factory=list)  # findings about the stream, for the user
    missing: set[str] = field(default_factory=set)  # mapped columns that all its tables lack
    joins: list[int] = field(default_factory=list)  # last row before each joined table
    _decode: dict[Channel, Callable[[bytes], Any]] = field(default_factory=dict)
    _rows: Rows = field(default_factory=Rows)
    _headless: int = 0  # number of messages without a header
    _spans: list[Span] = field(default_factory=list)  # of each file, once there are several

    @property
    def topics(self) -> dict[str, bool]:
        """Topics that are read, and whether there is no stream without them."""
        return {side.topic: True for side in (self, self.second) if side is not None}

    def side(self, topic: str) -> TopicReader:
        """Readers of one of the topics."""
        return self if self.second is None or topic == self.topic else self.second

    def take(self, record: Record) -> None:
        """Add a message.

        Raises:
            ReplayError: the message type is unsupported for this stream, or has no definition.
        """
        decode = self._decode.get(record.channel) or self._add_decoder(record.channel)
        try:
            message = decode(record.data)
            self._take(record, message)
        except ReplayError as problem:
            raise ReplayError(f"{self.source}: topic {record.channel.topic!r}: {problem}") from None
        except UnusableError as problem:
            self.lose(str(problem))
        except Exception:
            # Any error of rosbags or a reader means that the bytes are not a message of this type.
            self.lose("cannot be decoded")

    def lose(self, reason: str, count: int = 1) -> None:
        """Count unusable messages."""
        if count:
            self.lost[reason] += count

    def extend(self, other: Stream) -> None:
        """Append a stream of the same purpose from another file.

        Raises:
            ReplayError: it has another message type, or belongs to another recording.
        """
        if self.msgtype and other.msgtype and self.msgtype != other.msgtype:
            raise ReplayError(
                f"{self.purpose} are of type {self.msgtype!r} in {self.source}, and of type "
                f"{other.msgtype!r} in {other.source}; one log has them of one type"
            )
        spans, other_spans = self._spans_of_files(), other._spans_of_files()
        # Tables with other columns cover the same time; other files are parts, one after the other.
        if not (self.missing or other.missing):
            for span, other_span in product(spans, other_spans):
                _check_parts_of_one_log(self.purpose, span, other_span)
        elif self._rows.recorded and other._rows.recorded:
            self.joins.append(len(self._rows.recorded) - 1)
        self.missing &= other.missing
        self._spans = [*spans, *other_spans]
        self.msgtype = self.msgtype or other.msgtype
        self.lost.update(other.lost)
        self.notes.extend(note for note in other.notes if note not in self.notes)
        self._rows.extend(other._rows)
        self._headless += other._headless

    def _spans_of_files(self) -> list[Span]:
        """Start and end of the stream in each file that has rows of it."""
        recorded = self._rows.recorded
        if self._spans or not recorded:
            return self._spans
        return [Span(min(recorded), max(recorded), self.source)]

    def add(self, stamps: Stamps, rows: Floats) -> None:
        """Add (n,) stamps [ns] and (n, k) rows that do not come from messages."""
        for times in (self._rows.recorded, self._rows.stamped):
            times.frombytes(stamps.astype(np.int64).tobytes())
        self._rows.values.frombytes(np.ascontiguousarray(rows, dtype=float).tobytes())

    def evidence(self) -> Evidence:
        """Evidence about the clock of the stream."""
        if self._headless or not self._rows.stamped:
            return Evidence(self.time, None)
        stamped = np.frombuffer(self._rows.stamped, dtype=np.int64)
        recorded = np.frombuffer(self._rows.recorded, dtype=np.int64)
        order = np.argsort(recorded, kind="stable")
        offsets = without_steps(stamped[order], recorded[order])[0] - recorded[order]
        constant = len(stamped) > 1 and bool((stamped == stamped[0]).all())
        return Evidence(self.time, float(np.median(offsets)) * NANOSECOND, constant)

    def arrays(self, clock: UsedClock) -> tuple[Stamps, Floats]:
        """Stamps (n,) [ns] and rows (n, k), sorted except for those far out of order.

        Raises:
            ReplayError: header stamps were requested, but there are none or all are zero.
        """
        return self._in_order(clock, self._rows)

    def _in_order(self, clock: UsedClock, gathered: Rows) -> tuple[Stamps, Floats]:
        recorded = np.array(gathered.recorded, dtype=np.int64)
        stamped = np.array(gathered.stamped, dtype=np.int64)
        rows = np.array(gathered.values, dtype=float)
        order = np.argsort(recorded, kind="stable")
        apart = np.diff(recorded)
        apart[self.joins] = 0  # joined tables begin at the same time
        if self.from_table and (back := int((apart < 0).sum())):
            row = int(apart.argmin())
            seconds = -int(apart[row]) * NANOSECOND
            note = f"times of {self.purpose} go back ({back} x): rows are sorted by them"
            if seconds > LATE:
                restart = f"set them back by {seconds:.1f} s after row {row + 1}"
                note += f"; if a restart {restart}, cut the file there"
            self.notes.append(note)
        rows = rows.reshape(len(recorded), -1) if len(recorded) else np.empty((0, 0))
        recorded, stamped, rows = recorded[order], stamped[order], rows[order]
        stamps = recorded
        if clock == "header":
            missing = "messages have no header" if self._headless else ""
            if len(stamped) > 1 and not stamped.any():
                missing = missing or "header stamps are all zero"
            if missing:
                raise ReplayError(
                    f"{self.source}: topic {self.topic!r}: the {missing}; "
                    'set time = "recording" for it in the robot file'
                )
            stamps, steps = without_steps(stamped, recorded)
            for place, step in steps:
                seconds = (int(recorded[place]) - int(recorded[0])) * NANOSECOND
                self.notes.append(
                    f"the clock of {self.purpose} was set {'forward' if step > 0 else 'back'} by "
                    f"{abs(step):.2f} s, {seconds:.0f} s after the start; its stamps go on by the old one"
                )
        places, moved = arrival_in_order(stamps)
        if moved:
            self.notes.append(
                f"{moved} messages for {self.purpose} came out of order, by less than "
                f"{LATE:g} s, and were sorted"
            )
        return stamps[places], rows[places]

    def _add_decoder(self, channel: Channel) -> Callable[[bytes], Any]:
        """Make and keep the decoder of a channel, if its messages can be read."""
        side = self.side(channel.topic)
        if channel.msgtype not in side.readers and side.any_reader is None:
            problem = unreadable(channel.topic, [channel.msgtype], self.purpose, side.readers)
            raise ReplayError(f"{self.source}: {problem}")
        if side.msgtype not in ("", channel.msgtype):
            raise ReplayError(
                f"{self.source}: topic {channel.topic!r} carries two types of message, "
                f"{side.msgtype!r} and {channel.msgtype!r}"
            )
        self._decode[channel] = decoder(channel, self.source, self.definitions)
        side.msgtype = channel.msgtype
        return self._decode[channel]

    def _take(self, record: Record, message: Any) -> None:
        side = self.side(record.channel.topic)
        reader = side.readers.get(record.channel.msgtype, side.any_reader)
        row = None if reader is None else reader(message)
        if row is None:
            return
        header = getattr(message, "header", None)
        self._headless += header is None
        self._rows.recorded.append(record.time)
        self._rows.stamped.append(0 if header is None else stamp_of(header))
        self._rows.values.extend(row)
