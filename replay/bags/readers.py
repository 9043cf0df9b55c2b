"""Readers of rosbags within limits of what they unpack and keep in memory."""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterable
from contextlib import suppress
from functools import partial
from types import MappingProxyType
from typing import Any

from rosbags import rosbag1, rosbag2
from rosbags.rosbag1.reader import Chunk, Header, RecordType
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

from icreckon.replay.bags.unpacking import (
    GIGABYTE,
    STREAM_DECOMPRESSORS,
    inflate,
    inflate_message,
    limit,
    too_large,
)
from icreckon.replay.base.errors import ReplayError

RECORD = struct.Struct("<BQ")
"""Beginning of a record of MCAP: its kind, and the length of what follows."""
LEAST_MESSAGE = RECORD.size + 22
"""Bytes of an MCAP message without content."""
LENGTH_LIMIT, LEAST_LENGTH_LIMIT = 0, 1_000_000
"""SQLite's number of the limit of the length of a value, and the least that is set [bytes]."""
LARGEST_METADATA, DEEPEST_METADATA = 500_000, 50
"""Largest metadata.yaml that is read [bytes], and most tables within one another in it."""


def check_count(count: int, size: int) -> None:
    """Refuse more messages than a file has bytes: no recorder writes them.

    Raises:
        ReplayError: there are more.
    """
    if count > size:
        raise ReplayError(
            f"holds more messages than its {size} bytes; it is damaged, or made to fill the memory"
        )


def _chunk(data: bytes, size: int, *, compression: str) -> bytes:
    """Unpack a chunk of an MCAP file, unless its messages are far more than its bytes."""
    unpacked = inflate(data, compression, size)
    if len(unpacked) > LEAST_MESSAGE * len(data):
        at = count = 0
        while at + RECORD.size <= len(unpacked):
            at += RECORD.size + RECORD.unpack_from(unpacked, at)[1]
            count += 1
            check_count(count, len(data))
    return unpacked


# The table by which rosbags unpacks the chunks of MCAP files; it checks the sizes afterwards.
DECOMPRESSORS.update({name: partial(_chunk, compression=name) for name in ("zstd", "lz4")})


class Ros1Reader(rosbag1.Reader):
    """Reader of ROS 1 bags that unpacks chunks up to the size that they declare."""

    def open(self) -> None:
        """Open the bag and read its index."""
        self._size, self._indexed = self.path.stat().st_size, 0
        super().open()

    def read_index_data(self, pos: int, indexes: Any) -> None:
        """Read the index of a chunk; it counts, as many chunks may share one."""
        assert self.bio is not None  # noqa: S101 - open, see `rosbag1.Reader`
        start = self.bio.tell()
        super().read_index_data(pos, indexes)
        self._indexed += self.bio.tell() - start
        if self._indexed > self._size:
            raise rosbag1.ReaderError("the indexes of its chunks overlap")

    def read_chunk(self) -> Chunk:
        """Read the header of a chunk."""
        assert self.bio is not None  # noqa: S101 - open, see `rosbag1.Reader`
        start = self.bio.tell()
        header = Header.read(self.bio, RecordType.CHUNK)
        compression, size = header.get_string("compression"), header.get_uint32("size")
        self.bio.seek(start)
        chunk = super().read_chunk()
        if compression not in STREAM_DECOMPRESSORS:
            return chunk
        return chunk._replace(decompressor=partial(_ros1_chunk, compression=compression, size=size))


def _ros1_chunk(data: bytes, *, compression: str, size: int) -> bytes:
    unpacked = inflate(data, compression, size)
    if len(unpacked) != size:
        raise rosbag1.ReaderError(
            f"a chunk unpacks to other than the {size} bytes that it declares"
        )
    return unpacked


class _McapReader(McapReader):
    """Reader of MCAP files that holds few chunks at a time."""

    def messages(self, *args: Any, **options: Any) -> Generator[Any, None, None]:
        """Read messages, as `McapReader.messages`.

        It holds all chunks of the same time in memory.

        Raises:
            rosbag2.ReaderError: together they unpack to more than the limit.
        """
        size = _most_at_once(
            (chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size)
            for chunk in self.chunks
        )
        largest = max((chunk.uncompressed_size for chunk in self.chunks), default=0)
        if size > max(limit(), largest):
            raise rosbag2.ReaderError(
                f"its chunks overlap in time and unpack to {size / GIGABYTE:.3g} GB together"
            )
        yield from super().messages(*args, **options)


def _most_at_once(spans: Iterable[tuple[int, int, int]]) -> int:
    """Largest sum of the sizes of spans (start, end, size) that hold one moment."""
    changes = []
    for start, end, size in spans:
        changes += [(start, 0, size), (end, 1, -size)]
    most = now = 0
    for _, _, change in sorted(changes):
        now += change
        most = max(most, now)
    return most


class _SqliteReader(Sqlite3Reader):
    """Reader of SQLite files that makes no values beyond the limit."""

    def open(self) -> None:
        """Open the file."""
        super().open()
        assert self.dbconn is not None  # noqa: S101 - open, see `Sqlite3Reader`
        self.dbconn.limit(LENGTH_LIMIT, max(min(limit(), 2**31 - 1), LEAST_LENGTH_LIMIT))

    def messages(self, *args: Any, **options: Any) -> Generator[Any, None, None]:
        """Read messages, as `Sqlite3Reader.messages`."""
        try:
            yield from super().messages(*args, **options)
        except Exception as problem:
            # A column that is computed can be far larger than the file.
            if "too big" not in str(problem):
                raise
            raise too_large("a message of the bag", limit()) from None


class _FolderReader(DirectoryReader):
    """Reader of ROS 2 folders that unpacks messages up to the limit."""

    STORAGE_PLUGINS = MappingProxyType({"mcap": _McapReader, "sqlite3": _SqliteReader})
    _packed = False

    def open(self) -> None:
        """Open the folder, and leave the unpacking of its messages to `messages`."""
        _check_metadata(self.path / "metadata.yaml")
        super().open()
        self._packed = self.metadata.compression_mode == "message"
        self.metadata = self.metadata._replace(compression_mode=None)

    def messages(self, *args: Any, **options: Any) -> Generator[Any, None, None]:
        """Read messages, as `rosbag2.Reader.messages`."""
        for connection, time, data in super().messages(*args, **options):
            yield connection, time, inflate_message(data) if self._packed else data


def _check_metadata(path: Any) -> None:
    """Refuse a metadata.yaml that is large, deep, or refers to parts of itself.

    Raises:
        rosbag2.ReaderError: it is so; the files of the folder can still be read one by one.
    """
    size, depth = path.stat().st_size, 0
    if size > LARGEST_METADATA:
        raise rosbag2.ReaderError(f"metadata.yaml has {size} bytes")
    # Errors of the text are reported by the reader.
    with suppress(YAMLError):
        for event in YAML(typ="safe").parse(path.read_text(encoding="utf-8")):
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if isinstance(event, AliasEvent) or depth > DEEPEST_METADATA:
                raise rosbag2.ReaderError("metadata.yaml refers to itself, or is too deep")


class Ros2Reader(rosbag2.Reader):
    """Reader of ROS 2 bags that unpacks within the limits."""

    STORAGE_PLUGINS = MappingProxyType(
        {"dir": _FolderReader, ".mcap": _McapReader, ".db3": _SqliteReader}
    )
