"""Atomic writes: a reader sees the whole file or none."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

# Suffix of files that are not in their place yet.
TEMPORARY = ".tmp"


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place, and move it there.

    Raises:
        OSError: the file cannot be written; nothing is left beside its place.
    """
    beside = path.with_name(f"{path.name}.{uuid4().hex}{TEMPORARY}")
    try:
        with beside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise
