"""Statistics over the runs of a study, with cluster-robust intervals.

Runs of the same true motion are not independent. So the standard error of a mean is that of sums over
true motions (cluster-robust; Cameron and Miller, A practitioner's guide to cluster-robust inference,
2015). The interval is that of Student's t, with one degree of freedom less than there are true motions.
If each run has its own true motion, that is the usual t interval. Statistics are positive and skewed, so
it is that of the logarithm of the mean (delta method), which cannot reach below zero. Ratios are those of
two means over the same runs, their intervals likewise; only differences have intervals that lie evenly
about them. Nothing here is drawn at random.
"""

import math
from dataclasses import dataclass, fields
from functools import cache

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.lag_search import jackknife_sigma

CONFIDENCE = 0.95
GROUPS = 5  # number of groups of neighbouring cells that summarise a sampled axis

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Summary:
    """Summary of one statistic of one filter over runs; NaN if undefined."""

    n: int  # number of runs that have the statistic
    true_motions: int  # number of distinct true motions among them
    mean: float  # mean, with its interval
    mean_low: float
    mean_high: float
    median: float  # median of the runs
    p05: float  # fifth percentile of the runs
    p95: float  # 95th percentile of the runs
    pairs: int  # number of runs for which filter and baseline have it
    difference: float  # mean over those runs, less that of the baseline, with its interval
    difference_low: float
    difference_high: float
    ratio: float  # mean over those runs, divided by that of the baseline, with its interval
    ratio_low: float
    ratio_high: float


COLUMNS = tuple(field.name for field in fields(Summary))


def summarise(
    values: Floats, baseline: Floats, motions: Ints, paired: Floats | None = None
) -> Summary:
    """Summarise values (n,) of runs, NaN for none, also against the baseline's.

    `motions` (n,) are the indices of the true motions. `paired` (n,) are the values over the cells that
    the baseline has too; `values` by default.
    """
    paired = values if paired is None else paired
    has_value = np.isfinite(values)
    finite, finite_motions = values[has_value], motions[has_value]
    has_pair = np.isfinite(paired) & np.isfinite(baseline)
    mean = mean_interval(finite, finite_motions, positive=True)
    difference = mean_interval(paired[has_pair] - baseline[has_pair], motions[has_pair])
    ratio = ratio_interval(paired[has_pair], baseline[has_pair], motions[has_pair])
    percentiles = [math.nan] * 3
    if len(finite):
        percentiles = np.percentile(finite, (50.0, 5.0, 95.0)).tolist()
    median, p05, p95 = percentiles
    runs, true_motions, pairs = len(finite), len(np.unique(finite_motions)), int(has_pair.sum())
    return Summary(runs, true_motions, *mean, median, p05, p95, pairs, *difference, *ratio)


def mean_interval(
    values: Floats, motions: Ints, *, positive: bool = False
) -> tuple[float, float, float]:
    """Mean of runs (n,) and its 95 % interval, by their true motions (n,).

    If `positive`, the interval is that of the mean's logarithm, which cannot reach below zero.
    """
    if not len(values):
        return math.nan, math.nan, math.nan
    mean = float(values.mean())
    half = _half_width(values - mean, motions)
    if positive and mean > 0.0:
        return _on_log_scale(mean, half)
    return mean, mean - half, mean + half


def ratio_interval(values: Floats, baseline: Floats, motions: Ints) -> tuple[float, float, float]:
    """Ratio of two means over the same runs (n,), its 95 % interval; NaN if undefined."""
    mean_of_baseline = float(baseline.mean()) if len(baseline) else 0.0
    if mean_of_baseline == 0.0:
        return math.nan, math.nan, math.nan
    ratio = float(values.mean()) / mean_of_baseline
    half = _half_width((values - ratio * baseline) / mean_of_baseline, motions)
    return _on_log_scale(ratio, half) if ratio > 0.0 else (ratio, ratio - half, ratio + half)


def _on_log_scale(value: float, half: float) -> tuple[float, float, float]:
    """Positive value and its interval, which is even about its logarithm."""
    # `half` is the half-width of the interval of the value, half / value that of its logarithm.
    with np.errstate(over="ignore"):
        factor = float(np.exp(half / value))
    return value, value / factor, value * factor


def jackknife_half_width(without: Floats) -> float:
    """Half-width of a 95 % interval, by values (m,) without each true motion; or NaN."""
    count = len(without)
    return _student(count - 1) * float(jackknife_sigma(without)) if count > 1 else math.nan


def over_cells(values: Floats) -> Floats:
    """Means (..., runs, statistics) over finite cells (..., cells, runs, statistics)."""
    known = np.isfinite(values)
    count = known.sum(axis=-3)
    total = np.where(known, values, 0.0).sum(axis=-3)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _half_width(residuals: Floats, motions: Ints) -> float:
    """Half-width of the 95 % interval of a mean, by residuals (n,) about it; or NaN."""
    # Runs of one true motion are dependent: they form a cluster.
    _, cluster_of_run = np.unique(motions, return_inverse=True)
    sums = np.bincount(cluster_of_run, weights=residuals)
    clusters = len(sums)
    if clusters < 2:
        return math.nan  # one true motion has no spread
    variance = clusters / (clusters - 1) * float(np.sum(sums**2)) / len(residuals) ** 2
    return _student(clusters - 1) * math.sqrt(variance)


@cache
def _student(degrees: int) -> float:
    """Half-width of the 95 % interval of Student's t, by its degrees of freedom."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * CONFIDENCE, degrees))
