"""Atomic outputs: write beside the target, then move; overwrite only on request."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from icreckon.replay.base.errors import ReplayError


@contextmanager
def written_beside(
    path: Path,
    *,
    overwrite: bool = False,
    marker: str = "metadata.yaml",
    starts: tuple[bytes, ...] | None = None,
) -> Iterator[Path]:
    """Yield a temporary path and move it to `path` if the block succeeds.

    The temporary path has the same name, in a temporary folder beside `path` that is always
    removed. If the block raises, `path` is left unchanged. Missing parent folders are made.

    Args:
        path: target, a file or a folder.
        overwrite: whether an existing output may be replaced.
        marker: file that a folder must hold (or be empty) to be replaced, so that a mistyped path
            cannot delete anything else.
        starts: accepted first bytes of a file that is replaced (an empty file may be, too); None
            for any file.

    Yields:
        The path to write to; nothing is there yet.

    Raises:
        ReplayError: something is there and may not be replaced, or the file system refuses.
    """
    check_replaceable(path, overwrite=overwrite, marker=marker, starts=starts)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as problem:
        raise ReplayError(f"{path}: cannot be written: {problem.strerror}") from None
    try:
        new = scratch / path.name
        yield new
        check_replaceable(path, overwrite=overwrite, marker=marker, starts=starts)
        _move(new, path, scratch / "replaced")
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _move(new: Path, path: Path, aside: Path) -> None:
    try:
        if path.is_dir() or (new.is_dir() and path.exists()):
            path.rename(aside)
            try:
                new.rename(path)
            except OSError:
                aside.rename(path)
                raise
        else:
            new.replace(path)
    except OSError as problem:
        raise ReplayError(f"{path}: cannot be written: {problem.strerror}") from None


def check_replaceable(
    path: Path,
    *,
    overwrite: bool = False,
    marker: str = "metadata.yaml",
    starts: tuple[bytes, ...] | None = None,
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
    if path.is_file() and starts is not None and not _starts_so(path, starts):
        raise ReplayError(
            f"{path} is a file that icreckon did not write; it is not replaced, give another path"
        )


def _starts_so(path: Path, starts: tuple[bytes, ...]) -> bool:
    try:
        with path.open("rb") as file:
            begin = file.read(max(map(len, starts), default=1))
    except OSError as problem:
        raise ReplayError(f"{path}: cannot be read: {problem.strerror}") from None
    return not begin or begin.startswith(starts)
