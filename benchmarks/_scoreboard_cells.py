"""Cells of the scoreboard: jobs over processes, results kept in a cache so that a run can go on."""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from _digests import ESTIMATES, FILTER, ROOT, WITH_FAULTS, WITHOUT_FAULTS, digest
from _study import PROGRESS_EVERY

from icreckon.estimator.base.array_types import Floats

SEED = 77_013
"""Of all simulated runs of the scoreboard; no tuning and no other study uses it."""
VARIANTS = ("gyro", "constant-online", "inertia-online")
FLAGS = {
    "spins": "spinning",
    "slides": "sliding",
    "carries": "carried",
    "gyro faults": "failing",
    "odd wheels": "wheel off",
    "scatter": "scattering",
    "stuck tracks": "stuck",
}
"""Faults of `Health.times` that the scoreboard counts, by their names there."""
GATE = "gate"
# Rejections of a measurement for what it holds or for its stamp, which no rule for faults decides.
OF_MESSAGES = (
    "stamp",
    "finite",
    "older",
    "full",
    "absurd",
    "variance",
    "far ahead",
    "not a",
    "before",
)
RULES: dict[str, tuple[str, Callable[..., Any]]] = {
    "gyro repeats": ("failed_gyro.is_frozen", lambda *_: False),
    "gyro jumps": ("failed_gyro.least_jump", lambda *_: math.inf),
    "fixes repeat": ("repeating_fixes.most_driven", lambda *_: math.inf),
    "track spins": ("spinning_tracks.least_mismatch", lambda *_: math.inf),
    "track sticks": ("stuck_tracks.may_stick", lambda *_: False),
}
"""Rules that `--without` disables: function of `estimator/faults`, and what it gives then."""


class Job(NamedTuple):
    """One run of a cell.

    Attributes:
        part: "healthy", "faults" or "real".
        cell: name of the cell, unique in its part.
        run: index of the run within the cell.
        variants: filter variants.
        without: rules that are disabled, see `RULES`.
    """

    part: str
    cell: str
    run: int
    variants: tuple[str, ...] = VARIANTS
    without: tuple[str, ...] = ()


@contextmanager
def rules_disabled(names: Sequence[str]) -> Iterator[None]:
    """Disable rules for faults in this process; one that the estimator lacks is an error."""
    with ExitStack() as stack:
        for name in names:
            target, replacement = RULES[name]
            stack.enter_context(patch(f"icreckon.estimator.faults.{target}", replacement))
        yield


def flags(health: Any) -> dict[str, float]:
    """Counts that indicate a fault, by name."""
    found = {name: float(health.times.get(fault, 0)) for name, fault in FLAGS.items()}
    return found | {"wrong tilt": float(health.tilt is not None and health.tilt.is_wrong)}


def excluded(health: Any) -> tuple[dict[str, int], dict[str, int]]:
    """Measurements that rules, and that gates, rejected: number by "sensor: reason", and by sensor."""
    rules: dict[str, int] = {}
    gates: dict[str, int] = {}
    for name, count in health.rejections().items():
        sensor, _, reason = name.partition(": ")
        if reason == GATE:
            gates[sensor] = count
        elif not any(word in reason for word in OF_MESSAGES):
            rules[name] = count
    return rules, gates


class Cache:
    """Results of finished jobs, one JSON line each, in a file beside the result."""

    def __init__(self, path: Path, part: str) -> None:
        self.path, self.known = path, dict[str, Any]()
        self.digest = digest(*FILTER, "replay", *depends_on(part))
        if path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                # A run that was interrupted while it wrote leaves half a line.
                try:
                    key, value = json.loads(line)
                except ValueError:
                    continue
                self.known[key] = value

    def key(self, job: Job) -> str:
        """Key of a job: its description and the digest of the sources."""
        text = json.dumps([self.digest, *job])
        return hashlib.sha256(text.encode()).hexdigest()[:24]

    def add(self, job: Job, value: Any) -> None:
        """Keep the result of a job."""
        key = self.key(job)
        self.known[key] = value
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps([key, value]) + "\n")


def data_folder() -> str:
    """Folder of the sample logs, empty if there is none."""
    folder = os.environ.get("ICRECKON_DATA", str(ROOT.parent / "shared" / "data"))
    return folder if Path(folder).is_dir() else ""


def depends_on(part: str) -> tuple[str, ...]:
    """Sources that the figures of a part depend on."""
    own = ("benchmarks/_scoreboard_cells.py", "benchmarks/_scoreboard_drives.py")
    if part == "healthy":
        return (WITHOUT_FAULTS, *own)
    if part == "faults":
        put = "benchmarks/_scoreboard_put.py"
        return (WITH_FAULTS, *own, put, "benchmarks/_scoreboard_faults.py")
    if part == "cost":
        return (ESTIMATES, "benchmarks/_scoreboard_cost.py")
    return (WITHOUT_FAULTS, *own, "benchmarks/_scoreboard_real.py", "benchmarks/accuracy.py")


def work_off(
    jobs: Sequence[Job], score: Callable[[Job], Any], cache: Cache, workers: int | None
) -> dict[Job, Any]:
    """Results of all jobs; those that the cache lacks are worked off over processes.

    Args:
        jobs: the jobs.
        score: function at the top of its module, of a job, for what JSON can hold.
        cache: results of earlier runs; new ones are added as they come.
        workers: number of processes.
    """
    missing = [job for job in jobs if cache.key(job) not in cache.known]
    begin = told = time.monotonic()
    if missing:
        kept = len(jobs) - len(missing)
        print(f"{jobs[0].part}: {len(missing)} runs, {kept} kept from before", file=sys.stderr)
        with ProcessPoolExecutor(workers or os.cpu_count()) as pool:
            waiting = {pool.submit(score, job): job for job in missing}
            for count, done in enumerate(as_completed(waiting), 1):
                if done.exception() is not None:
                    print(f"{waiting[done]} failed", file=sys.stderr)
                cache.add(waiting[done], done.result())
                now = time.monotonic()
                if now - told > PROGRESS_EVERY or count == len(missing):
                    told, left = now, (now - begin) / count * (len(missing) - count)
                    text = f"{count} of {len(missing)} after {now - begin:.0f} s, {left:.0f} s left"
                    print(f"{jobs[0].part}: {text}", file=sys.stderr, flush=True)
    return {job: cache.known[cache.key(job)] for job in jobs}


def interval_of_ratio(numerators: Floats, denominators: Floats) -> tuple[float, float, float]:
    """Ratio of two sums over blocks (n,), and its 95 % bootstrap interval over the blocks."""
    picks = np.random.default_rng(0).integers(0, len(numerators), (1000, len(numerators)))
    drawn = numerators[picks].sum(axis=1) / np.maximum(denominators[picks].sum(axis=1), 1e-9)
    low, high = np.percentile(drawn, (2.5, 97.5))
    whole = float(numerators.sum() / max(denominators.sum(), 1e-9))
    return whole, float(low), float(high)


def rounded(value: Any, digits: int = 4) -> Any:
    """Copy of nested figures with so many significant digits; NaN and infinity become None."""
    if isinstance(value, dict):
        return {key: rounded(one, digits) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(one, digits) for one in value]
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value
