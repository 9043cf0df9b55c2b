"""Decompression within limits: a small file cannot fill the memory, nor the disk."""

import bz2
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from icreckon.replay.base.errors import ReplayError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

GIGABYTE = 10**9
MOST_IN_MEMORY = 2 * GIGABYTE  # largest chunk or message of a bag, and table, once unpacked [bytes]
PACKED_PIECE, UNPACKED_PIECE = 1 << 16, 1 << 20
"""Bytes that are read, and most bytes that are unpacked, at once."""
DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
}
DAMAGE = (zstd.ZstdError, RuntimeError, OSError, EOFError, ValueError)
"""Exceptions of decompressors on bytes that they cannot read."""


def too_large(subject: str, limit_bytes: int) -> ReplayError:
    """Make the error for a subject ("the table") that unpacks to more."""
    return ReplayError(f"{subject} unpacks to more than {limit_bytes / GIGABYTE:.3g} GB")


def _decompress(
    pieces: Iterable[bytes], compression: str, subject: str, limit_bytes: int
) -> Iterator[bytes]:
    """Decompress frames in sequence, to pieces of at most `UNPACKED_PIECE` bytes.

    Raises:
        ReplayError: the subject ("the bag") unpacks to more than the limit.
        EOFError: the last frame is cut short; damage raises the other exceptions of `DAMAGE`.
    """
    make_decompressor = DECOMPRESSORS[compression]
    decompressor = make_decompressor()
    is_frame_complete = True
    size = 0
    for packed in pieces:
        # A decompressor that needs no input holds more unpacked bytes than one piece may have.
        while packed or not decompressor.needs_input:
            unpacked = decompressor.decompress(packed, max_length=UNPACKED_PIECE)
            size += len(unpacked)
            if size > limit_bytes:
                raise too_large(subject, limit_bytes)
            yield unpacked
            packed = b""
            is_frame_complete = decompressor.eof
            if is_frame_complete:
                # A decompressor reads one frame; the next frame begins in the unused bytes.
                packed = decompressor.unused_data or b""
                decompressor = make_decompressor()
    if not is_frame_complete:
        raise EOFError


def unpack(data: bytes, compression: str, *, up_to_damage: bool = False) -> bytes:
    """Decompress a chunk or a message of a bag, packed by "zstd", "lz4" or "bz2".

    Raises:
        ReplayError: the data unpack to more than the limit. Damaged data raise one of `DAMAGE`, but with
            `up_to_damage` the bytes before the damage are returned.
    """
    packed = (data[start : start + PACKED_PIECE] for start in range(0, len(data), PACKED_PIECE))
    unpacked = bytearray()
    with suppress(*DAMAGE if up_to_damage else ()):
        for piece in _decompress(packed, compression, "a part of the bag", MOST_IN_MEMORY):
            unpacked += piece
    return bytes(unpacked)


def unpack_file(packed: Path, target: Path, limit_bytes: int) -> bool:
    """Decompress a file (zstd) up to its damage; return True if it is undamaged.

    Raises:
        ReplayError: the file unpacks to more than `limit_bytes`.
        OSError: a file cannot be read or written.
    """
    with packed.open("rb") as source, target.open("wb") as sink:
        packed_pieces = iter(partial(source.read, PACKED_PIECE), b"")  # until nothing is read
        try:
            for piece in _decompress(packed_pieces, "zstd", "the bag", limit_bytes):
                sink.write(piece)
        except (zstd.ZstdError, EOFError):
            return False
    return True
