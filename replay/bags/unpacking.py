"""Decompression within limits: a small file cannot fill the memory.

A chunk is unpacked up to the size that it declares, and that size has a limit, see `unpacked_limit`.
"""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from types import MappingProxyType
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags import rosbag1, rosbag2
from rosbags.rosbag1.reader import Chunk, Header, RecordType
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from icreckon.replay.base.errors import ReplayError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

GIGABYTE = 10**9
PIECE = 1 << 16
PART = 1 << 20
"""Most bytes that are unpacked at once."""
STREAM_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
}
DAMAGE = (zstd.ZstdError, RuntimeError, OSError, EOFError, ValueError)
"""Exceptions of decompressors on bytes that they cannot read."""
_limit: ContextVar[int] = ContextVar("_limit", default=500_000_000)
"""Limit of the unpacked size of a chunk or a message [bytes]."""


@contextmanager
def unpacked_limit(gigabytes: float) -> Iterator[None]:
    """Set the limit of the unpacked size of a chunk or a message, 0.5 GB otherwise.

    Args:
        gigabytes: the limit, in 1e9 bytes.
    """
    token = _limit.set(round(gigabytes * GIGABYTE))
    try:
        yield
    finally:
        _limit.reset(token)


def inflate(data: bytes, compression: str, size: int) -> bytes:
    """Decompress the readable beginning of a chunk.

    Args:
        data: the compressed bytes, possibly cut short.
        compression: "zstd", "lz4" or "bz2".
        size: size that the chunk declares [bytes].

    Returns:
        The decompressed bytes up to the break; one more than `size` if there are more.

    Raises:
        ReplayError: `size` is beyond the limit.
    """
    if size > _limit.get():
        raise _too_large(size)
    unpacked = bytearray()
    try:
        while data and len(unpacked) <= size:
            data = _inflate_frame(data, STREAM_DECOMPRESSORS[compression](), size, unpacked)
    except DAMAGE:
        pass
    return bytes(unpacked)


def _inflate_frame(data: bytes, decompressor: Any, size: int, unpacked: bytearray) -> bytes:
    """Append a frame, to one byte more than `size` at most; return what follows it."""
    for start in range(0, len(data), PIECE):
        piece = data[start : start + PIECE]
        while len(unpacked) <= size:
            unpacked += decompressor.decompress(
                piece, max_length=min(PART, size + 1 - len(unpacked))
            )
            piece = b""
            if decompressor.eof:
                return bytes(decompressor.unused_data or b"") + data[start + PIECE :]
            if decompressor.needs_input:
                break
    return b""


def _too_large(size: int) -> ReplayError:
    return ReplayError(
        f"a part of the bag unpacks to {size / GIGABYTE:.3g} GB, and the limit is "
        f"{_limit.get() / GIGABYTE:.3g} GB, so that no small file can fill the memory; "
        "--unpacked-limit raises it"
    )


def _chunk(data: bytes, size: int, *, compression: str) -> bytes:
    return inflate(data, compression, size)


# The table by which rosbags unpacks the chunks of MCAP files; it checks the sizes afterwards.
DECOMPRESSORS.update({name: partial(_chunk, compression=name) for name in ("zstd", "lz4")})


class Ros1Reader(rosbag1.Reader):
    """Reader of ROS 1 bags that unpacks chunks up to the size that they declare."""

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


class _FolderReader(DirectoryReader):
    """Reader of ROS 2 folders that unpacks messages up to the limit."""

    _packed = False

    def open(self) -> None:
        """Open the folder, and leave the unpacking of its messages to `messages`."""
        super().open()
        self._packed = self.metadata.compression_mode == "message"
        self.metadata = self.metadata._replace(compression_mode=None)

    def messages(self, *args: Any, **options: Any) -> Generator[Any, None, None]:
        """Read messages, as `rosbag2.Reader.messages`."""
        for connection, time, data in super().messages(*args, **options):
            yield connection, time, _message(data) if self._packed else data


class Ros2Reader(rosbag2.Reader):
    """Reader of ROS 2 bags that unpacks within the limits."""

    STORAGE_PLUGINS = MappingProxyType({**rosbag2.Reader.STORAGE_PLUGINS, "dir": _FolderReader})


def _message(data: bytes) -> bytes:
    """Unpack a message of a bag with compressed messages."""
    limit = _limit.get()
    declared = zstd.get_frame_info(data).decompressed_size
    unpacked = inflate(data, "zstd", limit if declared is None else declared)
    if len(unpacked) > limit:
        raise _too_large(len(unpacked))
    return unpacked
