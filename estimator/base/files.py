"""Files: written whole or not at all, and locked while their process lives.

A lock shows that a process is still writing. On systems without locks, and on file systems that refuse
them, nothing is known.
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
    """Write a file next to its place, and move it there; an OSError leaves nothing.

    The file gets the mode of the old file. The target of a symbolic link is replaced, not the link.
    """
    path = Path(os.path.realpath(path))
    temporary = path.with_name(f"{path.name}.{uuid4().hex}.tmp")
    try:
        with temporary.open("wb") as file:
            if path.exists():
                shutil.copymode(path, temporary)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


@contextmanager
def owned(mark: Path) -> Iterator[None]:
    """Create a file and lock it while the block runs; it gets its name once locked."""
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
    """Lock a folder while the block runs: other processes wait at such a block."""
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
