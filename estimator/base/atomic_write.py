"""Atomic writes: a reader sees the whole file or none."""

from __future__ import annotations

import os
import re
import shutil
import time
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from icreckon.estimator.base.owned_files import hold, is_held

# Suffix of files that are not in their place yet.
TEMPORARY = ".tmp"
OWN_NAME = re.compile(rf".+\.[0-9a-f]{{32}}\{TEMPORARY}")
# Age from which such a file that no process holds is abandoned [s]: it is not held for a moment after its
# name is there, and before it is moved.
ABANDONED = 60.0


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place, and move it there.

    It has the mode of the file that it replaces. A symbolic link stays: what it points to is replaced.

    Raises:
        OSError: the file cannot be written; nothing is left beside its place.
    """
    path = Path(os.path.realpath(path))
    beside = path.with_name(f"{path.name}.{uuid4().hex}{TEMPORARY}")
    try:
        with beside.open("wb") as file:
            hold(file)
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


def remove_abandoned(folder: Path) -> None:
    """Remove files that `write_whole` left in a folder when its process was killed."""
    for path in folder.glob(f"*{TEMPORARY}"):
        with suppress(OSError):
            old = time.time() - path.stat().st_mtime > ABANDONED
            if old and OWN_NAME.fullmatch(path.name) and is_held(path) is False:
                path.unlink()
