"""Locks on files that a process holds until it ends, however it ends.

They show whether what a process was writing is still being written. On systems without such locks, and on
file systems that refuse them, nothing is known.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

if sys.platform != "win32":
    import fcntl


@contextmanager
def owned(mark: Path) -> Iterator[None]:
    """Hold a file while the block runs; it has its name only once it is held."""
    if sys.platform == "win32":
        yield
        return
    unheld = mark.with_name(f"{mark.name}-")
    with unheld.open("wb") as file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        unheld.rename(mark)
        yield


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other processes out of such blocks for the same folder."""
    if sys.platform == "win32":
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def is_held(path: Path) -> bool | None:
    """Return whether a process holds the lock of a file; None if unknown."""
    if sys.platform == "win32":
        return None
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return None
    return False
