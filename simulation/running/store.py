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
# Most differences that a message lists; those of `UNLISTED` follow from others, or are harmless.
MOST_LISTED = 4
UNLISTED = ("cells:", "axes:", "name:", "configuration.name:", "runs:", "configuration.runs:")
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
    """Store of the blocks of a study; `shape` is (filters, statistics)."""

    def __init__(self, folder: Path, digest: str, shape: tuple[int, int]) -> None:
        self.folder, self._digest, self._shape = folder, digest, shape

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
        if values.ndim != 3 or reasons.ndim != 2:
            return None
        filters, count = self._shape
        values, reasons = values[:, : job.count], reasons[:, : job.count]
        fits = values.shape == (filters, job.count, count) and values.dtype == np.float64
        fits &= reasons.shape == values.shape[:2] and reasons.dtype.kind == "U"
        return (values, reasons) if fits and digest == self._digest else None

    def write(self, job: Job, values: Floats, reasons: Reasons) -> None:
        """Write a block, as from `read`; SimulationError if it cannot be written."""
        path = self.path(job)
        content = BytesIO()
        np.savez(content, values=values, reasons=reasons, digest=np.array(self._digest))
        try:
            write_whole(path, content.getvalue())
        except OSError as problem:
            raise SimulationError(f"{path}: cannot be written: {problem.strerror}") from None


def open_store(
    folder: Path, manifest: dict[str, Any], shape: tuple[int, int], *, overwrite: bool
) -> BlockStore:
    """Open the folder of a study, new or to be continued, and write its manifest.

    `shape` is the number of filters and of statistics; `overwrite` deletes another study.

    Raises:
        SimulationError: the folder has other content, or cannot be written.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # Two commands may begin the same study at once.
        with alone_in(folder.parent):
            other = _read_manifest(folder)
            if overwrite and other is not None and other["digest"] != manifest["digest"]:
                shutil.rmtree(folder / BLOCKS, ignore_errors=True)
                for name in _written_files(other):
                    (folder / name).unlink(missing_ok=True)
                _write_manifest(folder, manifest, [])
            _refuse_others(folder, manifest)
            (folder / BLOCKS).mkdir(parents=True, exist_ok=True)
            _write_manifest(folder, manifest, _written_files(_read_manifest(folder)))
    except OSError as problem:
        raise SimulationError(f"{folder}: cannot be written: {problem.strerror}") from None
    return BlockStore(folder, manifest["digest"], shape)


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


def _refuse_others(folder: Path, manifest: dict[str, Any]) -> None:
    """Raise an error if a folder has other content than this study."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    manifest_there = _read_manifest(folder)
    if manifest_there is None:
        found = "a damaged manifest" if (folder / BLOCKS).is_dir() else "no study of icreckon"
        raise SimulationError(
            f"{folder} is there, and holds {found}; it is left alone, give another --out"
        )
    if manifest_there.get("digest") == manifest["digest"]:
        return
    manifest_there.pop(FILES, None)
    all_changes = differences(manifest_there, json.loads(as_json(manifest)))
    changed = [change for change in all_changes if not change.startswith(UNLISTED)]
    listed = "; ".join(changed[:MOST_LISTED]) or "content of the robot or recording"
    unlisted = f"; and {len(changed) - MOST_LISTED} more" if len(changed) > MOST_LISTED else ""
    raise SimulationError(
        f"{folder} holds another study ({listed}{unlisted}); give another --out, or --overwrite to throw "
        "that away"
    )


def _write_manifest(folder: Path, manifest: dict[str, Any], files: list[str]) -> None:
    write_whole(folder / MANIFEST, as_json(manifest | {FILES: files}).encode())


def _written_files(manifest: dict[str, Any] | None) -> list[str]:
    """Names of the files that a manifest lists; those in other folders are ignored."""
    listed = (manifest or {}).get(FILES)
    names = listed if isinstance(listed, list) else []
    return [name for name in names if isinstance(name, str) and name == Path(name).name]


def _read_manifest(folder: Path) -> dict[str, Any] | None:
    """Manifest of a folder; None if it is missing, unreadable or has no digest."""
    try:
        data = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) and "digest" in data else None
