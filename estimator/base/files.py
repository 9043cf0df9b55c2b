"""Files: written whole or not at all, and locked while their process lives.

Locks show whether what a process was writing is still being written. On systems without them, and on file
systems that refuse them, nothing is known.
"""

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

if sys.platform != "win32":
    import fcntl


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
