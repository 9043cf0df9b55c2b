"""Detector of stuck track sensors for numba: `Repeating` of `estimator.sensors` in plain numbers."""

from __future__ import annotations

import math

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.sensors.stuck_tracks import OTHERS, OWN, UNUSUAL

# What is remembered of a track, as `Repeating` has it; the readings of the other track come last.
READING, SINCE, NEWEST, CHANGES, LONGEST, COUNT, FIRST_OTHER = range(7)
STUCK_MEMORY = FIRST_OTHER + OTHERS


def begin_repeating(of: Floats, stamp: float, reading: float, other: float) -> None:
    """The first sample; `of` (STUCK_MEMORY,) is written to."""
    of[READING], of[SINCE], of[NEWEST] = reading, stamp, stamp
    of[COUNT], of[FIRST_OTHER] = 1.0, other


def repeating_after(of: Floats, stamp: float, reading: float, other: float, hold: float) -> None:
    """One more sample; see `Repeating.after`.

    Args:
        of: (STUCK_MEMORY,) changed in place.
        stamp: of the sample [ns].
        reading: of the track [m/s].
        other: of the other track [m/s].
        hold: what comes later than this does not belong together [s].
    """
    if (stamp - of[NEWEST]) * NANOSECOND > hold:
        begin_repeating(of, stamp, reading, other)
    elif reading != of[READING]:
        moved = of[SINCE] != of[NEWEST] and of[READING] != 0.0
        if moved and math.isnan(stuck_from(of, hold)):
            of[LONGEST] = max(of[LONGEST], (of[NEWEST] - of[SINCE]) * NANOSECOND)
        begin_repeating(of, stamp, reading, other)
        of[CHANGES] = min(of[CHANGES] + 1.0, OWN)
    else:
        of[NEWEST] = stamp
        count = int(of[COUNT])
        if count < OTHERS:
            for k in range(count):
                if of[FIRST_OTHER + k] == other:
                    return
            of[FIRST_OTHER + count] = other
            of[COUNT] = count + 1.0


def stuck_from(of: Floats, hold: float) -> float:
    """Stamp from which the reading is not to be trusted [ns], NaN where it is."""
    if of[SINCE] == of[NEWEST] or of[COUNT] < OTHERS or of[CHANGES] < OWN:
        return math.nan
    start = of[SINCE] + float(int(max(hold, UNUSUAL * of[LONGEST]) / NANOSECOND))
    return start if of[NEWEST] > start and of[READING] != 0.0 else math.nan
