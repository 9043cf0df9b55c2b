"""Interpolation of track speeds that a logger repeated until the next message.

A driver that is slower than its log leaves steps in the track speeds, while the robot changed its speed
gradually. To a filter they look like slip. After the fact the next value is known, so that the speeds
between can be interpolated. A robot that is driven live has no next value.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.replay.mapping.track_units import Held

LONGEST_HOLD = 0.5
"""Longest usual time of one value that counts as a logger's doing [s]."""
FEWEST_VALUES = 20
"""Least number of values of a moving track that show how long each is held."""
REPEATED, REGULAR = 0.75, 0.85
"""Least share of values that are repeated, and of those held as long as usual, to a sample."""
ELSEWHERE = 0.8
"""Least share of the repetitions during which the gyro or the other track reads something new."""
STEADY = 1.5
"""A value that lasts longer than this multiple of the usual time was read again unchanged."""
HOLE = 1.0
"""A longer gap between samples is not bridged [s]."""


class _Runs(NamedTuple):
    """Values of one track, each with its repetitions."""

    first: NDArray[np.int64]  # (r,) index of the first sample of each value
    ends: NDArray[np.int64]  # (r,) index of the first sample of the next value, or of the end
    lasts: Floats  # (r,) time until the next value [s]; NaN before a hole and for the last one


def without_holding(log: Log, held: Held) -> Log:
    """Log with held track speeds interpolated and a note; the same log if none are.

    Args:
        log: the log.
        held: "auto" for those whose repetitions are regular while something else changes, "interpolate"
            for all, "keep" for none.
    """
    stamps, speeds = log.tracks.stamps, log.tracks.speeds
    if held == "keep" or len(stamps) < 3:
        return log
    usual = [_usual_hold(log, side, held) for side in range(2)]
    if not any(usual):
        return log
    tracks = log.tracks
    changed, wheels = speeds.copy(), [tracks.left_wheels, tracks.right_wheels]
    for side, hold in enumerate(usual):
        if hold is None:
            continue
        changed[:, side] = _interpolated(stamps, speeds[:, side], hold)
        of_side = wheels[side]
        if of_side is not None:
            lines = [_interpolated(stamps, one, hold) for one in of_side.T]
            wheels[side] = np.column_stack(lines)
    longest = max(hold for hold in usual if hold is not None)
    note = (
        f"track speeds change only {1.0 / longest:.0f} times a second, and are repeated in between: the "
        "repetitions are replaced by interpolation, which the live node cannot do; "
        '`held = "keep"` in the robot file leaves them, as the node does'
    )
    tracks = TrackSpeedSeries(stamps, changed, *wheels)
    return replace(log, tracks=tracks, notes=(*log.notes, note))


def _usual_hold(log: Log, side: int, held: Held) -> float | None:
    """Time for which each value of a track is held [s], or None if they are not held."""
    stamps, speeds = log.tracks.stamps, log.tracks.speeds
    runs = _runs(stamps, speeds[:, side])
    moving = (speeds[runs.first, side] != 0.0) & np.isfinite(runs.lasts)
    lasts, counts = runs.lasts[moving], (runs.ends - runs.first)[moving]
    if not len(lasts):
        return None
    usual, step = float(np.median(lasts)), float(np.median(np.diff(stamps))) * NANOSECOND
    if held == "interpolate":
        return usual
    steady = lasts > STEADY * usual + step
    as_usual = np.abs(lasts - usual) <= 1.01 * step
    plain = (
        len(lasts) >= FEWEST_VALUES
        and usual <= LONGEST_HOLD
        and np.mean(counts > 1) >= REPEATED
        and np.mean(as_usual[~steady]) >= REGULAR
        and np.mean(steady) <= 1.0 - REPEATED
    )
    if not plain:
        return None
    repeats = np.flatnonzero((np.diff(speeds[:, side]) == 0.0) & (speeds[1:, side] != 0.0))
    elsewhere = np.diff(speeds[:, 1 - side])[repeats] != 0.0
    if log.imu is not None:
        elsewhere |= _gyro_changes(log.imu, stamps[repeats], stamps[repeats + 1])
    return usual if np.mean(elsewhere) >= ELSEWHERE else None


def _gyro_changes(imu: ImuSeries, begins: Stamps, ends: Stamps) -> NDArray[np.bool_]:
    """Mask (n,) of the intervals in which the gyro reads something new."""
    new = np.any(np.diff(imu.angular_velocity, axis=0) != 0.0, axis=1)
    many = np.concatenate([[0, 0], np.cumsum(new)])
    low = np.searchsorted(imu.stamps, begins, side="right")
    high = np.searchsorted(imu.stamps, ends, side="right")
    return np.asarray(many[high] > many[low])


def _runs(stamps: Stamps, values: Floats) -> _Runs:
    apart = np.diff(stamps) * NANOSECOND
    new = (np.diff(values) != 0.0) | (apart > HOLE)
    first = np.concatenate([[0], np.flatnonzero(new) + 1])
    ends = np.concatenate([first[1:], [len(values)]])
    lasts = np.full(len(first), np.nan)
    lasts[:-1] = (stamps[first[1:]] - stamps[first[:-1]]) * NANOSECOND
    before_hole = np.flatnonzero(apart[first[1:] - 1] > HOLE)
    lasts[before_hole] = np.nan
    return _Runs(first, ends, lasts)


def _interpolated(stamps: Stamps, values: Floats, hold: float) -> Floats:
    """Values at all samples, on straight lines between the middles of values.

    A value counts for the middle of the time for which it is usually held, as it did on average before.
    So the latency of the speeds is the same with and without repetitions. A value that lasts longer was
    read again unchanged: it stays in between. So standstills, steady speeds and stuck sensors stay.
    """
    runs = _runs(stamps, values)
    seconds = (stamps - stamps[0]) * NANOSECOND
    at, first, last = values[runs.first], seconds[runs.first], seconds[runs.ends - 1]
    half = 0.5 * max(hold - float(np.median(np.diff(seconds))), 0.0)
    whole = np.isfinite(runs.lasts)
    begins_anew = np.concatenate([[True], ~whole[:-1]])
    begin = np.where(begins_anew, first, np.minimum(first + half, last))
    end = np.where(whole, first + runs.lasts - hold + half, last)
    stays = (end > begin) & (~whole | begins_anew | (runs.lasts > STEADY * hold))
    knots = np.concatenate([begin, end[stays]])
    order = np.argsort(knots, kind="stable")
    lines = np.interp(seconds, knots[order], np.concatenate([at, at[stays]])[order])
    return np.asarray(lines, dtype=float)
