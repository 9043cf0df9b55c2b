"""Decompression within limits: a small file cannot fill the memory.

Nothing is unpacked beyond the size that it declares, nor beyond the limit, see `unpacked_limit`.
"""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from icreckon.estimator.base.checks import is_finite
from icreckon.replay.base.errors import ReplayError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

GIGABYTE = 10**9
LARGEST_LIMIT = 1e6
"""Largest limit [GB]."""
PIECE = 1 << 16
PART = 1 << 20
"""Most bytes that are unpacked at once."""
MOST_FRAMES = 1000
"""Most frames of a chunk, one after the other; recorders write one."""
STREAM_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
}
DAMAGE = (zstd.ZstdError, RuntimeError, OSError, EOFError, ValueError)
"""Exceptions of decompressors on bytes that they cannot read."""
_limit: ContextVar[int] = ContextVar("_limit", default=500_000_000)
"""Limit of the unpacked size of a chunk, a message, a table or a bag's files [bytes]."""


@contextmanager
def unpacked_limit(gigabytes: float) -> Iterator[None]:
    """Set the limit of unpacked sizes, 0.5 GB otherwise.

    It holds for a chunk or a message of a bag, for the files of a bag that are compressed as a whole,
    and for a table.

    Args:
        gigabytes: the limit, in 1e9 bytes.

    Raises:
        ReplayError: the limit is negative, larger than 1e6, or no finite number.
    """
    if not (is_finite(gigabytes) and 0.0 <= gigabytes <= LARGEST_LIMIT):
        raise ReplayError(
            f"the limit of unpacked sizes must be from 0 to {LARGEST_LIMIT:g} GB, found {gigabytes!r}"
        )
    token = _limit.set(round(gigabytes * GIGABYTE))
    try:
        yield
    finally:
        _limit.reset(token)


def limit() -> int:
    """Limit of unpacked sizes [bytes], see `unpacked_limit`."""
    return _limit.get()


def too_large(what: str, size: int, most: int | None = None) -> ReplayError:
    """Error of something that unpacks to more than the limit.

    Args:
        what: what it is, such as "a part of the bag".
        size: unpacked size, or the least that it can be [bytes].
        most: the limit [bytes]; that of this thread by default.
    """
    most = limit() if most is None else most
    return ReplayError(
        f"{what} unpacks to {size / GIGABYTE:.3g} GB, and the limit is {most / GIGABYTE:.3g} GB, "
        "so that no small file can fill the memory; --unpacked-limit raises it"
    )


def inflate(data: bytes, compression: str, size: int) -> bytes:
    """Decompress the readable beginning of a chunk.

    Args:
        data: the compressed bytes, possibly cut short.
        compression: "zstd", "lz4" or "bz2".
        size: size that the chunk declares [bytes].

    Returns:
        The decompressed bytes up to the break; one more than `size` if there are more.

    Raises:
        ReplayError: the chunk declares more than the limit, and there is more.
    """
    most = min(size, limit())
    unpacked = bytearray()
    at = 0
    try:
        for _ in range(MOST_FRAMES):
            if at == len(data) or len(unpacked) > most:
                break
            at = _inflate_frame(data, at, STREAM_DECOMPRESSORS[compression](), most, unpacked)
    except DAMAGE:
        pass
    if most < size and len(unpacked) > most:
        raise too_large("a part of the bag", size)
    return bytes(unpacked)


def _inflate_frame(data: bytes, at: int, decompressor: Any, most: int, unpacked: bytearray) -> int:
    """Append a frame, to one byte more than `most` in all; return the place behind it."""
    for start in range(at, len(data), PIECE):
        piece = data[start : start + PIECE]
        end = start + len(piece)
        while len(unpacked) <= most:
            unpacked += decompressor.decompress(
                piece, max_length=min(PART, most + 1 - len(unpacked))
            )
            piece = b""
            if decompressor.eof:
                return end - len(decompressor.unused_data or b"")
            if decompressor.needs_input:
                break
    return len(data)


def inflate_message(data: bytes) -> bytes:
    """Decompress a message of a bag with compressed messages (zstd).

    Raises:
        ReplayError: it unpacks to more than the limit.
    """
    declared = zstd.get_frame_info(data).decompressed_size
    unpacked = inflate(data, "zstd", limit() if declared is None else declared)
    if len(unpacked) > limit():
        raise too_large("a part of the bag", len(unpacked))
    return unpacked


def unpack_file(packed: Path, target: Path, most: int) -> bool:
    """Decompress a file (zstd), up to its break if it is damaged.

    Args:
        packed: the compressed file.
        target: the file to write.
        most: most bytes to write.

    Returns:
        True if all of it was decompressed.

    Raises:
        ReplayError: it unpacks to more than `most`.
        OSError: a file cannot be read or written.
    """
    decompressor, piece, size = zstd.ZstdDecompressor(), b"", 0
    with packed.open("rb") as source, target.open("wb") as sink:
        while True:
            if decompressor.eof:
                piece = decompressor.unused_data or source.read(PIECE)
                if not piece:
                    return True
                decompressor = zstd.ZstdDecompressor()
            elif decompressor.needs_input:
                piece = source.read(PIECE)
                if not piece:
                    return False
            try:
                part = decompressor.decompress(piece, max_length=PART)
            except zstd.ZstdError:
                return False
            piece = b""
            size += len(part)
            if size > most:
                raise too_large("the bag", size)
            sink.write(part)
