"""Wheels of each side: their mean, and those that disagree."""

from collections.abc import Sequence

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.faults.odd_wheels import AGREEMENT_TIME, LEAST_ODD_DISTANCE, least_apart
from icreckon.estimator.log.series import TrackSpeedSeries

OPPOSITE = 0.1  # wheels with a smaller sum, over that of their sizes, turn opposite ways [-]
TOGETHER = 0.5  # longest time between two messages of a wheel, between which it is interpolated [s]


def mean_of_sides(values: Floats, left_count: int) -> Floats:
    """Means (n, 2) of the values (n, k) of the left and the right wheels."""
    left, right = values[:, :left_count], values[:, left_count:]
    return np.column_stack([left.mean(axis=1), right.mean(axis=1)])


def interpolated(
    stamps: Stamps, values: Floats, wrap: float | None, slowest: int | None = None
) -> tuple[Stamps, Floats]:
    """Interpolate wheels with separate messages at the stamps of the slowest wheel.

    Args:
        stamps: (n,) rising stamps of all messages [ns].
        values: (n, k) value of each wheel in each message, NaN for wheels that the message lacks.
        wrap: value at which counters begin again; None for values that do not.
        slowest: column of the slowest wheel; by default the one with the fewest values.

    Returns:
        Stamps between two messages of each wheel at most `TOGETHER` apart, and values. If a message has
        all wheels, or a wheel has no message, stamps and values are unchanged.
    """
    known = ~np.isnan(values)
    if not len(values) or known.all(axis=1).any() or not known.any(axis=0).all():
        return stamps, values
    if slowest is None:
        slowest = int(known.sum(axis=0).argmin())
    common = stamps[known[:, slowest]]
    is_bridged, columns = np.ones(len(common), bool), []
    for column, has_value in zip(values.T, known.T, strict=True):
        wheel_stamps, readings = stamps[has_value], column[has_value]
        if wrap is not None:
            readings = np.unwrap(readings, period=wrap)
        # Messages of this wheel about each common stamp; one at the stamp itself is on both sides.
        next_row = np.searchsorted(wheel_stamps, common).clip(max=len(wheel_stamps) - 1)
        last_row = (next_row - (wheel_stamps[next_row] > common)).clip(min=0)
        after, before = wheel_stamps[next_row], wheel_stamps[last_row]
        is_bridged &= (before <= common) & (common <= after)
        is_bridged &= (after - before) * NANOSECOND <= TOGETHER
        columns.append(np.interp(common - common[0], wheel_stamps - common[0], readings))
    return common[is_bridged], np.column_stack(columns)[is_bridged]


def of_sides(
    stamps: Stamps, speeds: Floats, left_count: int, names: Sequence[str], fastest: float
) -> tuple[TrackSpeedSeries, list[str]]:
    """Compute track speeds as the means of the wheels of each side, and notes on them.

    `speeds` (n, k) are those of `left_count` left wheels, then of the right ones [m/s], at rising stamps
    (n,) [ns]; `names` (k,) are the wheels', `fastest` is the highest speed of a track [m/s]. If any
    wheels of a side disagree, the track speeds include those of the wheels, and the notes name the odd
    ones.
    """
    means = mean_of_sides(speeds, left_count)
    left, right = speeds[:, :left_count], speeds[:, left_count:]
    disagree = [_spread(wheels) > least_apart(fastest) for wheels in (left, right)]
    if not np.any(disagree):
        return TrackSpeedSeries(stamps, means), []
    intervals = np.minimum(np.diff(stamps, prepend=stamps[:1]) * NANOSECOND, AGREEMENT_TIME)
    notes = []
    sides = ("left", left, names[:left_count]), ("right", right, names[left_count:])
    for (side, wheels, wheel_names), is_apart in zip(sides, disagree, strict=True):
        if (_spread(wheels) * intervals)[is_apart].sum() >= LEAST_ODD_DISTANCE:
            seconds = float(intervals[is_apart].sum())
            notes.append(
                f"wheels of the {side} side disagree for {seconds:.1f} s: "
                + _odd_wheel_text(wheels[is_apart], wheel_names)
            )
    return TrackSpeedSeries(stamps, means, left, right), notes


def _spread(wheels: Floats) -> Floats:
    """Fastest wheel (n,) less the slowest, of speeds (n, k) [m/s]."""
    return np.ptp(wheels, axis=1) if wheels.shape[1] else np.zeros(len(wheels))


def _odd_wheel_text(wheels: Floats, names: Sequence[str]) -> str:
    """Text on the wheel that differs most from the others, by speeds (n, k) [m/s]."""
    if len(names) == 2:
        first, second = names
        difference = float(_spread(wheels).max())
        opposite = np.abs(wheels.sum(axis=1)).sum() < OPPOSITE * np.abs(wheels).sum()
        hint = f', and turn opposite ways: name a reversed one "-{second}"' if opposite else ""
        return f"{first} and {second} are up to {difference:.2f} m/s apart{hint}"
    deviations = np.abs(wheels - np.median(wheels, axis=1, keepdims=True))
    odd = int(deviations.sum(axis=0).argmax())
    return f"{names[odd]} is up to {deviations[:, odd].max():.2f} m/s off"
