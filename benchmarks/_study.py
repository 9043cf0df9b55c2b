"""What the studies share: runs spread over processes, intervals, and tables in Markdown."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import drift, pose_nees, without_fixes
from icreckon.estimator.log.trajectory import Trajectory

BOOTSTRAPS = 10_000
# Seconds between two lines of progress.
PROGRESS_EVERY = 10.0

Job = TypeVar("Job")
Score = TypeVar("Score")


def script_parser(doc: str | None) -> argparse.ArgumentParser:
    """A parser with the docstring of a script as its help."""
    return argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def data_parser(doc: str | None) -> argparse.ArgumentParser:
    """The same with the folder of the sample logs, and `--workers`."""
    parser = script_parser(doc)
    parser.add_argument("data", type=Path, help="folder of the sample logs")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    return parser


def study_parser(doc: str | None, runs: int, variants: Sequence[str]) -> argparse.ArgumentParser:
    """The options of every study: `--runs`, `--variants`, `--workers`.

    Args:
        doc: docstring of the script.
        runs: default number of runs.
        variants: default filter variants.
    """
    parser = script_parser(doc)
    parser.add_argument("--runs", type=int, default=runs)
    parser.add_argument("--variants", nargs="+", default=list(variants))
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    return parser


def spread(score: Callable[[Job], Score], jobs: Sequence[Job], workers: int) -> list[Score]:
    """The scores of all jobs, in their order; progress goes to stderr.

    Args:
        score: a function at the top of its module.
        jobs: what to score.
        workers: number of processes.
    """
    begin = told = time.monotonic()
    scores: list[Score] = []
    with ProcessPoolExecutor(workers) as pool:
        for found in pool.map(score, jobs):
            scores.append(found)
            if time.monotonic() - told > PROGRESS_EVERY:
                told = time.monotonic()
                done = f"{len(scores)} of {len(jobs)} runs after {told - begin:.0f} s"
                print(done, file=sys.stderr, flush=True)
    return scores


def drift_and_nees(found: Trajectory, log: Log) -> tuple[float, float]:
    """Drift after 30 s without fixes [% of the distance], and mean pose NEES, of a simulated run."""
    if log.truth is None or log.fixes is None:
        raise ValueError(f"log {log.name!r} has no truth or no fixes")
    free = without_fixes(log.fixes.stamps, log.start, log.end, 10.0)
    drifted = drift(found.pose_series, log.truth.poses, 30.0, within=free)
    return drifted.percent_mean, float(np.mean(pose_nees(found, log.truth.poses)))


def mean_interval(samples: Floats) -> tuple[float, float, float]:
    """Mean of independent samples (n,), and its 95 % interval by the normal distribution."""
    samples = np.asarray(samples, dtype=float)
    mean = float(samples.mean())
    if len(samples) < 2:
        return mean, float("nan"), float("nan")
    half = 1.96 * float(samples.std(ddof=1)) / np.sqrt(len(samples))
    return mean, mean - half, mean + half


def bootstrap(
    statistic: Callable[[Floats], Floats], samples: Floats, draws: int = BOOTSTRAPS
) -> tuple[float, float, float]:
    """A statistic of independent runs and its 95 % percentile bootstrap interval.

    Args:
        statistic: of (..., n, k) runs over the last axis but one, (...).
        samples: (n, k).
        draws: how often the runs are drawn anew.
    """
    picks = np.random.default_rng(0).integers(0, len(samples), (draws, len(samples)))
    low, high = np.percentile(statistic(samples[picks]), (2.5, 97.5))
    return float(statistic(samples[None])[0]), float(low), float(high)


def told(value: float, low: float, high: float, form: str = ".2f") -> str:
    """A figure with its interval."""
    return f"{value:{form}} ({low:{form}} to {high:{form}})"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    print("| " + " | ".join(head) + " |")
    print("|" + " --- |" * len(head))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)


def ratio_of_sums(samples: Floats) -> Floats:
    """Ratio of the sums of two columns (..., n, 2), for `bootstrap`."""
    sums = samples.sum(axis=-2)
    return np.asarray(sums[..., 0] / sums[..., 1])
