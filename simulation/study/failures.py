"""Failed runs of a study: detection, counts and reports.

A failed run has no statistics: all its values are NaN, so that it enters no sum.
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
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
    """Statistics of some runs of some filters."""

    # (filters, count, n) in the order of `icreckon.simulation.study.statistics.statistics`
    values: Floats
    reasons: Any  # (filters, count) reason of each failed run, as text; empty for the others


def unscored(filters: int, count: int, horizons: Sequence[float]) -> RunScores:
    """Scores to be filled in: NaN, and no reasons."""
    values = np.full((filters, count, len(statistics(horizons))), math.nan)
    return RunScores(values, np.full((filters, count), "", dtype=object))


def exclude_failed(scores: RunScores, horizons: Sequence[float]) -> None:
    """Add reasons for impossible values, and set all values of failed runs to NaN."""
    kinds = statistics(horizons)
    for run in np.ndindex(scores.reasons.shape):
        reason = scores.reasons[run] or _why_impossible(scores.values[run], kinds)
        scores.reasons[run] = reason[:LONGEST_REASON]
        if reason:
            scores.values[run] = math.nan


def failures_of(reasons: Any, labels: Sequence[str]) -> list[dict[str, Any]]:
    """Failed runs by cell and filter, from reasons (filters, cells, runs)."""
    failures = []
    for cell in range(reasons.shape[1]):
        for label, run_reasons in zip(labels, reasons[:, cell].tolist(), strict=True):
            counts = Counter(reason for reason in run_reasons if reason)
            if not counts:
                continue
            by_reason = [
                {"reason": reason, "runs": count, "first_run": run_reasons.index(reason)}
                for reason, count in counts.most_common()
            ]
            failure = {"cell": cell, "variant": label, "runs": counts.total()}
            failures.append(failure | {"of": len(run_reasons), "reasons": by_reason})
    return failures


def _why_impossible(values: Floats, kinds: Sequence[Statistic]) -> str:
    """Reason why the statistics (n,) of a run are impossible; empty if they are valid."""
    names = [kind.name for kind in kinds]
    required = names[names.index(REQUIRED_FROM) : names.index(REQUIRED_TO) + 1]
    for kind, value in zip(kinds, values.tolist(), strict=True):
        is_missing = math.isnan(value)
        if math.isinf(value) or (is_missing and kind.name in required):
            return f"{kind.name} is not finite"
        if is_missing:
            continue
        if value < 0.0:
            return f"{kind.name} is negative ({value:.3g})"
        if value > LARGEST[kind.unit]:
            return f"{kind.name} is impossibly large ({value:.3g})"
    return ""
