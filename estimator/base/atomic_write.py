"""Atomic writes: a reader sees the whole file or none."""

import os
import shutil
from contextlib import suppress
from pathlib import Path
from uuid import uuid4


def write_whole(path: Path, content: bytes) -> None:
    """Write a file next to its place, and move it there.

    It has the mode of the file that it replaces. A symbolic link stays: what it points to is replaced.

    Raises:
        OSError: the file cannot be written; nothing is left next to its place.
    """
    path = Path(os.path.realpath(path))
    beside = path.with_name(f"{path.name}.{uuid4().hex}.tmp")
    try:
        with beside.open("wb") as file:
            if path.exists():
                shutil.copymode(path, beside)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise
