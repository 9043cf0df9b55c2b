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
from typing import Any, NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.lag_search import beside_lowest, jackknife_sigma

SHIFTS = np.arange(-0.3, 0.8, 0.02)
"""Grid of candidate latencies [s]."""
LATEST = float(SHIFTS[-1])
"""Largest of them [s]."""
WINDOW, WINDOW_STEP = 1.0, 0.1
"""Length and spacing of the windows [s]."""
BLOCK = 1.25
"""Turning that closes a block, by the gyro [rad]."""
FEWEST_BLOCKS, MOST_BLOCKS = 4, 32
"""Numbers of blocks at which there is an estimate, and from which the oldest is dropped."""
LARGEST_HOLE = 0.5
"""Gap between samples at which the windows begin anew [s]."""
LEAST_CORRELATION = 0.7
"""Smallest correlation of tracks and gyro at which there is an estimate [-]."""
CAPACITY = 4096
"""Number of samples that are kept to integrate over the windows: 10 s at 400 Hz."""
AT_ONCE = 10
"""Number of windows that are used at once, which costs less."""
LONGEST_BEHIND = 1000.0
"""Age, at the newest sample, beyond which no window is used [s]."""
OBSOLETE = 256
"""Number of samples before the next window at which they are dropped."""


class TrackLatency(NamedTuple):
    """Latency of the track speeds behind the gyro, and its standard error [s]."""

    seconds: float
    sigma: float


class AngleMemory(msgspec.Struct, frozen=True):
    """Checkpoint of an angle that is integrated from samples.

    Attributes:
        seconds: (n,) times of the samples [s].
        values: (n,) angles, or distances.
        rate: newest rate.
    """

    seconds: np.ndarray[Any, Any]
    values: np.ndarray[Any, Any]
    rate: float

    def __post_init__(self) -> None:
        shape = self.seconds.shape
        if self.values.shape != shape or len(shape) != 1 or len(self.seconds) > CAPACITY:
            raise ValueError(f"an angle needs a time for each value, {CAPACITY} at most")
        if (np.diff(self.seconds) <= 0.0).any():
            raise ValueError("the times of an angle must rise")


class TrackLatencyMemory(msgspec.Struct, frozen=True):
    """Checkpoint of a `TrackLatencyEstimator`.

    Attributes:
        origin: stamp at which its seconds begin [ns], or None before the first sample.
        blocks: (n, 6, m) sums of the completed blocks.
        open: (6, m) sums of the block under way.
        turned: turning in it [rad].
        next_window: start of the next window [s], or None.
        gyro: yaw by the gyro.
        tracks: way of the right track less that of the left.
    """

    origin: int | None
    blocks: np.ndarray[Any, Any]
    open: np.ndarray[Any, Any]
    turned: float
    next_window: float | None
    gyro: AngleMemory
    tracks: AngleMemory

    def __post_init__(self) -> None:
        of_block = (6, len(SHIFTS))
        count = len(self.blocks)
        if count > MOST_BLOCKS or self.blocks.shape != ((count, *of_block) if count else (0,)):
            raise ValueError(
                f"blocks of turning need {of_block} sums each, and are {MOST_BLOCKS} at most"
            )
        if self.open.shape != of_block:
            raise ValueError(f"the block of turning under way needs {of_block} sums")


