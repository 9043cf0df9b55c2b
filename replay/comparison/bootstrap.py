"""Block bootstrap: 95 % intervals of the drift of one log, or of several.

Segments that start a second apart overlap, and causes of drift are correlated over time. Blocks of the
log are therefore resampled instead of segments (Künsch, The jackknife and the bootstrap for general
stationary observations, Annals of Statistics 17, 1989; circular, after Politis and Romano). Blocks are
two segments long, shorter if the log has fewer than five of these, but at least one segment. For few
blocks, the percentiles are widened like Student's t (Hesterberg, What teachers should know about the
bootstrap, The American Statistician 69, 2015, "expanded percentile"). Fewer than three blocks give no
interval.

Of several logs, blocks are drawn from all of them, and a block stays within its log. The interval is that
of the time of these logs. How much logs differ widens it less than drawing whole logs would, of which
there are too few: it does not cover other logs.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.scores import SEGMENT_STEP, Drift
from icreckon.replay.comparison.holes import nearest_rows

REPLICATES = 2000
SEED = 1
LEAST_BLOCKS = 3
WANTED_BLOCKS = 5
# Length of a block in segments.
BLOCK_SEGMENTS = 2.0
TAIL = 0.025

Interval = tuple[float, float]


class Estimate(NamedTuple):
    """A figure with its 95 % interval; None if the log is too short for one."""

    value: float
    interval: Interval | None


@dataclass(frozen=True)
class PairedDrift:
    """Drift of several variants over the same segments of one horizon."""

    names: tuple[str, ...]  # (v,) names of the variants
    errors: Floats  # (v, n) position errors [m]
    distances: Floats  # (n,) length of the true path [m]
    block: int  # (segments) length of a block
    counts: tuple[int, ...] = ()  # segments of each log, in their order; empty for one log

    @property
    def blocks(self) -> float:
        """Number of blocks in the segments."""
        return len(self.distances) / self.block

    def percent(self, name: str) -> Estimate:
        """Mean error over mean distance [%]; NaN without a segment."""
        return self._ratio(100.0 * self.errors[self.names.index(name)], self.distances)

    def ratio(self, name: str, other: str) -> Estimate:
        """Error of a variant over that of another, paired; NaN without a segment."""
        return self._ratio(*(self.errors[self.names.index(key)] for key in (name, other)))

    def _ratio(self, numerators: Floats, denominators: Floats) -> Estimate:
        if not len(numerators) or denominators.sum() <= 0.0:
            return Estimate(math.nan, None)
        value = float(numerators.sum() / denominators.sum())
        if self.blocks < LEAST_BLOCKS:
            return Estimate(value, None)
        rng = np.random.default_rng(SEED)
        count = len(numerators)
        starts = rng.integers(0, count, (REPLICATES, max(1, round(self.blocks))))
        with np.errstate(divide="ignore", invalid="ignore"):
            replicates = self._sums(numerators, starts) / self._sums(denominators, starts)
        replicates = replicates[np.isfinite(replicates)]
        from scipy.special import ndtr, stdtrit

        # The expanded tail probability at each end.
        blocks = self.blocks
        quantile = math.sqrt(blocks / (blocks - 1.0)) * stdtrit(blocks - 1.0, 1.0 - TAIL)
        tail = float(ndtr(-quantile))
        low, high = np.quantile(replicates, (tail, 1.0 - tail)).tolist()
        return Estimate(value, (min(low, value), max(high, value)))

    def _sums(self, values: Floats, starts: NDArray[np.int64]) -> Floats:
        """Sums of values (n,) over the blocks that begin at `starts` (replicates, blocks)."""
        block_sums = []  # of the block that starts at each segment, circular in its log
        for log in np.split(values, np.cumsum(self.counts)[:-1]) if self.counts else [values]:
            if len(log):
                repeated = np.tile(log, 1 + math.ceil(self.block / len(log)))
                summed = np.concatenate([[0.0], np.cumsum(repeated)])
                first = np.arange(len(log))
                block_sums.append(summed[first + self.block] - summed[first])
        return np.asarray(np.concatenate(block_sums)[starts].sum(axis=1))


def paired_drift(drifts: Mapping[str, Drift]) -> PairedDrift:
    """Pair the drifts of one horizon on the common segments in which the robot moved."""
    if not drifts:
        raise ValueError("there is no drift to pair")
    moving_starts = [drift.starts[drift.moved] for drift in drifts.values()]
    common_starts = reduce(np.intersect1d, moving_starts)
    errors = [
        drift.position_errors[np.searchsorted(drift.starts, common_starts)]
        for drift in drifts.values()
    ]
    # Distances and durations are those of the truth, the same in each drift.
    first = next(iter(drifts.values()))
    rows = np.searchsorted(first.starts, common_starts)
    duration, count = first.horizon, len(rows)
    if first.unit == "m":
        duration = float(first.durations[rows].mean()) if count else 1.0
    step = float(np.median(np.diff(common_starts))) * NANOSECOND if count > 1 else 1.0
    # In steps from one segment to the next, which overlaps it.
    segment = max(1.0, duration / step)
    block = math.ceil(min(BLOCK_SEGMENTS * segment, max(segment, count / WANTED_BLOCKS)))
    return PairedDrift(tuple(drifts), np.array(errors), first.distances[rows], max(1, block))


def pooled_drift(logs: Sequence[PairedDrift], among: Sequence[str] | None = None) -> PairedDrift:
    """Join drifts of several logs, for the variants (`among` some) that all have."""
    if not logs:
        raise ValueError("there is no log to pool")
    wanted = logs[0].names if among is None else [name for name in logs[0].names if name in among]
    names = tuple(name for name in wanted if all(name in log.names for log in logs))
    errors = [log.errors[[log.names.index(name) for name in names]] for log in logs]
    distances = np.concatenate([log.distances for log in logs])
    # Median length of a block over all segments: no short odd log changes it.
    lengths = np.array([log.block for log in logs])
    counts = [len(log.distances) for log in logs]
    order = np.argsort(lengths)
    segments = np.cumsum(np.array(counts)[order])
    block = int(lengths[order][np.searchsorted(segments, 0.5 * segments[-1])])
    return PairedDrift(names, np.concatenate(errors, axis=1), distances, block, tuple(counts))


def matched_drifts(first: Drift, other: Drift, *, later: float = 0.0) -> tuple[Drift, Drift]:
    """Keep the segments of two drifts that start at the same time of one log.

    Two runs may remove different lags of the truth: a pose with stamp t in `first` has t + `later` in
    `other` [s]. Both drifts get the stamps of the first.
    """
    if not len(first.starts) or not len(other.starts):
        nothing = np.zeros(0, dtype=np.int64)
        return _select(first, nothing, nothing), _select(other, nothing, nothing)
    starts = first.starts
    other_starts = other.starts - round(later / NANOSECOND)  # by the stamps of the first
    nearest = nearest_rows(other_starts, starts)
    is_same = abs(other_starts[nearest] - starts) < 0.5 * SEGMENT_STEP / NANOSECOND
    stamps = starts[is_same]
    return _select(first, np.flatnonzero(is_same), stamps), _select(other, nearest[is_same], stamps)


def _select(drift: Drift, rows: NDArray[np.int64], stamps: NDArray[np.int64]) -> Drift:
    """Select segments of a drift, and set the stamps of their starts."""
    names = ("durations", "position_errors", "yaw_errors", "distances")
    return replace(drift, starts=stamps, **{name: getattr(drift, name)[rows] for name in names})
