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
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.scores import SEGMENT_STEP, Drift

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
    # numbers of segments of each log, in their order; empty for one log
    counts: tuple[int, ...] = ()

    @property
    def blocks(self) -> float:
        """Number of blocks in the segments."""
        return len(self.distances) / self.block

    def only(self, names: Sequence[str]) -> Self:
        """Keep only the variants with these names."""
        rows = [row for row, name in enumerate(self.names) if name in names]
        return replace(self, names=tuple(self.names[row] for row in rows), errors=self.errors[rows])

    def percent(self, name: str) -> Estimate:
        """Mean error over mean distance [%]; NaN without a segment."""
        return self._ratio(100.0 * self.errors[self.names.index(name)], self.distances)

    def ratio(self, name: str, other: str) -> Estimate:
        """Error of a variant over that of another, paired; NaN without a segment."""
        return self._ratio(*(self.errors[self.names.index(variant)] for variant in (name, other)))

    def _ratio(self, numerators: Floats, denominators: Floats) -> Estimate:
        """Ratio of two sums over the segments, its interval by block bootstrap."""
        if not len(numerators) or denominators.sum() <= 0.0:
            return Estimate(math.nan, None)
        value = float(numerators.sum() / denominators.sum())
        if self.blocks < LEAST_BLOCKS:
            return Estimate(value, None)
        rng = np.random.default_rng(SEED)
        starts = rng.integers(0, len(numerators), (REPLICATES, max(1, round(self.blocks))))
        with np.errstate(divide="ignore", invalid="ignore"):
            replicates = self._sums(numerators, starts) / self._sums(denominators, starts)
        replicates = replicates[np.isfinite(replicates)]
        tail = expanded_tail(self.blocks)
        low, high = np.quantile(replicates, (tail, 1.0 - tail)).tolist()
        return Estimate(value, (min(low, value), max(high, value)))

    def _sums(self, values: Floats, starts: NDArray[np.int64]) -> Floats:
        """Sums (replicates,) over the blocks with these starts, circular in each log."""
        sums = []
        for part in np.split(values, np.cumsum(self.counts)[:-1]) if self.counts else [values]:
            if len(part):
                repeated = np.tile(part, 1 + math.ceil(self.block / len(part)))
                summed = np.concatenate([[0.0], np.cumsum(repeated)])
                first = np.arange(len(part))
                sums.append(summed[first + self.block] - summed[first])
        return np.asarray(np.concatenate(sums)[starts].sum(axis=1))


def expanded_tail(blocks: float) -> float:
    """Expanded tail probability at each end, for a number of independent blocks."""
    from scipy.special import ndtr, stdtrit

    quantile = math.sqrt(blocks / (blocks - 1.0)) * stdtrit(blocks - 1.0, 1.0 - TAIL)
    return float(ndtr(-quantile))


def paired_drift(drifts: Mapping[str, Drift]) -> PairedDrift:
    """Pair the drifts of one horizon on the common segments in which the robot moved."""
    common = None
    for drift in drifts.values():
        starts = drift.starts[drift.moved]
        common = starts if common is None else np.intersect1d(common, starts)
    if common is None:
        raise ValueError("there is no drift to pair")
    rows = {name: np.searchsorted(one.starts, common) for name, one in drifts.items()}
    errors = np.array([one.position_errors[rows[name]] for name, one in drifts.items()])
    name, first = next(iter(drifts.items()))
    duration_s = first.horizon
    if first.unit == "m":
        duration_s = float(first.durations[rows[name]].mean()) if len(common) else 1.0
    step_s = float(np.median(np.diff(common))) * 1e-9 if len(common) > 1 else 1.0
    # Number of segments that start within the duration of one.
    starts_per_segment = max(1.0, duration_s / step_s)
    block = min(
        BLOCK_SEGMENTS * starts_per_segment, max(starts_per_segment, len(common) / WANTED_BLOCKS)
    )
    distances = first.distances[rows[name]]
    return PairedDrift(tuple(drifts), errors, distances, max(1, math.ceil(block)))


def pooled_drift(logs: Sequence[PairedDrift]) -> PairedDrift:
    """Join the drifts of several logs, for the variants that all of them have."""
    if not logs:
        raise ValueError("there is no log to pool")
    names = tuple(name for name in logs[0].names if all(name in one.names for one in logs))
    rows = [one.errors[[one.names.index(name) for name in names]] for one in logs]
    return PairedDrift(
        names,
        np.concatenate(rows, axis=1),
        np.concatenate([one.distances for one in logs]),
        _usual_block(logs),
        tuple(len(one.distances) for one in logs),
    )


def _usual_block(logs: Sequence[PairedDrift]) -> int:
    """Median length of a block over all segments, which one short log hardly changes."""
    lengths = np.array([log.block for log in logs])
    counts = np.array([len(log.distances) for log in logs])
    order = np.argsort(lengths)
    cumulated = np.cumsum(counts[order])
    return int(lengths[order][np.searchsorted(cumulated, 0.5 * cumulated[-1])])


def matched_drifts(one: Drift, other: Drift, *, later: float = 0.0) -> tuple[Drift, Drift]:
    """Keep the segments of two drifts that start at the same time of one log.

    Two runs may remove different lags from the truth: the same segment then has two stamps. `later` [s]
    is the time by which a pose of the truth is stamped later in `other` than in `one`. Both drifts must
    have the same horizon; both are returned with the stamps of `one`.
    """
    if not len(one.starts) or not len(other.starts):
        nothing = np.zeros(0, dtype=np.int64)
        return _rows(one, nothing, nothing), _rows(other, nothing, nothing)
    starts = other.starts - round(later / NANOSECOND)
    after = np.clip(np.searchsorted(starts, one.starts), 1, max(1, len(starts) - 1))
    after = np.minimum(after, len(starts) - 1)
    before = np.maximum(after - 1, 0)
    closer = abs(starts[before] - one.starts) <= abs(starts[after] - one.starts)
    nearest = np.where(closer, before, after)
    same = abs(starts[nearest] - one.starts) < 0.5 * SEGMENT_STEP / NANOSECOND
    stamps = one.starts[same]
    return _rows(one, np.flatnonzero(same), stamps), _rows(other, nearest[same], stamps)


def _rows(drift: Drift, rows: NDArray[np.int64], starts: NDArray[np.int64]) -> Drift:
    """Select rows of a drift, and replace the stamps of their starts."""
    columns = ("durations", "position_errors", "yaw_errors", "distances")
    return replace(drift, starts=starts, **{name: getattr(drift, name)[rows] for name in columns})
