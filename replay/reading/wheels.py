"""Wheels of each side: their mean, and those that disagree."""

from collections.abc import Sequence

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.faults.odd_wheels import AGREEMENT_TIME, LEAST_ODD_DISTANCE, least_apart
from icreckon.estimator.log.series import TrackSpeedSeries

OPPOSITE = 0.1
"""Sum of two wheels, over their sizes, of which one counts backward [-]."""
TOGETHER = 0.5
"""Longest time between two messages of a wheel, between which it is interpolated [s]."""


def mean_of_sides(values: Floats, left: int) -> Floats:
    """Means (n, 2) of the values (n, k) of the left and the right side."""
    return np.column_stack([values[:, :left].mean(axis=1), values[:, left:].mean(axis=1)])


def interpolated(
    stamps: Stamps, values: Floats, wrap: float | None, slowest: int | None = None
) -> tuple[Stamps, Floats]:
    """Interpolate wheels with messages of their own at the stamps of the slowest.

    `values` (n, k) are NaN for wheels that a message lacks, `wrap` is the value at which counters begin
    again, `slowest` the column of the slowest wheel (default: that with the fewest values). Stamps [ns]
    and values are returned unchanged if any message has all wheels, or a wheel has no value; otherwise
    without rows in a gap of a wheel, of more than `TOGETHER`.
    """
    known = ~np.isnan(values)
    if not len(values) or known.all(axis=1).any() or not known.any(axis=0).all():
        return stamps, values
    at = stamps[known[:, known.sum(axis=0).argmin() if slowest is None else slowest]]
    whole, columns = np.ones(len(at), bool), []
    for column, there in zip(values.T, known.T, strict=True):
        own_stamps, own_values = stamps[there], column[there]
        if wrap is not None:
            own_values = np.unwrap(own_values, period=wrap)
        after = np.searchsorted(own_stamps, at).clip(max=len(own_stamps) - 1)
        before = (after - (own_stamps[after] > at)).clip(min=0)
        whole &= (own_stamps[before] <= at) & (at <= own_stamps[after])
        whole &= (own_stamps[after] - own_stamps[before]) * NANOSECOND <= TOGETHER
        columns.append(np.interp(at - at[0], own_stamps - at[0], own_values))
    return at[whole], np.column_stack(columns)[whole]


def of_sides(
    stamps: Stamps, speeds: Floats, left: int, names: Sequence[str], fastest: float
) -> tuple[TrackSpeedSeries, list[str]]:
    """Mean track speeds of the wheels of each side; wheels that disagree are noted.

    Args:
        stamps: (n,) [ns], rising.
        speeds: (n, k) of the left wheels, then of the right ones [m/s].
        left: number of the left ones.
        names: (k,) names of the wheels.
        fastest: highest speed of a track [m/s].

    Returns:
        Track speeds, with those of the wheels if any disagree, and notes on wheels that do.
    """
    means = mean_of_sides(speeds, left)
    wheels = speeds[:, :left], speeds[:, left:]
    disagree = [_range(one) > least_apart(fastest) for one in wheels]
    if not (disagree[0].any() or disagree[1].any()):
        return TrackSpeedSeries(stamps, means), []
    intervals = np.minimum(np.diff(stamps, prepend=stamps[:1]) * NANOSECOND, AGREEMENT_TIME)
    notes = []
    sides = zip(("left", "right"), wheels, disagree, (names[:left], names[left:]), strict=True)
    for side, of_side, odd, of_names in sides:
        if (_range(of_side) * intervals)[odd].sum() >= LEAST_ODD_DISTANCE:
            seconds = float(intervals[odd].sum())
            notes.append(
                f"wheels of the {side} side disagree for {seconds:.1f} s: "
                + _which(of_side[odd], of_names)
            )
    return TrackSpeedSeries(stamps, means, *wheels), notes


def _range(wheels: Floats) -> Floats:
    """Distance (n,) of the fastest wheel from the slowest [m/s]."""
    return np.ptp(wheels, axis=1) if wheels.shape[1] else np.zeros(len(wheels))


def _which(wheels: Floats, names: Sequence[str]) -> str:
    """Text on the wheel that is furthest from the others, by samples (n, k)."""
    if len(names) == 2:
        apart = float(_range(wheels).max())
        opposite = np.abs(wheels.sum(axis=1)).sum() < OPPOSITE * np.abs(wheels).sum()
        hint = f', and turn opposite ways: name a reversed one "-{names[1]}"' if opposite else ""
        return f"{names[0]} and {names[1]} are up to {apart:.2f} m/s apart{hint}"
    off = np.abs(wheels - np.median(wheels, axis=1, keepdims=True))
    odd = int(off.sum(axis=0).argmax())
    return f"{names[odd]} is up to {off[:, odd].max():.2f} m/s off"
