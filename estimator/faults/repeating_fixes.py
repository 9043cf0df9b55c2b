"""Receivers that repeat one position while the tracks drive on.

A receiver that lost its signal, or a driver that sends the newest position again, gives one position with
fresh stamps. A position that is measured again differs from the one before, if only in its last digits.
Functions are plain Python, also for numba.
"""

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Size, Stamp

# Distance of the tracks from which on a position that repeats itself is not used [m]: at most this, since
# receivers with four digits of a minute of arc resolve 0.19 m.
MOST_DRIVEN = 0.3
# After this many changes of position, at speeds above this [m/s], a receiver has shown over which
# distance it repeats one while it works. From this multiple of it on a position is not used, and at
# least this [m].
ENOUGH_CHANGES, MOVING, UNUSUAL_FACTOR, LEAST_DRIVEN = 20, 0.1, 4.0, 0.1


class PlaceRecord(msgspec.Struct):
    """Record of the newest position of a receiver."""

    x: float = 0.0  # position [m]
    y: float = 0.0  # position [m]
    stamp: Stamp = NEVER  # stamp of the newest fix there [ns], or NEVER
    driven: float = 0.0  # way forward by the tracks since the first fix there [m]
    longest: Size = 0.0  # longest such way before a change, up to `MOST_DRIVEN` [m]
    changes: Count = 0  # number of changes of position while driving, at most `ENOUGH_CHANGES`
    rejected: Count = 0  # number of fixes that were not used because they repeat a position


def repeats(place: PlaceRecord, stamp: int, x: float, y: float, speed: float) -> bool:
    """Add a fix [ns, m, m]; return True if it repeats a position while driving.

    `speed` is forward, by the tracks [m/s]: noise of resting ones adds up to nothing.
    """
    is_same = place.stamp != NEVER and x == place.x and y == place.y
    if is_same:
        place.driven += speed * (stamp - place.stamp) * NANOSECOND
    elif place.stamp != NEVER:
        if abs(place.driven) <= MOST_DRIVEN and abs(speed) > MOVING:
            place.longest = max(place.longest, abs(place.driven))
            place.changes = min(ENOUGH_CHANGES, place.changes + 1)
        place.driven = 0.0
    place.x, place.y, place.stamp = x, y, stamp
    is_repeated = abs(place.driven) > most_driven(place)
    place.rejected += is_repeated
    return is_repeated


def most_driven(place: PlaceRecord) -> float:
    """Longest way over which a receiver that works may repeat a position [m]."""
    if place.changes < ENOUGH_CHANGES:
        return MOST_DRIVEN
    return min(MOST_DRIVEN, max(LEAST_DRIVEN, UNUSUAL_FACTOR * place.longest))
