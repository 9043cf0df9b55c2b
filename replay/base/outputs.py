"""Atomic outputs: write next to the target, then move; overwrite only on request."""

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from icreckon.estimator.base.files import alone_in, is_held, owned
from icreckon.replay.base.errors import ReplayError, os_errors

# List of the files of a result folder, in it: others that are there were put there by a person.
MANIFEST = ".icreckon-files"
# Suffixes of files next to the new output in its temporary folder: the lock, and what it replaces.
OWNER, REPLACED = ".owner", ".replaced"
MARKED = 2**20  # length of the ends of a file that are searched for a mark [bytes]
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)  # errors of a full file system


@contextmanager
def written_beside(
    path: Path,
    *,
    overwrite: bool = False,
    marker: str = "metadata.yaml",
    starts: tuple[bytes, ...] | None = None,
    mark: bytes = b"",
    keeps_foreign: bool = False,
) -> Iterator[Path]:
    """Yield a temporary path and move it to `path` if the block succeeds.

    The temporary path has the same name, in a temporary folder next to `path` that is always
    removed; if the process is killed, by the next one that writes to `path`. If the block raises, `path`
    is left unchanged. Missing parent folders are made, and nothing is at the path to write to.

    Args:
        path: target, a file or a folder.
        overwrite: whether an existing output may be replaced.
        marker: file that a folder must hold (or be empty) to be replaced, so that a mistyped path
            cannot delete anything else.
        starts: accepted first bytes of a file that is replaced (an empty file may be, too); None
            for any file.
        mark: bytes in the first or last `MARKED` of a file that is replaced, and of a folder's `marker`.
        keeps_foreign: whether a folder gets a list of its files, and files that a person has put into
            the one before it are kept.

    Raises:
        ReplayError: something is there and may not be replaced, another process writes to `path`, or
            the file system refuses.
    """
    check_replaceable(path, overwrite=overwrite, marker=marker, starts=starts, mark=mark)
    with ExitStack() as held:
        with os_errors(path, "cannot be written"):
            path.parent.mkdir(parents=True, exist_ok=True)
            with alone_in(path.parent):
                if is_being_written(path):
                    raise ReplayError(
                        f"{path} is being written by another process; wait, or give another path"
                    )
                _remove_abandoned(path)
                scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
                held.callback(shutil.rmtree, scratch, ignore_errors=True)
                held.enter_context(owned(scratch / f"{path.name}{OWNER}"))
        new = scratch / path.name
        with _named(new, path):
            yield new
            check_replaceable(path, overwrite=overwrite, marker=marker, starts=starts, mark=mark)
            if keeps_foreign:
                _copy_foreign(path, new)
            _move(new, path, scratch / f"{path.name}{REPLACED}")


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path, as `written_beside`, to a block that only writes.

    Raises:
        ReplayError: `path` exists, or cannot be written.
    """
    with written_beside(path) as new, os_errors(path, "cannot be written"):
        yield new


def write_text(path: Path, text: str) -> Path:
    """Write a text as a new file; errors as `new_file`."""
    with new_file(path) as new:
        new.write_text(text, encoding="utf-8")
    return path


@contextmanager
def _named(new: Path, path: Path) -> Iterator[None]:
    """Report errors of the temporary path as those of the target."""
    try:
        yield
    except ReplayError as problem:
        # The temporary place means nothing to a reader.
        raise ReplayError(str(problem).replace(str(new), str(path))) from problem
    except OSError as problem:
        if problem.errno not in NO_ROOM and new.parent.exists():
            raise
        raise ReplayError(f"{path}: cannot be written: {problem.strerror}") from problem


def is_being_written(path: Path) -> bool:
    """Return True if a process that still runs writes an output to a path."""
    return any(is_held(scratch / f"{path.name}{OWNER}") for scratch in _scratches(path))


def _scratches(path: Path) -> list[Path]:
    """Temporary folders of an output at a path."""
    name = re.compile(rf"\.{re.escape(path.name)}\.[a-z0-9_]{{8}}")
    try:
        return [place for place in path.parent.iterdir() if name.fullmatch(place.name)]
    except OSError:
        return []


def _remove_abandoned(path: Path) -> None:
    """Remove temporary folders whose process was killed; put back what it moved."""
    for scratch in _scratches(path):
        if is_held(scratch / f"{path.name}{OWNER}") is not False:
            continue
        aside = scratch / f"{path.name}{REPLACED}"
        if aside.exists() and not path.exists():
            aside.rename(path)
        shutil.rmtree(scratch, ignore_errors=True)


def _files(folder: Path) -> set[str]:
    """Paths of the files in a folder, relative to it."""
    places = (place for place in folder.rglob("*") if place.is_symlink() or not place.is_dir())
    return {place.relative_to(folder).as_posix() for place in places}


def _copy_foreign(former: Path, new: Path) -> None:
    """List the files of a new folder; copy to it what a person put into the former.

    A file whose name is taken gets the suffix ".kept". A former folder without a list has no such files.
    """
    (new / MANIFEST).write_text("\n".join(sorted(_files(new))) + "\n", encoding="utf-8")
    if not (former / MANIFEST).is_file():
        return
    own = set((former / MANIFEST).read_text(encoding="utf-8").splitlines()) | {MANIFEST}
    for name in sorted(_files(former) - own):
        target = new / name
        while target.exists():
            target = target.with_name(f"{target.name}.kept")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(former / name, target, follow_symlinks=False)


def _move(new: Path, path: Path, aside: Path) -> None:
    with os_errors(path, "cannot be written"):
        if path.is_dir() or (new.is_dir() and path.exists()):
            path.rename(aside)
            try:
                new.rename(path)
            except OSError:
                aside.rename(path)
                raise
        else:
            new.replace(path)


def check_replaceable(
    path: Path,
    *,
    overwrite: bool = False,
    marker: str = "metadata.yaml",
    starts: tuple[bytes, ...] | None = None,
    mark: bytes = b"",
) -> None:
    """Refuse to replace a foreign output; arguments and errors as `written_beside`."""
    if not path.exists():
        return
    if not overwrite:
        raise ReplayError(f"{path} exists already; give --overwrite to replace it")
    if path.is_dir() and any(path.iterdir()) and not (path / marker).is_file():
        raise ReplayError(
            f"{path} is a folder without {marker}, so not one that icreckon wrote; "
            "it is not replaced, give another path"
        )
    own = path / marker if path.is_dir() else path
    begin, end = _ends(own) if own.is_file() else (b"", b"")
    starts_otherwise = path.is_file() and starts is not None and not begin.startswith(starts)
    if begin and (starts_otherwise or not (mark in begin or mark in end)):
        kind = "folder" if path.is_dir() else "file"
        raise ReplayError(
            f"{path} is a {kind} that icreckon did not write; it is not replaced, give another path"
        )


def _ends(path: Path) -> tuple[bytes, bytes]:
    """First and last `MARKED` bytes of a file."""
    with os_errors(path, "cannot be read"), path.open("rb") as file:
        begin = file.read(MARKED)
        file.seek(max(0, file.seek(0, os.SEEK_END) - MARKED))
        end = file.read()
    return begin, end
