"""Receivers that repeat one position while the tracks drive on.

A receiver that lost its signal, or a driver that sends the newest position again, gives one position with
fresh stamps. A position that is measured anew differs from the one before, if only in its last digits.
"""

from __future__ import annotations

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Size, Stamp
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import Measurement, PoseFix, PositionFix

# Way of the tracks from which on a position that repeats itself is not used [m]: at most this, since
# receivers with four digits of a minute of arc resolve 0.19 m.
MOST_DRIVEN = 0.3
# After so many changes of position, at speeds above this [m/s], a receiver has shown over which way it
# repeats one while it works. From so many times this on a position is not used, and at least this [m].
LEARNT, MOVING, UNUSUAL, LEAST_DRIVEN = 20, 0.1, 4.0, 0.1


class PlaceRecord(msgspec.Struct):
    """Record of the newest position of a receiver.

    Attributes:
        x: position [m].
        y: position [m].
        stamp: stamp of the newest fix there [ns], or NEVER.
        driven: way forward by the tracks since the first fix there [m].
        longest: longest such way after which the position changed, at most `MOST_DRIVEN` [m].
        changes: number of changes of position while driving, at most `LEARNT`.
        rejected: number of fixes that were not used because they repeat a position.
    """

    x: float = 0.0
    y: float = 0.0
    stamp: Stamp = NEVER
    driven: float = 0.0
    longest: Size = 0.0
    changes: Count = 0
    rejected: Count = 0


def repeats(positions: PlaceRecord, poses: PlaceRecord, m: Measurement, speed: float) -> bool:
    """Add a measurement; return True for a fix that repeats a position while driving.

    Args:
        positions: newest place of the position fixes, changed in place.
        poses: newest place of the pose fixes, changed in place.
        m: the measurement.
        speed: forward speed by the tracks [m/s]; noise of resting ones adds up to nothing.
    """
    if not isinstance(m, PositionFix | PoseFix):
        return False
    place = positions if isinstance(m, PositionFix) else poses
    same = place.stamp != NEVER and m.x == place.x and m.y == place.y
    if same:
        place.driven += speed * (m.stamp - place.stamp) * NANOSECOND
    elif place.stamp != NEVER:
        if abs(place.driven) <= MOST_DRIVEN and abs(speed) > MOVING:
            place.longest = max(place.longest, abs(place.driven))
            place.changes = min(LEARNT, place.changes + 1)
        place.driven = 0.0
    place.x, place.y, place.stamp = m.x, m.y, m.stamp
    found = abs(place.driven) > most_driven(place)
    place.rejected += found
    return found


def most_driven(place: PlaceRecord) -> float:
    """Longest way over which a receiver that works may repeat a position [m]."""
    if place.changes < LEARNT:
        return MOST_DRIVEN
    return min(MOST_DRIVEN, max(LEAST_DRIVEN, UNUSUAL * place.longest))


def may_repeat(log: Log) -> bool:
    """Return True if a log may hold fixes that repeat a position while driving."""
    if log.fixes is None or len(log.fixes.stamps) < 2:
        return False
    places, stamps = log.fixes.poses[:, :2], log.fixes.stamps
    same = (places[1:] == places[:-1]).all(axis=1)
    if not same.any():
        return False
    speed = float(np.abs(log.tracks.speeds).max(initial=0.0))
    # The longest time at one place, at the highest speed.
    changes = np.flatnonzero(np.concatenate([[True], ~same, [True]]))
    stays = stamps[changes[1:] - 1] - stamps[changes[:-1]]
    return not speed * float(stays.max()) * NANOSECOND <= LEAST_DRIVEN