class _Angle:
    """Angle integrated from samples of a rate, over the last seconds.

    Args:
        held: whether a rate holds until the next sample; otherwise it changes steadily in between.
    """

    def __init__(self, *, held: bool) -> None:
        self.seconds: list[float] = []
        self.values: list[float] = []
        self.newest = -math.inf
        self._value, self._held, self._rate = 0.0, held, 0.0

    def take(self, second: float, rate: float) -> bool:
        """Add a sample; return False, and do not, if there is a hole before it."""
        seconds = self.seconds
        if seconds:
            step = second - self.newest
            if not 0.0 < step <= LARGEST_HOLE:
                return -LARGEST_HOLE <= step <= 0.0
            self._value += step * (self._rate if self._held else 0.5 * (self._rate + rate))
            if len(seconds) >= CAPACITY:
                del seconds[: CAPACITY // 2], self.values[: CAPACITY // 2]
        seconds.append(second)
        self.values.append(self._value)
        self.newest, self._rate = second, rate
        return True

    def at(self, seconds: Floats) -> Floats:
        """Angles at some times."""
        return np.interp(seconds, self.seconds, self.values)

    def drop_before(self, second: float) -> None:
        """Drop samples that angles from a time on do not depend on, once there are many."""
        first = bisect_right(self.seconds, second) - 1
        if first >= OBSOLETE:
            del self.seconds[:first], self.values[:first]

    def memory(self) -> AngleMemory:
        """Checkpoint of the angle."""
        return AngleMemory(np.array(self.seconds), np.array(self.values), self._rate)

    def recall(self, memory: AngleMemory) -> None:
        """Restore a checkpoint."""
        self.seconds, self.values = memory.seconds.tolist(), memory.values.tolist()
        self._rate = memory.rate
        if self.seconds:
            self.newest, self._value = self.seconds[-1], self.values[-1]


class TrackLatencyEstimator:
    """Estimator of the latency of track speeds, from samples in the order of arrival."""

    def __init__(self) -> None:
        self._origin: int | None = None
        self._blocks: deque[Floats] = deque(maxlen=MOST_BLOCKS)
        self._open = np.zeros((6, len(SHIFTS)))
        self._turned = 0.0
        self._next: float | None
        self._begin()

    def take_tracks(self, stamp: int, left: float, right: float) -> bool:
        """Add track speeds.

        Args:
            stamp: raw stamp [ns].
            left: left track [m/s], in any scale.
            right: right track.

        Returns:
            True if a block was completed, so that the estimate may have changed.
        """
        second = self._second(stamp)
        if not self._tracks.take(second, right - left):
            self._begin()
            self._tracks.take(second, right - left)
        return self._use_windows(second)

    def take_gyro(self, stamp: int, yaw_rate: float) -> None:
        """Add a yaw rate.

        Args:
            stamp: raw stamp [ns].
            yaw_rate: by the gyro, its bias included [rad/s].
        """
        second = self._second(stamp)
        if not self._gyro.take(second, yaw_rate):
            self._begin()
            self._gyro.take(second, yaw_rate)

    def estimate(self) -> TrackLatency | None:
        """Estimate the latency; None while it is not observable."""
        if len(self._blocks) < FEWEST_BLOCKS:
            return None
        blocks = np.array(self._blocks)
        total = blocks.sum(axis=0)
        best = _best(total)
        if best is None:
            return None
        parts = [_best(total - block) for block in blocks]
        values = np.array([part for part in parts if part is not None])
        if len(values) < len(parts):
            return None
        return TrackLatency(best, jackknife_sigma(values))

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
        self._origin, self._turned = memory.origin, memory.turned
        self._blocks = deque(memory.blocks.copy(), maxlen=MOST_BLOCKS)
        self._open, self._next = memory.open.copy(), memory.next_window
        self._gyro.recall(memory.gyro)
        self._tracks.recall(memory.tracks)
        if self._next is not None and self._tracks.seconds:
            # No window of long ago is used any more, and stepping there would take hours.
            self._next = max(self._next, self._tracks.newest - LONGEST_BEHIND)

    def _second(self, stamp: int) -> float:
        if self._origin is None:
            self._origin = stamp
        return (stamp - self._origin) * NANOSECOND

    def _begin(self) -> None:
        """Begin new windows; completed blocks stay."""
        self._gyro, self._tracks = _Angle(held=False), _Angle(held=True)
        self._next = None

    def _use_windows(self, newest: float) -> bool:
        """Use windows that both angles cover; return True if a block was completed."""
        gyro, tracks = self._gyro, self._tracks
        if self._next is None:
            if len(gyro.seconds) < 2 or len(tracks.seconds) < 2:
                return False
            first = max(gyro.seconds[0], tracks.seconds[0] - SHIFTS[0])
            self._next = math.ceil(first / WINDOW_STEP) * WINDOW_STEP
        end = min(newest - LATEST, gyro.newest)
        if self._next + WINDOW + AT_ONCE * WINDOW_STEP > end:
            return False
        starts = np.arange(self._next, end - WINDOW, WINDOW_STEP)
        self._next = float(starts[-1]) + WINDOW_STEP
        turned = gyro.at(starts + WINDOW) - gyro.at(starts)
        shifted = starts[:, None] + SHIFTS
        driven = tracks.at(shifted + WINDOW) - tracks.at(shifted)
        completed = False
        for y, x in zip(turned.tolist(), driven, strict=True):
            if x.any():  # not standing
                completed |= self._use_window(x, y)
        for angle in (gyro, tracks):
            angle.drop_before(self._next + SHIFTS[0])
        return completed

    def _use_window(self, x: Floats, y: float) -> bool:
        """Add a window's turning by the tracks, for each shift, and by the gyro."""
        one = np.ones(len(SHIFTS))
        self._open += np.array([one, x, y * one, x * x, x * y, y * y * one])
        self._turned += abs(y) * WINDOW_STEP / WINDOW
        if self._turned < BLOCK:
            return False
        self._blocks.append(self._open)
        self._open, self._turned = np.zeros((6, len(SHIFTS))), 0.0
        return True


def _best(sums: Floats) -> float | None:
    """Shift of the smallest misfit, refined by a parabola; None if not observable."""
    n, x, y, xx, xy, yy = sums
    variance = yy - y * y / n
    with np.errstate(divide="ignore", invalid="ignore"):
        misfit = variance - (xy - x * y / n) ** 2 / (xx - x * x / n)
    if not np.isfinite(misfit).all():
        return None
    at = int(np.argmin(misfit))
    if at in (0, len(SHIFTS) - 1) or variance[at] <= 0.0:
        return None
    if 1.0 - misfit[at] / variance[at] < LEAST_CORRELATION**2:
        return None
    return float(SHIFTS[at] + beside_lowest(misfit, at) * (SHIFTS[1] - SHIFTS[0]))
