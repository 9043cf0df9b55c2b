"""Store of finished blocks on disk: one file per block, written atomically."""

import json
import shutil
import zipfile
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.files import alone_in, write_whole
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.running.manifest import as_json, differences
from icreckon.simulation.study.cells import Plan

BLOCKS = "blocks"
MANIFEST = "manifest.json"
RESULTS = "results.json"
# Errors of reading a file with any byte changed.
UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile)
FILES = "files"  # key of the manifest with the names of written files, for `--overwrite`
# Most differences that a message lists; differences in `UNLISTED` follow from others or are harmless.
MOST_LISTED = 4
UNLISTED = ("cells:", "axes:", "remarks:", "name:", "runs:")
Reasons = NDArray[np.str_]  # of failed runs, by filter and run; empty for the others


@dataclass(frozen=True)
class Job:
    """Block: runs `first_run` to `first_run + count - 1` of a cell, by all filters."""

    cell: int
    first_run: int
    count: int


def jobs_of(plan: Plan, block_runs: int) -> list[Job]:
    """All blocks of a study; cells that share true motions are consecutive."""
    runs = plan.study.runs
    return [
        Job(cell.index, first, min(block_runs, runs - first))
        for first in range(0, runs, block_runs)
        for cell in plan.cells
    ]


class BlockStore:
    """Store of the blocks of a study; blocks of another digest do not count."""

    def __init__(self, folder: Path, digest: str) -> None:
        self.folder, self._digest = folder, digest

    def path(self, job: Job) -> Path:
        """File of a block."""
        return self.folder / BLOCKS / f"{job.cell:05d}-{job.first_run:07d}.npz"

    def read(self, job: Job) -> tuple[Floats, Reasons] | None:
        """Read a block: statistics (filters, runs, statistics), reasons (filters, runs).

        Of a file with more runs it reads the first. Returns None if the file is missing, cut short,
        damaged, or of another study.
        """
        try:
            with self.path(job).open("rb") as file, np.load(file, allow_pickle=False) as data:
                values, digest = np.array(data["values"]), str(data["digest"])
                reasons = np.array(data["reasons"])
        except UNREADABLE:
            return None
        if digest != self._digest or values.ndim != 3 or values.shape[1] < job.count:
            return None
        return values[:, : job.count], reasons[:, : job.count]

    def write(self, job: Job, values: Floats, reasons: Reasons) -> None:
        """Write a block, as from `read`; SimulationError if it cannot be written."""
        path = self.path(job)
        content = BytesIO()
        np.savez(content, values=values, reasons=reasons, digest=np.array(self._digest))
        try:
            write_whole(path, content.getvalue())
        except OSError as problem:
            raise SimulationError(f"{path}: cannot be written: {problem.strerror}") from None


def open_store(folder: Path, manifest: dict[str, Any], *, overwrite: bool) -> BlockStore:
    """Open the folder of a study, new or to be continued, and write its manifest.

    `overwrite` deletes another study.

    Raises:
        SimulationError: the folder has other content, or cannot be written.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # Two commands may begin the same study at once.
        with alone_in(folder.parent):
            old = _read_manifest(folder)
            files = _written_files(old)
            if overwrite and old is not None and old["digest"] != manifest["digest"]:
                shutil.rmtree(folder / BLOCKS, ignore_errors=True)
                for name in files:
                    (folder / name).unlink(missing_ok=True)
                files = []
            else:
                _refuse_others(folder, old, manifest)
            (folder / BLOCKS).mkdir(parents=True, exist_ok=True)
            _write_manifest(folder, manifest, files)
    except OSError as problem:
        raise SimulationError(f"{folder}: cannot be written: {problem.strerror}") from None
    return BlockStore(folder, manifest["digest"])


def write_files(folder: Path, files: dict[str, bytes]) -> None:
    """Write files (name -> content) to the folder of a study, each atomically.

    The manifest lists them, so that `--overwrite` deletes these files alone. SimulationError if the
    folder cannot be written.
    """
    manifest = _read_manifest(folder) or {}
    try:
        _write_manifest(folder, manifest, sorted({*_written_files(manifest), *files}))
        for name, content in files.items():
            write_whole(folder / name, content)
    except OSError as problem:
        raise SimulationError(f"{folder}: cannot be written: {problem.strerror}") from None


def _refuse_others(folder: Path, old: dict[str, Any] | None, manifest: dict[str, Any]) -> None:
    """Raise an error if a folder, with its old manifest, holds another study or files."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if old is None:
        old_content = "a damaged manifest" if (folder / BLOCKS).is_dir() else "no study of icreckon"
        raise SimulationError(
            f"{folder} is there, and holds {old_content}; it is left alone, give another --out"
        )
    if old["digest"] == manifest["digest"]:
        return
    old.pop(FILES, None)
    found = differences(old, json.loads(as_json(manifest)))
    changed = [one for one in found if not one.removeprefix("configuration.").startswith(UNLISTED)]
    listed = "; ".join(changed[:MOST_LISTED]) or "content of the recording"
    unlisted = f"; and {len(changed) - MOST_LISTED} more" if len(changed) > MOST_LISTED else ""
    raise SimulationError(
        f"{folder} holds another study ({listed}{unlisted}); give another --out, or --overwrite to throw "
        "that away"
    )


def _write_manifest(folder: Path, manifest: dict[str, Any], files: list[str]) -> None:
    write_whole(folder / MANIFEST, as_json(manifest | {FILES: files}).encode())


def _written_files(manifest: dict[str, Any] | None) -> list[str]:
    """Names of the files that a manifest lists; those in other folders are ignored."""
    names = (manifest or {}).get(FILES, [])
    return [name for name in names if name == Path(str(name)).name]


def _read_manifest(folder: Path) -> dict[str, Any] | None:
    """Manifest of a folder; None if it is missing, unreadable or has no digest."""
    try:
        data = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) and "digest" in data else None
