"""Latency of the track speeds against the gyro, estimated while driving.

In each window the yaw change by the gyro is a linear function of the yaw change by the track speeds,
in a window shifted by the latency. Sums of this regression are kept for each shift of a grid, in blocks
of equal turning: old blocks can be dropped, and the standard error is that of a jackknife over blocks.
`icreckon.replay.estimates.latency` does the same for a whole log.
"""

import math
from collections import deque
from itertools import pairwise
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.lag_search import beside_lowest, jackknife_sigma
from icreckon.estimator.base.records import NEVER, Stamp, zeros
from icreckon.estimator.log.lag import Lag

GRID = 20_000_000  # spacing of the candidate latencies [ns]
SHIFTS = np.arange(-15, 40) * (GRID * NANOSECOND)  # candidate latencies [s]
EARLIEST, LATEST = -15 * GRID, 39 * GRID  # smallest and largest of them [ns]
WINDOW, WINDOW_STEP = 50, 5  # length and spacing of the windows, in steps of the grid
BLOCK = 1.25  # turning that closes a block, by the gyro [rad]
FEWEST_BLOCKS, MOST_BLOCKS = 4, 32
"""Numbers of blocks at which there is an estimate, and from which the oldest is dropped."""
LARGEST_HOLE = 500_000_000  # gap between samples at which the windows start again [ns]
LEAST_CORRELATION = 0.7  # smallest correlation of tracks and gyro at which there is an estimate [-]
CAPACITY = 16_384  # number of samples that are kept to integrate over the windows: 16 s at 1000 Hz
NO_HOLE = 2**62  # later than all stamps [ns]
ROOM = 64  # number of samples of a rate that a filter keeps until the watch takes them
Buffer = Annotated[list[float], msgspec.Meta(min_length=ROOM, max_length=ROOM)]


class RateRecord(msgspec.Struct):
    """Newest samples of a rate, in the record of a filter, until the watch takes them."""

    begin: Stamp = NEVER  # stamp of the first of them [ns], or NEVER
    count: Annotated[int, msgspec.Meta(ge=0, le=ROOM)] = 0  # their number
    times: Buffer = zeros(ROOM)  # times since the first of them [ns]; the rest is unused
    rates: Buffer = zeros(ROOM)  # the rates; likewise


def add_rate(record: RateRecord, stamp: int, rate: float) -> None:
    """Add a sample, if there is room; plain Python, for numba too."""
    count = record.count
    if count == ROOM:
        return
    if count == 0:
        record.begin = stamp
    record.times[count], record.rates[count] = float(stamp - record.begin), rate
    record.count = count + 1


class RateMemory(msgspec.Struct, frozen=True):
    """Checkpoint of samples of a rate."""

    stamps: Annotated[list[int], msgspec.Meta(max_length=CAPACITY)]  # their stamps [ns]
    rates: list[float]  # the rates

    def __post_init__(self) -> None:
        if len(self.rates) != len(self.stamps):
            raise ValueError("samples of a rate need a stamp each")
        steps = [later - earlier for earlier, later in pairwise(self.stamps)]
        if steps and not 0 < min(steps) <= max(steps) <= LARGEST_HOLE:
            raise ValueError("the stamps of a rate must rise, without holes")


