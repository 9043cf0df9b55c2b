"""Spinning tracks: one track turns free, so the tracks turn faster than the gyro.

A track that loses its grip speeds up, while the robot does not turn as both tracks then ask for. Slip in
bends is a share of the turning; a free track is beyond any share. The track that changed its speed when
the mismatch began is the one that spins. A track sensor that fails looks the same. The flag does not act
on the filter: on rolling ground a false alarm would cost more than a spin.

The functions are written for plain Python and for numba, see `estimator.base.records`.
"""

from __future__ import annotations

import math

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER

LEFT, NEITHER, RIGHT = -1, 0, 1
# Turning of the tracks that slip explains, as multiples of what the robot's own bends have shown.
LEAST_TURNING, MOST_TURNING = 0.6, 1.7
# Turning after which the robot's own bends count, and over which they are forgotten [rad].
ENOUGH, MEMORY = 3.0, 20.0
# Longest interval between samples of the gyro that counts as turning [s].
LONGEST = 0.1
# Mismatch of the track speeds beyond that which counts: this much, or this share of the fastest speed.
LEAST_MISMATCH, OF_FASTEST = 0.25, 0.1
# Time for which it must last, and time without it after which the track grips again [s].
LASTS, OVER = 0.2, 0.2
# A mismatch below this share of the one that counts is none, once a track spins.
GONE = 0.5


class SpinRecord(msgspec.Struct):
    """Record of a spinning track.

    Attributes:
        left: newest reading of the left track [m/s].
        right: newest reading of the right track [m/s].
        rate: newest yaw rate by the gyro [rad/s].
        mismatch: newest difference of the track speeds that no slip in bends explains [m/s].
        side: `LEFT` or `RIGHT`, the track that changed when the mismatch began; or `NEITHER`.
        since: stamp at which the mismatch began [ns], or NEVER.
        newest: stamp of the newest mismatch [ns], or NEVER.
        found: 1 while a track is found spinning.
        times: number of times that one was found.
        stamp: stamp of the newest sample of the gyro [ns], or NEVER.
        turned: turning so far, with forgetting [rad].
        by_rate: sum of the tracks' difference times the yaw rate [m/s rad/s].
        of_rate: sum of the yaw rate squared [rad²/s²].
    """

    left: float = 0.0
    right: float = 0.0
    rate: float = 0.0
    mismatch: float = 0.0
    side: int = NEITHER
    since: int = NEVER
    newest: int = NEVER
    found: int = 0
    times: int = 0
    stamp: int = NEVER
    turned: float = 0.0
    by_rate: float = 0.0
    of_rate: float = 0.0

    def shifted(self, by: int) -> SpinRecord:
        """Copy for a clock that is ahead by so much [ns]."""
        twin = copy_of_spin(self)
        if twin.since != NEVER:
            twin.since += by
            twin.newest += by
        if twin.stamp != NEVER:
            twin.stamp += by
        return twin


def copy_of_spin(spin: SpinRecord) -> SpinRecord:
    """Copy of a record, for a checkpoint."""
    return SpinRecord(
        spin.left,
        spin.right,
        spin.rate,
        spin.mismatch,
        spin.side,
        spin.since,
        spin.newest,
        spin.found,
        spin.times,
        spin.stamp,
        spin.turned,
        spin.by_rate,
        spin.of_rate,
    )


def width_of_bends(spin: SpinRecord) -> float:
    """Difference of the track speeds for each rad/s; 0 before bends show one [m]."""
    return max(0.0, spin.by_rate / spin.of_rate) if spin.turned >= ENOUGH else 0.0


def unexplained(spin: SpinRecord, rate: float) -> float:
    """Difference of the track speeds that no slip in bends explains [m/s].

    Args:
        spin: record, with the readings of the tracks.
        rate: yaw rate [rad/s].
    """
    width = width_of_bends(spin)
    if width == 0.0:
        return 0.0
    turning = spin.right - spin.left
    one, other = LEAST_TURNING * width * rate, MOST_TURNING * width * rate
    low, high = min(one, other), max(one, other)
    return turning - high if turning > high else min(0.0, turning - low)


def learn_width(spin: SpinRecord, stamp: int, rate: float) -> None:
    """Add a sample of ordinary driving to the robot's bends."""
    dt = (stamp - spin.stamp) * NANOSECOND
    if spin.stamp == NEVER or not 0.0 < dt < LONGEST:
        return
    turned = abs(rate) * dt
    kept = math.exp(-turned / MEMORY)
    spin.turned = kept * spin.turned + turned
    spin.by_rate = kept * spin.by_rate + (spin.right - spin.left) * rate * dt
    spin.of_rate = kept * spin.of_rate + rate * rate * dt


def watch_spin(
    spin: SpinRecord,
    stamp: int,
    rate: float,
    change_left: float,
    change_right: float,
    fastest: float,
) -> None:
    """Add a yaw rate, and decide whether a track spins.

    Nothing is decided before the robot's own bends have shown how its tracks turn it: a wrong geometry or
    swapped sides in the robot file are no spin.

    Args:
        spin: record, changed in place.
        stamp: stamp of the IMU sample [ns].
        rate: yaw rate by the gyro [rad/s].
        change_left: newest change of the left track's speed [m/s].
        change_right: newest change of the right track's speed [m/s].
        fastest: highest speed of a track [m/s].
    """
    spin.rate = rate
    mismatch = unexplained(spin, rate)
    limit = max(LEAST_MISMATCH, OF_FASTEST * fastest)
    # Tracks at rest do not spin; the robot is pushed or carried.
    turns = max(abs(spin.left), abs(spin.right)) > limit
    counts = turns and abs(mismatch) > (GONE * limit if spin.found else limit)
    same = spin.since == NEVER or mismatch * spin.mismatch > 0.0
    if counts and same:
        if spin.since == NEVER:
            spin.since = stamp
            spin.side = LEFT if abs(change_left) > abs(change_right) else RIGHT
        spin.mismatch, spin.newest = mismatch, stamp
    elif spin.since != NEVER and (not spin.found or (stamp - spin.newest) * NANOSECOND > OVER):
        spin.since, spin.newest, spin.side, spin.found = NEVER, NEVER, NEITHER, 0
        spin.mismatch = 0.0
    if not spin.found:
        learn_width(spin, stamp, rate)
    spin.stamp = stamp
    lasts = spin.since != NEVER and (stamp - spin.since) * NANOSECOND >= LASTS
    if lasts and not spin.found:
        spin.found = 1
        spin.times += 1
