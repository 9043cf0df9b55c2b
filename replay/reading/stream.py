"""Streams: the rows of numbers gathered of a topic's messages for one purpose."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.replay.bags.decoding import NANOSECONDS, Definitions, decoder
from icreckon.replay.bags.records import Channel, Record
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.mapping.topics import Clock
from icreckon.replay.reading.clock_steps import without_steps
from icreckon.replay.reading.clocks import Evidence
from icreckon.replay.reading.ordering import WINDOW, arrival_in_order

Row = tuple[float, ...]
RowReader = Callable[[Any], Row | None]
Quick = Callable[[bytes], tuple[int, Row | None]]

COLUMNS = "columns"
"""Stands for the type of messages where rows come from a table."""

NAN = float("nan")
ABSENT = -1.0
"""Element 0 of a sensor_msgs/Imu covariance whose quantity the sensor does not measure."""


class UnusableError(Exception):
    """A message is of no use; the text says why, for the counts."""


OVERLAP = 1.0
"""Parts of one log may overlap by so much [s]; two recordings of one robot overlap by more."""
APART = 86_400.0
"""Parts of one log are no further apart [s]."""


class Span(NamedTuple):
    """From when to when [ns] a file has a stream."""

    start: int
    end: int
    source: str


def _check_parts_of_one_log(purpose: str, one: Span, other: Span) -> None:
    """Refuse two recordings that cannot be parts of one log.

    Raises:
        ReplayError: they overlap, or are days apart.
    """
    overlap = (min(one.end, other.end) - max(one.start, other.start)) * NANOSECOND
    advice = "; give them one by one, each as a log of its own"
    if overlap > OVERLAP:
        raise ReplayError(
            f"{one.source} and {other.source} both hold {purpose} for the same {overlap:.0f} s: two "
            f"recordings, not two parts of one{advice}"
        )
    if -overlap > APART:
        raise ReplayError(
            f"{one.source} and {other.source} are {-overlap / APART:.0f} days apart, by their {purpose}: "
            f"no parts of one log{advice}"
        )


@dataclass
class Stream:
    """The rows gathered of one topic for one purpose.

    Attributes:
        purpose: "tracks", "imu", "fixes", "truth", ...; the name in the counts of dropped samples.
        topic: the topic.
        source: name of the bag, for messages.
        time: which clock is to stamp the rows.
        readers: for each message type that will do, what to take of a message: a row of numbers,
            or None for a message that is none of this stream's business.
        any_reader: what to take of messages of all other types; None to refuse them.
        definitions: of message types that the bag may lack.
        quick: gives a faster way from bytes to stamp and row, for channels that have one.
        msgtype: the type that was found, "" before the first message.
        from_table: whether the rows come from a table.
        lost: how many messages were of no use, by reason.
        notes: what is worth telling of the stream.
    """

    purpose: str
    topic: str
    source: str
    time: Clock
    readers: Mapping[str, RowReader]
    any_reader: RowReader | None = None
    definitions: Definitions = ()
    msgtype: str = ""
    from_table: bool = False
    lost: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    quick: Callable[[Channel, RowReader], Quick | None] | None = None
    _quick: dict[Channel, Quick] = field(default_factory=dict)
    _decode: dict[Channel, Callable[[bytes], Any]] = field(default_factory=dict)
    _recorded: array[int] = field(default_factory=lambda: array("q"))
    _stamped: array[int] = field(default_factory=lambda: array("q"))
    _rows: array[float] = field(default_factory=lambda: array("d"))
    _headless: int = 0
    _parts: list[Span] = field(default_factory=list)

    def _spans(self) -> list[Span]:
        """From when to when each file has it."""
        if self._parts or not len(self._recorded):
            return self._parts
        return [Span(min(self._recorded), max(self._recorded), self.source)]

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics whose messages it takes."""
        return (self.topic,)

    def take(self, record: Record) -> None:
        """Add a message.

        Raises:
            ReplayError: a message type that this stream cannot be read from, or no definition.
        """
        decode = self._decode.get(record.channel) or self._decoder(record.channel)
        if record.channel in self._quick and self._take_quickly(record):
            return
        try:
            message = decode(record.data)
            self._take(record, message)
        except ReplayError as problem:
            raise ReplayError(f"{self.source}: topic {self.topic!r}: {problem}") from None
        except UnusableError as problem:
            self.lose(str(problem))
        except Exception:
            # Whatever rosbags or a reader stumbles over, the bytes are no message of this type.
            self.lose("cannot be decoded")

    def lose(self, reason: str, count: int = 1) -> None:
        """Count messages that are of no use."""
        if count:
            self.lost[reason] = self.lost.get(reason, 0) + count

    def extend(self, other: Stream) -> None:
        """Add what was gathered for the same purpose elsewhere.

        Raises:
            ReplayError: it is of another type of message, or of another recording.
        """
        if self.msgtype and other.msgtype and self.msgtype != other.msgtype:
            raise ReplayError(
                f"{self.purpose} are of type {self.msgtype!r} in {self.source}, and of type "
                f"{other.msgtype!r} in {other.source}; one log has them of one type"
            )
        for span in self._spans():
            for another in other._spans():
                _check_parts_of_one_log(self.purpose, span, another)
        self._parts = [*self._spans(), *other._spans()]
        self.msgtype = self.msgtype or other.msgtype
        for reason, count in other.lost.items():
            self.lose(reason, count)
        self.notes.extend(note for note in other.notes if note not in self.notes)
        self._recorded.extend(other._recorded)
        self._stamped.extend(other._stamped)
        self._rows.extend(other._rows)
        self._headless += other._headless

    def add(self, stamps: Stamps, rows: Floats) -> None:
        """Add (n,) stamps [ns] and (n, k) rows that come from no messages."""
        self._recorded.frombytes(stamps.astype(np.int64).tobytes())
        self._stamped.frombytes(stamps.astype(np.int64).tobytes())
        self._rows.frombytes(np.ascontiguousarray(rows, dtype=float).tobytes())

    def evidence(self) -> Evidence:
        """What the stream shows of its clock."""
        if self._headless or not len(self._stamped):
            return Evidence(self.topic, self.time, None)
        stamped = np.frombuffer(self._stamped, dtype=np.int64)
        recorded = np.frombuffer(self._recorded, dtype=np.int64)
        order = np.argsort(recorded, kind="stable")
        offsets = without_steps(stamped[order], recorded[order])[0] - recorded[order]
        constant = len(stamped) > 1 and bool((stamped == stamped[0]).all())
        return Evidence(self.topic, self.time, float(np.median(offsets)) * NANOSECOND, constant)

    def arrays(self, clock: Literal["header", "recording"]) -> tuple[Stamps, Floats]:
        """(n,) stamps [ns] and (n, k) rows, in order but for what is far out of it.

        Raises:
            ReplayError: stamps of the headers were asked for, and there are none or all are zero.
        """
        recorded = np.array(self._recorded, dtype=np.int64)
        rows = np.array(self._rows, dtype=float)
        return self._in_order(clock, recorded, np.array(self._stamped, dtype=np.int64), rows)

    def _in_order(
        self,
        clock: Literal["header", "recording"],
        recorded: Stamps,
        stamped: Stamps,
        rows: Floats,
    ) -> tuple[Stamps, Floats]:
        order = np.argsort(recorded, kind="stable")
        stamps = recorded
        if clock == "header":
            stamps = stamped
            missing = "messages have no header" if self._headless else ""
            if len(stamps) > 1 and not stamps.any():
                missing = missing or "header stamps are all zero"
            if missing:
                raise ReplayError(
                    f"{self.source}: topic {self.topic!r}: the {missing}; "
                    'set time = "recording" for it in the robot file'
                )
        rows = rows.reshape(len(stamps), -1) if len(stamps) else np.empty((0, 0))
        stamps, rows = stamps[order], rows[order]
        if clock == "header":
            stamps, steps = without_steps(stamps, recorded[order])
            for place, step in steps:
                seconds = (int(recorded[order[place]]) - int(recorded[order[0]])) * NANOSECOND
                self.notes.append(
                    f"the clock of {self.purpose} was set {'forward' if step > 0 else 'back'} by "
                    f"{abs(step):.2f} s, {seconds:.0f} s after the start; its stamps go on by the old one"
                )
        places, moved = arrival_in_order(stamps)
        if moved:
            self.notes.append(
                f"{moved} messages for {self.purpose} came out of order, by less than "
                f"{WINDOW:g} s, and were sorted"
            )
        return stamps[places], rows[places]

    def _decoder(self, channel: Channel) -> Callable[[bytes], Any]:
        if channel.msgtype not in self.readers and self.any_reader is None:
            raise ReplayError(
                f"{self.source}: topic {self.topic!r} is of type {channel.msgtype!r}, of which "
                f"{self.purpose} cannot be read; readable are {', '.join(self.readers)}"
            )
        if self.msgtype not in ("", channel.msgtype):
            raise ReplayError(
                f"{self.source}: topic {self.topic!r} carries two types of message, "
                f"{self.msgtype!r} and {channel.msgtype!r}"
            )
        self._decode[channel] = decoder(channel, self.source, self.definitions)
        self.msgtype = channel.msgtype
        reader = self.readers.get(channel.msgtype)
        if self.quick is not None and reader is not None:
            quick = self.quick(channel, reader)
            if quick is not None:
                self._quick[channel] = quick
        return self._decode[channel]

    def _take(self, record: Record, message: Any) -> None:
        reader = self.readers.get(record.channel.msgtype, self.any_reader)
        if reader is None:
            return
        row = reader(message)
        if row is None:
            return
        header = getattr(message, "header", None)
        stamp = 0
        if header is None:
            self._headless += 1
        else:
            stamp = header.stamp.sec * NANOSECONDS + header.stamp.nanosec
        self._put(record.time, stamp, row)

    def _take_quickly(self, record: Record) -> bool:
        """Whether the message was one for the quick way; the ordinary one judges those that are not."""
        try:
            stamp, row = self._quick[record.channel](record.data)
        except Exception:
            return False
        if row is not None:
            self._put(record.time, stamp, row)
        return True

    def _put(self, recorded: int, stamp: int, row: Row) -> None:
        self._recorded.append(recorded)
        self._stamped.append(stamp)
        self._rows.extend(row)
