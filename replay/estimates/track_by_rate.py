"""Effective track over the yaw rate: friction at the contacts depends on it."""

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.series import TrackSpeedSeries, running_integral
from icreckon.replay.estimates.imu_mounting import YawRates, are_usable

WINDOW = 0.5  # time over which the turning by the gyro and by the tracks is compared [s]
EDGES = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0)  # edges of the bins [rad/s]
STEADY = 0.15  # largest change of the yaw rate to neighbouring windows, over the rate [-]
FEWEST = 8  # windows that make a bin
SURE = 4.0  # standard errors between two of all bins that are a difference


class RateBin(NamedTuple):
    """Effective track at some yaw rates, to one side."""

    rate: float  # mean yaw rate by the gyro, positive to the left [rad/s]
    track: float  # effective track, V_r - V_l over the yaw rate, in the unit of `TrackByRate`
    sigma: float  # its standard error
    seconds: float  # time in the bin [s]


class TrackByRate(NamedTuple):
    """Effective track of a log."""

    whole: float  # that of the whole log
    unit: str  # unit of all tracks: "m", or what they are multiples of
    bins: tuple[RateBin, ...]  # effective track by the yaw rate, from the right to the left


def track_windows(tracks: TrackSpeedSeries, yaw_rates: YawRates, bias: float = 0.0) -> Floats:
    """Mean yaw rate [rad/s] and V_r - V_l (n, 2) in windows of steady turning.

    Windows with a hole are left out. V_r - V_l is in m/s, or in rad/s if track speeds are rates. The yaw
    rates have a `bias` [rad/s].
    """
    if not are_usable(tracks):
        return np.zeros((0, 2))
    imu, step = yaw_rates.stamps, round(WINDOW / NANOSECOND)
    first, last = max(tracks.stamps[0], imu[0]), min(tracks.stamps[-1], imu[-1])
    edges = np.arange(first, last + 1, step)
    is_used = np.ones(max(0, len(edges) - 1), bool)
    means = np.zeros((len(is_used), 2))
    series = (imu, yaw_rates.rates - bias), (tracks.stamps, tracks.difference)
    for column, (stamps, values) in enumerate(series):
        interval_at_end = np.diff(stamps, prepend=stamps[0])[np.searchsorted(stamps, edges[1:])]
        is_used &= interval_at_end < step
        integral = np.interp(edges, stamps, running_integral(stamps, values))
        means[:, column] = np.diff(integral) / WINDOW
    # Where the rate changes, what remains of a latency would count as a narrower track.
    rates = means[:, 0]
    changes = np.abs(np.diff(rates))
    is_used[1:] &= changes < STEADY * np.abs(rates[1:])
    is_used[:-1] &= changes < STEADY * np.abs(rates[:-1])
    return means[is_used]


def track_by_rate(windows: Floats) -> list[RateBin]:
    """Effective track in bins of the yaw rate, right to left, by `track_windows`."""
    bins = []
    for side in (-1.0, 1.0):
        rates, differences = side * windows.T
        for low, high in pairwise(EDGES):
            inside = (rates >= low) & (rates < high)
            if inside.sum() >= FEWEST:
                rate = float(rates[inside].mean())
                track = float(differences[inside].mean()) / rate
                residuals = differences[inside] - track * rates[inside]
                sigma = float(residuals.std(ddof=1) / np.sqrt(inside.sum()) / rate)
                bins.append(RateBin(side * rate, track, sigma, WINDOW * int(inside.sum())))
    return sorted(bins)


def extremes(bins: Sequence[RateBin]) -> tuple[RateBin, RateBin] | None:
    """Bins whose tracks differ most significantly, narrower first; None if none do."""

    def significance(pair: tuple[RateBin, RateBin]) -> float:
        """Difference in standard errors; these are zero if all windows of a bin are equal."""
        one, other = pair
        return abs(one.track - other.track) / max(1e-9, float(np.hypot(one.sigma, other.sigma)))

    pair = max(combinations(bins, 2), key=significance, default=None)
    if pair is None or significance(pair) < SURE:
        return None
    narrower, wider = sorted(pair, key=lambda rate_bin: rate_bin.track)
    return narrower, wider
