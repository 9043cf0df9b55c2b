"""Failed runs of a study: detection, counts and reports.

A failed run has no statistics: all its values are NaN, so that it enters no sum.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import IcreckonError
from icreckon.estimator.streaming.lost import described
from icreckon.simulation.study.statistics import Statistic, statistics

# Largest plausible value of a statistic by its unit; working filters are far below.
LARGEST = {
    "% of distance": 1e7,
    "deg/m": 1e7,
    "m": 1e7,
    "m/s": 1e3,
    "rad": 1e3,
    "rad/s": 1e3,
    "-": 1e12,
}
# Statistics that every run has; others are NaN in runs too short, or without such measurements.
REQUIRED_FROM, REQUIRED_TO = "final_position_error_m", "rmse_w_rad_s"
LONGEST_REASON = 300  # longest stored reason, in characters


class RunScores(NamedTuple):
    """Statistics of some runs of a filter."""

    values: Floats  # (count, n) in the order of `icreckon.simulation.study.statistics.statistics`
    reasons: tuple[str, ...]  # (count,) reason of each failed run; empty for the others


def checked(scores: RunScores, horizons: Sequence[float]) -> RunScores:
    """Exclude failed runs: add reasons for impossible values, set all values to NaN."""
    kinds = statistics(horizons)
    values, reasons = scores.values.copy(), []
    for row, reason in zip(values, scores.reasons, strict=True):
        failure = (reason or _why_impossible(row, kinds))[:LONGEST_REASON]
        reasons.append(failure)
        if failure:
            row[:] = math.nan
    return RunScores(values, tuple(reasons))


def run_by_run(
    one_run: Callable[[int, str], RunScores], runs: range, labels: Sequence[str], width: int
) -> dict[str, RunScores]:
    """Score runs one at a time; an exception becomes the reason of a failed run.

    Only MemoryError is raised: it is a failure of the worker, not of the run. `one_run` scores a run,
    by its index, by a filter, by its label; `width` is the number of statistics.
    """
    by_label = {}
    for label in labels:
        values, reasons = np.full((len(runs), width), math.nan), []
        for row, run in enumerate(runs):
            try:
                scores = one_run(run, label)
            except MemoryError:
                raise
            except IcreckonError as problem:
                reasons.append(str(problem))
            except Exception as problem:
                reasons.append(described(problem))
            else:
                values[row] = scores.values[0]
                reasons += scores.reasons
        by_label[label] = RunScores(values, tuple(reasons))
    return by_label


def failures_of(reasons: Any, labels: Sequence[str]) -> list[dict[str, Any]]:
    """Failed runs by cell and filter, from reasons (filters, cells, runs)."""
    failures = []
    for cell in range(reasons.shape[1]):
        for label, run_reasons in zip(labels, reasons[:, cell].tolist(), strict=True):
            failed = [reason for reason in run_reasons if reason]
            if not failed:
                continue
            counted = [
                {"reason": reason, "runs": count, "first_run": run_reasons.index(reason)}
                for reason, count in Counter(failed).most_common()
            ]
            failure = {"cell": cell, "variant": label, "runs": len(failed)}
            failures.append(failure | {"of": len(run_reasons), "reasons": counted})
    return failures


def _why_impossible(values: Floats, kinds: Sequence[Statistic]) -> str:
    """Reason why the statistics (n,) of a run are impossible; empty if they are valid."""
    names = [kind.name for kind in kinds]
    required = names[names.index(REQUIRED_FROM) : names.index(REQUIRED_TO) + 1]
    for kind, value in zip(kinds, values.tolist(), strict=True):
        if math.isinf(value) or (math.isnan(value) and kind.name in required):
            return f"{kind.name} is not finite"
        # Both comparisons are False for NaN, which a statistic that is not required may be.
        if value < 0.0:
            return f"{kind.name} is negative ({value:.3g})"
        if value > LARGEST[kind.unit]:
            return f"{kind.name} is impossibly large ({value:.3g})"
    return ""
