"""Decompression within limits: a small file cannot fill the memory.

Nothing is unpacked beyond the limit, see `unpacked_limit`.
"""

import bz2
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
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
PIECE, PART = 1 << 16, 1 << 20
"""Bytes that are read, and most bytes that are unpacked at once."""
DECOMPRESSORS: dict[str, Callable[[], Any]] = {
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
    """Set the limit of unpacked sizes in gigabytes (1e9 bytes), 0.5 otherwise.

    It holds for a chunk or a message of a bag, for the files of a bag that are compressed as a whole,
    and for a table.

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


def too_large(what: str, most: int) -> ReplayError:
    """Error of something that unpacks to more than the limit."""
    return ReplayError(
        f"{what} unpacks to more than the limit of {most / GIGABYTE:.3g} GB; --unpacked-limit raises it"
    )


def _parts(pieces: Iterable[bytes], compression: str) -> Iterator[bytes]:
    """Decompress pieces of one or several frames to parts of at most `PART` bytes.

    Raises:
        EOFError: the last frame is cut short; damage raises the other exceptions of `DAMAGE`.
    """
    decompressor, is_whole = DECOMPRESSORS[compression](), True
    for piece in pieces:
        rest = piece
        while rest or not decompressor.needs_input:
            yield decompressor.decompress(rest, max_length=PART)
            rest, is_whole = b"", decompressor.eof
            if is_whole:
                rest = decompressor.unused_data or b""
                decompressor = DECOMPRESSORS[compression]()
    if not is_whole:
        raise EOFError


def _within_limit(data: bytes, compression: str) -> Iterator[bytes]:
    """Decompress a chunk or a message to parts, up to the limit."""
    pieces = (data[start : start + PIECE] for start in range(0, len(data), PIECE))
    size = 0
    for part in _parts(pieces, compression):
        size += len(part)
        if size > limit():
            raise too_large("a part of the bag", limit())
        yield part


def unpack(data: bytes, compression: str) -> bytes:
    """Decompress a chunk or a message of a bag, packed by "zstd", "lz4" or "bz2".

    Raises:
        ReplayError: it unpacks to more than the limit; damage raises one of `DAMAGE`.
    """
    return b"".join(_within_limit(data, compression))


def unpack_beginning(data: bytes, compression: str) -> bytes:
    """Decompress a chunk up to its damage; errors as `unpack`."""
    unpacked = bytearray()
    with suppress(*DAMAGE):
        for part in _within_limit(data, compression):
            unpacked += part
    return bytes(unpacked)


def unpack_file(packed: Path, target: Path, most: int) -> bool:
    """Decompress a file (zstd), up to its break if it is damaged.

    Returns:
        True if all of it was decompressed.

    Raises:
        ReplayError: it unpacks to more than `most`.
        OSError: a file cannot be read or written.
    """
    size = 0
    with packed.open("rb") as source, target.open("wb") as sink:
        try:
            for part in _parts(iter(partial(source.read, PIECE), b""), "zstd"):
                size += len(part)
                if size > most:
                    raise too_large("the bag", most)
                sink.write(part)
        except (zstd.ZstdError, EOFError):
            return False
    return True
