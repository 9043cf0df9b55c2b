"""Bag writer: messages of several topics in the order of their stamps."""

import re
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags import interfaces, rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin

from icreckon.estimator.base.array_types import Stamps
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.messages import Messages
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.base.outputs import written_beside

Format = Literal["mcap", "sqlite3", "ros1"]

PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}

MARK = "written_by_icreckon"  # text in each bag, without which none is replaced

UNSPECIFIED = interfaces.QosTime(0, 0)
LATCHED = interfaces.Qos(
    history=interfaces.QosHistory.KEEP_LAST,
    depth=1,
    reliability=interfaces.QosReliability.RELIABLE,
    durability=interfaces.QosDurability.TRANSIENT_LOCAL,
    deadline=UNSPECIFIED,
    lifespan=UNSPECIFIED,
    liveliness=interfaces.QosLiveliness.AUTOMATIC,
    liveliness_lease_duration=UNSPECIFIED,
    avoid_ros_namespace_conventions=False,
)
"""Quality of service of a latched topic."""

BLOCK = 1024  # messages that are in memory at once
NUMBER_BYTES = 8  # bytes of a float64, and of a stamp of seconds and nanoseconds
PLACEHOLDER_STAMP = 1_234_567_890_987_654_321
LARGEST_STAMP = 2**31 * NANOSECONDS  # both ROS 1 and ROS 2 store the seconds of a stamp in 32 bits


class Outbox(NamedTuple):
    """Messages of one topic."""

    topic: str  # the topic
    msgtype: str  # their type
    stamps: Stamps  # (n,) their stamps [ns]
    # function that makes the fields of a message, see `Messages.new`, from a stamp [ns] and a row of each
    # column; they hold the numbers of the rows unchanged, as float64
    fields: Callable[..., dict[str, Any]]
    columns: tuple[NDArray[Any], ...] = ()  # arrays (n, ...) of their numbers
    latched: bool = False  # whether who subscribes later gets the newest message, too

    def serialised(self, messages: Messages) -> Iterator[bytes]:
        """Yield the messages as bytes: they differ in the numbers of their rows alone.

        One message of placeholders is serialised, and shows at which bytes each number is. The numbers of
        all others are filled in there as columns.

        Raises:
            ValueError: the message lacks a number, or holds it in another form.
        """
        if len(self.stamps) <= 1:
            for stamp, *row in zip(self.stamps, *self.columns, strict=True):
                yield self._bytes(messages, stamp, *row)
            return
        rng = np.random.default_rng(0)
        placeholders = [rng.uniform(1.0, 2.0, (1, *column.shape[1:])) for column in self.columns]
        data = self._bytes(messages, PLACEHOLDER_STAMP, *(row for (row,) in placeholders))
        template = np.frombuffer(data, np.uint8)
        (patterns,) = _rows(np.array([PLACEHOLDER_STAMP]), placeholders)
        places = _places(data, patterns)
        if len({number for number, _ in places}) < len(patterns):
            raise ValueError(f"a {self.msgtype} does not hold all of its numbers unchanged")
        for first in range(0, len(self.stamps), BLOCK):
            block = slice(first, first + BLOCK)
            rows = _rows(self.stamps[block], [column[block] for column in self.columns])
            block_data = np.tile(template, (len(rows), 1))
            for number, place in places:
                block_data[:, place : place + NUMBER_BYTES] = rows[:, number]
            yield from map(bytes, block_data)

    def _bytes(self, messages: Messages, stamp: int, *row: Any) -> bytes:
        """Serialise the message of a stamp [ns] and a row of each column."""
        message = messages.new(self.msgtype, **self.fields(stamp, *row))
        return bytes(messages.serialize(message, self.msgtype))


def _rows(stamps: Stamps, columns: Sequence[NDArray[Any]]) -> NDArray[np.uint8]:
    """Bytes (n, k, 8) of the stamp and the numbers of each message."""
    parts = [np.column_stack(np.divmod(stamps, NANOSECONDS)).astype("<u4")]
    parts += [column.reshape(len(column), -1).astype("<f8", order="C") for column in columns]
    numbers = np.hstack([part.view(np.uint8) for part in parts])
    return numbers.reshape(len(numbers), -1, NUMBER_BYTES)