class TrackLatencyMemory(msgspec.Struct, frozen=True):
    """Checkpoint of a `TrackLatencyEstimator`."""

    origin: int  # stamp at which the grid begins [ns]; NEVER before the first sample
    blocks: np.ndarray[Any, Any]  # (n, 6, m) sums of the completed blocks
    open: np.ndarray[Any, Any]  # (6, m) sums of the block in progress
    turned: float  # turning in that block, by the gyro [rad]
    next_window: int  # start of the next window [ns], or NEVER
    gyro: RateMemory  # yaw rate by the gyro [rad/s]
    tracks: RateMemory  # speed of the right track less that of the left [m/s]

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
    """Samples of a rate, over the last seconds; each is the mean since the one before."""

    def __init__(self) -> None:
        self.stamps: Stamps = np.zeros(0, np.int64)  # (n,) stamps of the samples [ns]
        self._rates: Floats = np.zeros(0)

    def first_after_hole(self, stamps: Stamps) -> int:
        """First of later stamps [ns] after a hole or a clock set back, or `NO_HOLE`."""
        all_stamps = np.concatenate([self.stamps[-1:], stamps])
        steps = np.diff(all_stamps)
        are_holes = steps > LARGEST_HOLE
        if len(self.stamps):
            are_holes[:1] |= steps[:1] < -LARGEST_HOLE
        holes = np.flatnonzero(are_holes)
        return int(all_stamps[holes[0] + 1]) if len(holes) else NO_HOLE

    def add(self, stamps: Stamps, rates: Floats) -> None:
        """Add samples, without those whose stamps [ns] do not rise."""
        all_stamps = np.concatenate([self.stamps, stamps])
        values = np.concatenate([self._rates, rates])
        rises = np.ones(len(all_stamps), bool)
        rises[1:] = all_stamps[1:] > np.maximum.accumulate(all_stamps)[:-1]
        self.stamps, self._rates = all_stamps[rises][-CAPACITY:], values[rises][-CAPACITY:]

    def integral(self, begin: int, count: int) -> Floats:
        """Integral (count,) up to each point of a grid that begins at a stamp [ns]."""
        seconds, rates = (self.stamps - begin) * NANOSECOND, self._rates
        values = np.zeros(len(seconds))
        np.cumsum(np.diff(seconds) * rates[1:], out=values[1:])
        at_grid: Floats = np.interp(np.arange(count) * (GRID * NANOSECOND), seconds, values)
        return at_grid

    def drop_before(self, stamp: int) -> None:
        """Drop samples that integrals from a stamp on [ns] do not depend on."""
        first = max(0, int(np.searchsorted(self.stamps, stamp, "right")) - 1)
        self.stamps, self._rates = self.stamps[first:], self._rates[first:]

    def memory(self) -> RateMemory:
        """Checkpoint of the samples."""
        return RateMemory(self.stamps.tolist(), self._rates.tolist())

    def recall(self, memory: RateMemory) -> None:
        """Restore a checkpoint."""
        self.stamps, self._rates = np.array(memory.stamps, np.int64), np.array(memory.rates, float)


