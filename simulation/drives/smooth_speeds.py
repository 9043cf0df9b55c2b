"""Track speeds with continuous speed and acceleration, as functions of time.

Every function stands still for the duration `STANDSTILL` [s] first, and keeps each track's acceleration
within `ACCELERATION` [m/s²]. No blend is shorter than `SHORTEST_BLEND` [s].
"""

from dataclasses import dataclass

import numpy as np

from icreckon.estimator.base.array_types import Floats

STANDSTILL = 3.0
ACCELERATION = 1.0
# Highest slope of the quintic blend 6 x^5 - 15 x^4 + 10 x^3.
STEEPEST = 1.875
SHORTEST_BLEND = 0.2


@dataclass(frozen=True)
class Blends:
    """Constant speeds joined by quintic blends, with continuous acceleration."""

    starts: Floats  # (k,) start of each blend [s], ascending
    lengths: Floats  # (k,) duration of each blend [s]; it ends before the next one starts
    targets: Floats  # (k, 2) left and right speed after each blend [m/s]; zero before the first one

    def __call__(self, times: Floats) -> Floats:
        """Track speeds (n, 2) [m/s] at times (n,) [s]."""
        newest = np.searchsorted(self.starts, times, side="right") - 1
        has_begun = newest >= 0
        newest = np.maximum(newest, 0)
        before = np.vstack([np.zeros((1, 2)), self.targets])[newest]
        share = smooth_step((times - self.starts[newest]) / self.lengths[newest])[:, None]
        speeds = before + share * (self.targets[newest] - before)
        return np.where(has_begun[:, None], speeds, 0.0)

    @property
    def top_speed(self) -> float:
        """Highest speed of a track, forward or backward [m/s]."""
        return float(np.abs(self.targets).max())


@dataclass(frozen=True)
class Slalom:
    """Mean speed plus a cosine of opposite sign on each track, of rising frequency."""

    mean: float  # mean speed of the tracks [m/s]
    swing: float  # amplitude of half their difference [m/s]
    ramp: float  # seconds that mean and swing take to grow from zero
    lowest: float  # frequency at the start [Hz]
    highest: float  # frequency after `rise`, reached linearly [Hz]
    rise: float  # seconds from the lowest to the highest frequency

    def __call__(self, times: Floats) -> Floats:
        """Track speeds (n, 2) [m/s] at times (n,) [s]."""
        elapsed = np.maximum(times - STANDSTILL, 0.0)
        rising = np.minimum(elapsed, self.rise)
        cycles = (
            self.lowest * rising
            + 0.5 * (self.highest - self.lowest) * rising**2 / self.rise
            + self.highest * (elapsed - rising)
        )
        envelope = smooth_step(elapsed / self.ramp)
        half_difference = self.swing * np.cos(2.0 * np.pi * cycles)
        speeds = np.stack([self.mean - half_difference, self.mean + half_difference], axis=-1)
        return envelope[:, None] * speeds

    @property
    def top_speed(self) -> float:
        """Highest speed of a track, forward or backward [m/s]."""
        return abs(self.mean) + abs(self.swing)


def blends(events: list[tuple[float, float, float]]) -> Blends:
    """Make blends from (start [s], left, right [m/s]), at the acceleration limit."""
    table = np.array(events, dtype=float)
    targets = table[:, 1:]
    changes = np.abs(np.diff(targets, axis=0, prepend=np.zeros((1, 2)))).max(axis=1)
    return Blends(table[:, 0], np.array([blend_duration(change) for change in changes]), targets)


def blend_duration(change: float) -> float:
    """Duration [s] of a blend that changes a speed by `change`, up or down [m/s]."""
    return max(STEEPEST * abs(change) / ACCELERATION, SHORTEST_BLEND)


def smooth_step(x: Floats) -> Floats:
    """Smooth step: 0 below 0, 1 above 1, a quintic with continuous curvature between."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 + x * (6.0 * x - 15.0)))
