"""Stuck track sensors: one repeats a reading while the other's changes, or both.

Many sensors repeat readings: those sampled less often than they are published, and those of coarse
resolution at a steady speed. So repetition counts only if it lasts much longer than this track's earlier
repetitions, and if the other track has read many different values meanwhile. If both tracks repeat
themselves, it has to last for longer still: then a driver, or a bus, repeats its last message. Functions
are plain Python, also for numba.
"""

from typing import Annotated

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Size, Stamp, zeros

# Required number of different readings of the other track, and of its own before.
OTHER_READINGS, OWN_READINGS = 10, 20
SUSPICIOUS = 5  # different readings of the other track from which repetition is suspicious
UNUSUAL_FACTOR = 3.0  # repetition is unusual from this multiple of the longest before
# Least time of a repetition of both [s]; and change at its end that shows a steady speed [m/s].
LEAST_FROZEN_TIME, STEADY_CHANGE = 1.0, 0.1
OfOther = Annotated[list[float], msgspec.Meta(min_length=OTHER_READINGS, max_length=OTHER_READINGS)]


class Repeating(msgspec.Struct):
    """Repetition record of one track's readings."""

    since: Stamp = NEVER  # stamp of the first of the consecutive samples with this `reading` [ns]
    newest: Stamp = NEVER  # stamp of the last of them [ns]
    reading: float = 0.0  # newest reading [m/s]
    changes: Count = 0  # number of changes of the reading, at most `OWN_READINGS`
    longest: Size = 0.0  # longest time of one reading while moving and not stuck [s]
    # number of distinct readings of the other track since then, at most `OTHER_READINGS`
    other_count: Annotated[int, msgspec.Meta(ge=0, le=OTHER_READINGS)] = 0
    others: OfOther = zeros(OTHER_READINGS)  # those readings [m/s]; the rest is unused


def repeating_after(
    track: Repeating, stamp: int, reading: float, other: float, hold: float
) -> bool:
    """Add a sample of a track; return True if it is the first one found stuck.

    Another reading, or a gap longer than `hold` [s], starts the repetition again; the time of one that
    was not a fault counts in `longest`. Readings of this track and of the other one are in m/s.
    """
    after_gap = (stamp - track.newest) * NANOSECOND > hold
    if after_gap or reading != track.reading:
        if not after_gap:
            has_repeated = track.since != track.newest and track.reading != 0.0
            duration = (track.newest - track.since) * NANOSECOND
            is_usual = duration < LEAST_FROZEN_TIME or abs(reading - track.reading) < STEADY_CHANGE
            if has_repeated and is_usual and stuck_from(track, hold) == NEVER:
                track.longest = max(track.longest, duration)
            if track.changes < OWN_READINGS:
                track.changes += 1
        track.reading = reading
        track.since = track.newest = stamp
        track.other_count = 1
        track.others[0] = other
        return False
    was_stuck = stuck_from(track, hold) != NEVER
    track.newest = stamp
    count = track.other_count
    if count < OTHER_READINGS:
        for k in range(count):
            if track.others[k] == other:
                return False
        track.others[count] = other
        track.other_count = count + 1
    return not was_stuck and stuck_from(track, hold) != NEVER


def may_stick(track: Repeating) -> bool:
    """Return True if the reading repeats while the other track's changes."""
    return track.since != track.newest and track.other_count >= SUSPICIOUS


def reads_zero(track: Repeating) -> bool:
    """Return True if the track reads zero while the other's reading changes."""
    return may_stick(track) and track.reading == 0.0


def stuck_from(track: Repeating, hold: float) -> int:
    """Stamp from which the reading is stuck [ns]; NEVER if younger than `hold` [s]."""
    if track.other_count < OTHER_READINGS or track.changes < OWN_READINGS:
        return NEVER
    start = track.since + int(max(hold, UNUSUAL_FACTOR * track.longest) / NANOSECOND)
    return start if track.newest > start and track.reading != 0.0 else NEVER


def frozen_from(left: Repeating, right: Repeating, least: float) -> int:
    """Stamp [ns] from which both readings repeat too long; NEVER below `least` [m/s]."""
    is_at_rest = max(abs(left.reading), abs(right.reading)) < least
    if is_at_rest or left.since == left.newest or right.since == right.newest:
        return NEVER
    if min(left.changes, right.changes) < OWN_READINGS:
        return NEVER
    longest = max(LEAST_FROZEN_TIME, UNUSUAL_FACTOR * max(left.longest, right.longest))
    start = max(left.since, right.since) + int(longest / NANOSECOND)
    return start if left.newest > start else NEVER