class TrackLatencyEstimator:
    """Estimator of the latency of track speeds, from completed blocks of turning."""

    def __init__(self) -> None:
        self._origin = NEVER
        self._blocks: deque[Floats] = deque(maxlen=MOST_BLOCKS)
        self._open = np.zeros((6, len(SHIFTS)))
        self._turned, self.completed = 0.0, 0
        # Number of completed blocks at the newest estimate, and that estimate.
        self._newest_estimate: tuple[int, Lag | None] = (0, None)
        self._begin()

    def take(
        self, track_stamps: Stamps, turning: Floats, gyro_stamps: Stamps, rates: Floats
    ) -> None:
        """Add later samples, at raw stamps [ns], and use the windows that they complete.

        `turning` (n,) is the speed of the right track less that of the left [m/s], in any scale; `rates`
        (m,) are yaw rates of the gyro, bias included [rad/s]. Many samples at once cost less.
        """
        hole = NEVER
        # Add the samples up to each hole in either series; windows start again after it.
        while hole != NO_HOLE:
            first_hole = self._tracks.first_after_hole(track_stamps)
            hole = min(first_hole, self._gyro.first_after_hole(gyro_stamps))
            before, gyro_before = track_stamps < hole, gyro_stamps < hole
            self._tracks.add(track_stamps[before], turning[before])
            self._gyro.add(gyro_stamps[gyro_before], rates[gyro_before])
            self._use_windows()
            if hole != NO_HOLE:
                self._begin()
                track_stamps, turning = track_stamps[~before], turning[~before]
                gyro_stamps, rates = gyro_stamps[~gyro_before], rates[~gyro_before]

    def estimate(self) -> Lag | None:
        """Estimate the lag behind the gyro; None while it is not observable."""
        completed, lag = self._newest_estimate
        if completed == self.completed:
            return lag
        lag = None
        if len(self._blocks) >= FEWEST_BLOCKS:
            # From all blocks, and from all but each one for the jackknife.
            total = np.sum(self._blocks, axis=0)
            best, *without = _best(np.stack([total, *(total - self._blocks)])).tolist()
            sigma = float(jackknife_sigma(np.array(without)))
            lag = None if math.isnan(best + sigma) else Lag(best, sigma)
        self._newest_estimate = self.completed, lag
        return lag

    def memory(self) -> TrackLatencyMemory:
        """Checkpoint of the estimator."""
        blocks, rates = np.array(self._blocks), (self._gyro.memory(), self._tracks.memory())
        in_progress = self._open.copy(), self._turned, self._next
        return TrackLatencyMemory(self._origin, blocks, *in_progress, *rates)

    def recall(self, memory: TrackLatencyMemory) -> None:
        """Restore a checkpoint."""
        self._begin()
        self._origin, self._turned = memory.origin, memory.turned
        self._blocks = deque(memory.blocks.copy(), maxlen=MOST_BLOCKS)
        self.completed = len(self._blocks)
        self._open, self._next = memory.open.copy(), memory.next_window
        self._gyro.recall(memory.gyro)
        self._tracks.recall(memory.tracks)

    def _begin(self) -> None:
        """Drop all samples and begin new windows; completed blocks are kept."""
        self._gyro, self._tracks = _Rate(), _Rate()
        self._next = NEVER

    def _use_windows(self) -> None:
        """Use the windows that both rates cover."""
        gyro, tracks, step = self._gyro, self._tracks, WINDOW_STEP * GRID
        if len(gyro.stamps) < 2 or len(tracks.stamps) < 2:
            return
        if self._origin == NEVER:
            self._origin = int(min(gyro.stamps[0], tracks.stamps[0]))
        # Windows start at multiples of a step from the origin: the first that both rates cover.
        covered_from = int(max(gyro.stamps[0], tracks.stamps[0] - EARLIEST))
        begin = max(self._next, self._origin - (self._origin - covered_from) // step * step)
        end = int(min(tracks.stamps[-1] - LATEST, gyro.stamps[-1])) - WINDOW * GRID
        windows = max(0, -((begin - end) // step))  # rounded up
        self._next = begin + windows * step
        if not windows:
            return
        starts = np.arange(windows) * WINDOW_STEP
        by_gyro = gyro.integral(begin, starts[-1] + WINDOW + 1)
        by_tracks = tracks.integral(begin + EARLIEST, starts[-1] + WINDOW + len(SHIFTS))
        gyro_turns = by_gyro[starts + WINDOW] - by_gyro[starts]
        # Row: a window; column: the same window at each of `SHIFTS`.
        track_turns = by_tracks[WINDOW:] - by_tracks[:-WINDOW]
        shifted_turns = sliding_window_view(track_turns, len(SHIFTS))[starts]
        turns = shifted_turns.any(axis=1)
        self._add(shifted_turns[turns], gyro_turns[turns])
        for rate in (gyro, tracks):
            rate.drop_before(self._next + EARLIEST)

    def _add(self, x: Floats, y: Floats) -> None:
        """Add windows: turning by the tracks (n, m), for each shift, and by the gyro (n,)."""
        while len(y):
            turned = self._turned + np.cumsum(np.abs(y)) * (WINDOW_STEP / WINDOW)
            count = int(np.searchsorted(turned, BLOCK)) + 1  # windows up to the end of the block
            block_x, block_y, ones = x[:count], y[:count], np.ones(len(SHIFTS))
            # Sums of 1, x, y, x², x y and y², for each shift.
            self._open += [
                len(block_y) * ones,
                block_x.sum(axis=0),
                block_y.sum() * ones,
                (block_x * block_x).sum(axis=0),
                block_y @ block_x,
                block_y @ block_y * ones,
            ]
            self._turned = float(turned[len(block_y) - 1])
            if count <= len(y):  # the block is complete
                self._blocks.append(self._open)
                self._open, self._turned = np.zeros((6, len(SHIFTS))), 0.0
                self.completed += 1
            x, y = x[count:], y[count:]


def _best(sums: Floats) -> Floats:
    """Shifts (k,) of the smallest misfit [s] by sums (k, 6, m); NaN if not observable."""
    n, x, y, xx, xy, yy = np.moveaxis(sums, 1, 0)
    variance = yy - y * y / n
    with np.errstate(divide="ignore", invalid="ignore"):
        misfit = variance - (xy - x * y / n) ** 2 / (xx - x * x / n)
        best_shift = np.argmin(misfit, axis=1)
        inner_shift = np.clip(best_shift, 1, len(SHIFTS) - 2)
        rows = np.arange(len(sums))
        explained = 1.0 - misfit[rows, inner_shift] / variance[rows, inner_shift]
        refined = SHIFTS[inner_shift] + beside_lowest(misfit, inner_shift) * (GRID * NANOSECOND)
    is_known = np.isfinite(misfit).all(axis=1) & (best_shift == inner_shift)
    is_known &= (variance[rows, inner_shift] > 0.0) & (explained >= LEAST_CORRELATION**2)
    return np.where(is_known, refined, np.nan)
