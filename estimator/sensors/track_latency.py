"""Latency of the track speeds against the gyro, estimated while driving.

Turning shows it: the yaw change in a window by the gyro is a straight line in the yaw change by the
track speeds in the same window, shifted by the latency. Sums for a regression are kept for each shift
of a grid, in blocks of equal turning, so that old blocks can be dropped and the standard error follows
from leaving out one block at a time. A batch version that looks at a whole log is
`icreckon.replay.inspection.latency`.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.lag_search import beside_lowest, jackknife_sigma
from icreckon.estimator.base.records import NEVER

GRID = 20_000_000
"""Spacing of the candidate latencies [ns]."""
SHIFTS = np.arange(-15, 40) * (GRID * NANOSECOND)
"""Candidate latencies [s]."""
EARLIEST, LATEST = -15 * GRID, 39 * GRID
"""Smallest and largest of them [ns]."""
WINDOW, WINDOW_STEP = 50, 5
"""Length and spacing of the windows, in steps of the grid."""
BLOCK = 1.25
"""Turning that closes a block, by the gyro [rad]."""
FEWEST_BLOCKS, MOST_BLOCKS = 4, 32
"""Numbers of blocks at which there is an estimate, and from which the oldest is dropped."""
LARGEST_HOLE = 500_000_000
"""Gap between samples at which the windows begin anew [ns]."""
LEAST_CORRELATION = 0.7
"""Smallest correlation of tracks and gyro at which there is an estimate [-]."""
CAPACITY = 16_384
"""Number of samples that are kept to integrate over the windows: 16 s at 1000 Hz."""
AT_ONCE = 50
"""Number of windows that are used at once, which costs less."""


class TrackLatency(NamedTuple):
    """Latency of the track speeds behind the gyro, and its standard error [s]."""

    seconds: float
    sigma: float


class RateMemory(msgspec.Struct, frozen=True):
    """Checkpoint of samples of a rate.

    Attributes:
        stamps: their stamps [ns].
        rates: the rates.
    """

    stamps: Annotated[list[int], msgspec.Meta(max_length=CAPACITY)]
    rates: list[float]

    def __post_init__(self) -> None:
        if len(self.rates) != len(self.stamps):
            raise ValueError("samples of a rate need a stamp each")
        steps = [other - one for one, other in pairwise(self.stamps)]
        if steps and not 0 < min(steps) <= max(steps) <= LARGEST_HOLE:
            raise ValueError("the stamps of a rate must rise, without holes")


class TrackLatencyMemory(msgspec.Struct, frozen=True):
    """Checkpoint of a `TrackLatencyEstimator`.

    Attributes:
        origin: stamp at which the grid begins [ns]; NEVER before the first sample.
        blocks: (n, 6, m) sums of the completed blocks.
        open: (6, m) sums of the block under way.
        turned: turning in it [rad].
        next_window: start of the next window [ns], or NEVER.
        gyro: yaw rate by the gyro [rad/s].
        tracks: speed of the right track less that of the left [m/s].
    """

    origin: int
    blocks: np.ndarray[Any, Any]
    open: np.ndarray[Any, Any]
    turned: float
    next_window: int
    gyro: RateMemory
    tracks: RateMemory

    def __post_init__(self) -> None:
        of_block = (6, len(SHIFTS))
        count = len(self.blocks)
        if count > MOST_BLOCKS or self.blocks.shape != ((count, *of_block) if count else (0,)):
            raise ValueError(
                f"blocks of turning need {of_block} sums each, and are {MOST_BLOCKS} at most"
            )
        if self.open.shape != of_block:
            raise ValueError(f"the block of turning under way needs {of_block} sums")


class _Rate:
    """Samples of a rate, over the last seconds.

    Args:
        of_readings: rates (n,) of readings (n, ...).
        held: whether a rate holds until the next sample; otherwise it changes steadily in between.

    Attributes:
        stamps: stamps of the samples [ns].
        newest: stamp of the newest sample, or NEVER.
    """

    def __init__(self, of_readings: Callable[[Floats], Floats], *, held: bool) -> None:
        self._of_readings, self._held, self.newest = of_readings, held, NEVER
        self.stamps: list[int] = []
        # Rates of the samples; of the newest, readings whose rates are not computed yet.
        self._rates: list[float] = []
        self._readings: list[Any] = []

    def add(self, stamp: int, reading: Any) -> None:
        """Add a sample [ns]."""
        self.newest = stamp
        self.stamps.append(stamp)
        self._readings.append(reading)
        if len(self.stamps) > CAPACITY:
            self.drop_before(self.stamps[CAPACITY // 2])

    def _all_rates(self) -> list[float]:
        if self._readings:
            self._rates += self._of_readings(np.array(self._readings)).tolist()
            self._readings.clear()
        return self._rates

    def integral(self, begin: int, count: int) -> Floats:
        """Integral (count,) up to each point of a grid that begins at a stamp [ns]."""
        seconds = (np.array(self.stamps) - begin) * NANOSECOND
        rates, values = np.array(self._all_rates()), np.zeros(len(seconds))
        between = rates[:-1] if self._held else 0.5 * (rates[:-1] + rates[1:])
        np.cumsum(np.diff(seconds) * between, out=values[1:])
        found: Floats = np.interp(np.arange(count) * (GRID * NANOSECOND), seconds, values)
        return found

    def drop_before(self, stamp: int) -> None:
        """Drop samples that integrals from a stamp on [ns] do not depend on."""
        first = max(0, bisect_right(self.stamps, stamp) - 1)
        del self.stamps[:first], self._all_rates()[:first]

    def memory(self) -> RateMemory:
        """Checkpoint of the samples."""
        return RateMemory(self.stamps.copy(), self._all_rates().copy())

    def recall(self, memory: RateMemory) -> None:
        """Restore a checkpoint."""
        self.stamps, self._rates = memory.stamps.copy(), memory.rates.copy()
        self.newest = self.stamps[-1] if self.stamps else NEVER


class TrackLatencyEstimator:
    """Estimator of the latency of track speeds, from samples in the order of arrival.

    Args:
        yaw_rates: yaw rates (n,) of readings of the gyro (n, ...) [rad/s]; None if these are yaw rates.

    Attributes:
        completed: number of blocks that were completed; the estimate changes with it.
    """

    def __init__(self, yaw_rates: Callable[[Floats], Floats] | None = None) -> None:
        self._yaw_rates = yaw_rates or np.asarray
        self._origin = NEVER
        self._blocks: deque[Floats] = deque(maxlen=MOST_BLOCKS)
        self._open = np.zeros((6, len(SHIFTS)))
        self._turned, self.completed = 0.0, 0
        self._begin()

    def take_tracks(self, stamp: int, left: float, right: float) -> None:
        """Add track speeds.

        Args:
            stamp: raw stamp [ns].
            left: left track [m/s], in any scale.
            right: right track.
        """
        tracks = self._tracks
        if not 0 < stamp - tracks.newest <= LARGEST_HOLE:
            if not self._may_follow(tracks.newest, stamp):
                return
            tracks = self._tracks
        tracks.add(stamp, right - left)
        if stamp >= self._due:
            self._use_windows(AT_ONCE)

    def take_gyro(self, stamp: int, reading: Any) -> None:
        """Add a reading of the gyro.

        Args:
            stamp: raw stamp [ns].
            reading: yaw rate [rad/s], its bias included, or what `yaw_rates` takes.
        """
        gyro = self._gyro
        if not 0 < stamp - gyro.newest <= LARGEST_HOLE:
            if not self._may_follow(gyro.newest, stamp):
                return
            gyro = self._gyro
        gyro.add(stamp, reading)

    def estimate(self) -> TrackLatency | None:
        """Estimate the latency; None while it is not observable."""
        if len(self._blocks) < FEWEST_BLOCKS:
            return None
        total = np.sum(self._blocks, axis=0)
        best, *without = _best(np.stack([total, *(total - self._blocks)])).tolist()
        sigma = jackknife_sigma(np.array(without))
        return None if math.isnan(best + sigma) else TrackLatency(best, sigma)

    def memory(self) -> TrackLatencyMemory:
        """Checkpoint of the estimator."""
        return TrackLatencyMemory(
            self._origin,
            np.array(self._blocks),
            self._open.copy(),
            self._turned,
            self._next,
            self._gyro.memory(),
            self._tracks.memory(),
        )

    def recall(self, memory: TrackLatencyMemory) -> None:
        """Restore a checkpoint."""
        self._begin()
        self._origin, self._turned = memory.origin, memory.turned
        self._blocks = deque(memory.blocks.copy(), maxlen=MOST_BLOCKS)
        self._open, self._next = memory.open.copy(), memory.next_window
        self._gyro.recall(memory.gyro)
        self._tracks.recall(memory.tracks)

    def _begin(self) -> None:
        """Begin new windows; completed blocks stay."""
        self._gyro, self._tracks = _Rate(self._yaw_rates, held=False), _Rate(np.asarray, held=True)
        self._next = self._due = NEVER

    def _may_follow(self, newest: int, stamp: int) -> bool:
        """Begin again after a hole; return False for a sample of before the newest one."""
        if -LARGEST_HOLE <= stamp - newest <= 0:
            return False
        if newest != NEVER:
            self._use_windows(1)
            self._begin()
        if self._origin == NEVER:
            self._origin = stamp
        return True

    def _use_windows(self, fewest: int) -> None:
        """Use the windows that both rates cover, if there are so many."""
        gyro, tracks, step = self._gyro, self._tracks, WINDOW_STEP * GRID
        if len(gyro.stamps) < 2 or len(tracks.stamps) < 2:
            return
        first = max(gyro.stamps[0], tracks.stamps[0] - EARLIEST)
        begin = max(self._next, self._origin - (self._origin - first) // step * step)
        end = min(tracks.newest - LATEST, gyro.newest) - WINDOW * GRID
        windows = max(0, -((begin - end) // step))
        self._next, self._due = begin, begin + (fewest - 1) * step + WINDOW * GRID + LATEST + 1
        if windows < fewest:
            return
        starts = np.arange(windows) * WINDOW_STEP
        by_gyro = gyro.integral(begin, starts[-1] + WINDOW + 1)
        by_tracks = tracks.integral(begin + EARLIEST, starts[-1] + WINDOW + len(SHIFTS))
        y = by_gyro[starts + WINDOW] - by_gyro[starts]
        x = sliding_window_view(by_tracks[WINDOW:] - by_tracks[:-WINDOW], len(SHIFTS))[starts]
        moving = x.any(axis=1)
        self._add(x[moving], y[moving])
        self._next, self._due = begin + windows * step, self._due + windows * step
        for rate in (gyro, tracks):
            rate.drop_before(self._next + EARLIEST)

    def _add(self, x: Floats, y: Floats) -> None:
        """Add windows: turning by the tracks (n, m), for each shift, and by the gyro (n,)."""
        while len(y):
            turned = self._turned + np.cumsum(np.abs(y)) * (WINDOW_STEP / WINDOW)
            count = int(np.searchsorted(turned, BLOCK)) + 1
            of_x, of_y, one = x[:count], y[:count], np.ones(len(SHIFTS))
            self._open += [
                len(of_y) * one,
                of_x.sum(axis=0),
                of_y.sum() * one,
                (of_x * of_x).sum(axis=0),
                of_y @ of_x,
                of_y @ of_y * one,
            ]
            self._turned = float(turned[len(of_y) - 1])
            if count <= len(y):
                self._blocks.append(self._open)
                self._open, self._turned = np.zeros((6, len(SHIFTS))), 0.0
                self.completed += 1
            x, y = x[count:], y[count:]


def _best(sums: Floats) -> Floats:
    """Shifts (n,) of the smallest misfit [s], of sums (n, 6, m).

    They are refined by a parabola, and NaN where they are not observable.
    """
    n, x, y, xx, xy, yy = np.moveaxis(sums, 1, 0)
    variance = yy - y * y / n
    with np.errstate(divide="ignore", invalid="ignore"):
        misfit = variance - (xy - x * y / n) ** 2 / (xx - x * x / n)
        found = np.argmin(misfit, axis=1)
        at = np.clip(found, 1, len(SHIFTS) - 2)
        rows = np.arange(len(sums))
        explained = 1.0 - misfit[rows, at] / variance[rows, at]
        refined = SHIFTS[at] + beside_lowest(misfit, at) * (GRID * NANOSECOND)
    known = np.isfinite(misfit).all(axis=1) & (found == at) & (variance[rows, at] > 0.0)
    known &= explained >= LEAST_CORRELATION**2
    return np.where(known, refined, np.nan)