def _places(data: bytes, patterns: NDArray[np.uint8]) -> list[tuple[int, int]]:
    """Pairs of a number of a row and a place of its bytes in a message."""
    return [
        (number, found.start())
        for number, pattern in enumerate(patterns)
        for found in re.finditer(re.escape(pattern.tobytes()), data)
    ]


def write_bag(path: Path, kind: Format, outboxes: list[Outbox], *, overwrite: bool = False) -> Path:
    """Write a bag; return its path.

    The path is that of a ROS 2 folder, or with the suffix `.mcap` or `.db3` of the bare file. A ROS 1 bag
    gets the suffix `.bag` if it is missing.

    Raises:
        ReplayError: stamps that ROS cannot hold, the path exists, or the file system refuses.
    """
    for outbox in outboxes:
        invalid = outbox.stamps[(outbox.stamps < 0) | (outbox.stamps >= LARGEST_STAMP)]
        if len(invalid):
            raise ReplayError(
                f"topic {outbox.topic!r}: the stamp {invalid[0]} ns cannot be written; stamps in bags "
                f"are from 0 to {LARGEST_STAMP - 1} ns"
            )
    path = bag_path(path, kind)
    is_bare = path.suffix == SUFFIXES.get(kind)
    try:
        with (
            written_beside(path, overwrite=overwrite, mark=MARK.encode()) as new,
            _open_writer(new, kind, is_bare=is_bare) as (writer, messages),
        ):
            _write_messages(outboxes, writer, messages)
    except (OSError, sqlite3.Error, rosbag1.WriterError, rosbag2.WriterError) as problem:
        raise ReplayError(f"{path}: cannot be written: {problem}") from problem
    return path


def bag_path(path: Path, kind: Format) -> Path:
    """Path of the bag that `write_bag` writes: the given one, with `.bag` for ROS 1."""
    if kind != "ros1" or path.suffix == ".bag":
        return path
    return path.with_name(f"{path.name}.bag")


def _write_messages(outboxes: list[Outbox], writer: Any, messages: Messages) -> None:
    """Write the messages in the order of stamps; several outboxes may share a topic."""
    connections: dict[str, Any] = {}

    def serialised(outbox: Outbox) -> Iterator[tuple[int, Any, bytes]]:
        """Yield (stamp [ns], connection, bytes); first of all, add the topic."""
        topic = outbox.topic
        if topic not in connections:
            options: dict[str, Any] = {"callerid": f"/{MARK}"} if messages.ros1 else {}
            if outbox.latched:
                options |= {"latching": 1} if messages.ros1 else {"offered_qos_profiles": [LATCHED]}
            connections[topic] = writer.add_connection(
                topic, outbox.msgtype, typestore=messages.store, **options
            )
        connection = connections[topic]
        for stamp, data in zip(outbox.stamps.tolist(), outbox.serialised(messages), strict=True):
            yield stamp, connection, data

    for stamp, connection, data in merge(*map(serialised, outboxes), key=itemgetter(0)):
        writer.write(connection, stamp, data)


@contextmanager
def _open_writer(path: Path, kind: Format, *, is_bare: bool) -> Iterator[tuple[Any, Messages]]:
    """Open a bag for writing, with a factory of its messages."""
    if kind == "ros1":
        # Uncompressed: ROS 1 itself cannot read the lz4 of rosbags ("malformed data"), and bz2 is slow.
        with rosbag1.Writer(path) as ros1_writer:
            yield ros1_writer, Messages(ros1=True)
        return
    # A folder; if it is bare, its storage file alone is moved to the path at the end.
    folder = path.with_suffix("") if is_bare else path
    writer = rosbag2.Writer(folder, version=9, storage_plugin=PLUGINS[kind])
    writer.set_custom_data(MARK, "true")
    if kind == "mcap":
        # Covariances are mostly zeros: this makes odometry five times smaller.
        writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        yield writer, Messages(ros1=False)
    if is_bare:
        (folder / path.name).rename(path)
