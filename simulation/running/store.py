"""The blocks of a study on disk: each finished one is a file, whole or not there."""

from __future__ import annotations

import json
import os
import shutil
import time
import zipfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.running.manifest import as_json, differences
from icreckon.simulation.study.cells import Plan

BLOCKS = "blocks"
MANIFEST = "manifest.json"
RESULTS = "results.json"
TEMPORARY = ".tmp"
# A file that has been half written for longer is nobody's [s].
ABANDONED = 3600.0
# What comes of reading a file with any byte changed.
UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile)
# Differences that a refusal names; those of these keys follow from others, or do no harm.
TOLD = 4
UNTOLD = ("cells:", "axes:", "name:", "configuration.name:", "runs:", "configuration.runs:")


# Why runs failed, by filter and run; empty for runs that did not.
Reasons = NDArray[np.str_]


@dataclass(frozen=True)
class Job:
    """A block: runs `first_run` to `first_run + count - 1` of a cell, by all filters."""

    cell: int
    first_run: int
    count: int


def jobs_of(plan: Plan, block_runs: int) -> list[Job]:
    """All blocks of a study; cells that share true motions come one after the other."""
    runs = plan.study.runs
    return [
        Job(cell.index, first, min(block_runs, runs - first))
        for first in range(0, runs, block_runs)
        for cell in plan.cells
    ]


class BlockStore:
    """The folder of a study.

    Args:
        folder: where it is.
        digest: of the study.
        shape: number of filters and of statistics.
    """

    def __init__(self, folder: Path, digest: str, shape: tuple[int, int]) -> None:
        self.folder = folder
        self._digest = digest
        self._shape = shape

    def path(self, job: Job) -> Path:
        """The file of a block."""
        return self.folder / BLOCKS / f"{job.cell:05d}-{job.first_run:07d}.npz"

    def read(self, job: Job) -> tuple[Floats, Reasons] | None:
        """Statistics (filters, runs, statistics) and reasons (filters, runs) of a block, if it is there.

        What is cut short, damaged, or of another study does not count.
        """
        try:
            with self.path(job).open("rb") as file, np.load(file, allow_pickle=False) as data:
                values, digest = np.array(data["values"]), str(data["digest"])
                reasons = np.array(data["reasons"])
        except UNREADABLE:
            return None
        filters, count = self._shape
        right = values.shape == (filters, job.count, count) and values.dtype == np.float64
        right &= reasons.shape == values.shape[:2] and reasons.dtype.kind == "U"
        return (values, reasons) if right and digest == self._digest else None

    def write(self, job: Job, values: Floats, reasons: Reasons) -> None:
        """Keep a finished block, even if the power fails in the next moment.

        Args:
            job: the block.
            values: (filters, runs, statistics).
            reasons: (filters, runs) why runs failed.

        Raises:
            SimulationError: the file system refuses.
        """
        path = self.path(job)
        beside = path.with_name(f"{path.name}.{uuid4().hex}{TEMPORARY}")
        try:
            with beside.open("wb") as file:
                digest = np.array(self._digest)
                np.savez(file, values=values, reasons=reasons, digest=digest)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
            _sync_folder(path.parent)
        except OSError as problem:
            raise SimulationError(f"{path}: cannot be written: {problem.strerror}") from None

    def tidy(self) -> None:
        """Take away what interrupted runs left half written, but nothing that is being written now."""
        for path in (self.folder / BLOCKS).glob(f"*{TEMPORARY}"):
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > ABANDONED:
                    path.unlink()


def open_store(
    folder: Path, manifest: dict[str, Any], shape: tuple[int, int], *, overwrite: bool
) -> BlockStore:
    """The folder of a study, new or to be gone on with, its manifest written.

    Args:
        folder: where it shall be.
        manifest: of the study.
        shape: number of filters and of statistics.
        overwrite: whether another study there may be thrown away.

    Raises:
        SimulationError: there is something else, or the file system refuses.
    """
    try:
        if overwrite:
            _throw_away_others(folder, manifest)
        _refuse_others(folder, manifest)
        (folder / BLOCKS).mkdir(parents=True, exist_ok=True)
        write_whole(folder / MANIFEST, as_json(manifest).encode())
    except OSError as problem:
        raise SimulationError(f"{folder}: cannot be written: {problem.strerror}") from None
    return BlockStore(folder, manifest["digest"], shape)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place, and move it there."""
    beside = path.with_name(f"{path.name}.{uuid4().hex}{TEMPORARY}")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


def write_files(folder: Path, files: dict[str, bytes]) -> None:
    """Write files (name -> content) to a folder, each whole.

    Raises:
        SimulationError: the folder cannot be written.
    """
    try:
        for name, content in files.items():
            write_whole(folder / name, content)
    except OSError as problem:
        raise SimulationError(f"{folder}: cannot be written: {problem.strerror}") from None


def _refuse_others(folder: Path, manifest: dict[str, Any]) -> None:
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    found = _read_manifest(folder)
    if found is None:
        raise SimulationError(
            f"{folder} is there, and holds no study of icreckon; it is left alone, give another --out"
        )
    if found.get("digest") == manifest["digest"]:
        return
    told = differences(found, json.loads(as_json(manifest)))
    told = [one for one in told if not one.startswith(UNTOLD)]
    listed = "; ".join(told[:TOLD]) or "content of the robot or recording"
    more = f"; and {len(told) - TOLD} more" if len(told) > TOLD else ""
    raise SimulationError(
        f"{folder} holds another study ({listed}{more}); give another --out, or --overwrite to throw "
        "that away"
    )


def _throw_away_others(folder: Path, manifest: dict[str, Any]) -> None:
    """Remove what is there of another study, and nothing else."""
    found = _read_manifest(folder)
    if found is None or found["digest"] == manifest["digest"]:
        return
    shutil.rmtree(folder / BLOCKS, ignore_errors=True)
    for path in folder.iterdir():
        if path.suffix in {".parquet", ".json", ".png", ".html"} and path.is_file():
            path.unlink()


def _read_manifest(folder: Path) -> dict[str, Any] | None:
    try:
        found = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and "digest" in found else None


def _sync_folder(folder: Path) -> None:
    """Make a new name in a folder last; not every system can."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)
