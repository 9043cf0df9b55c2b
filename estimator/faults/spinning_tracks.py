"""Spinning tracks: one slides, and the robot turns less than they do.

A track that loses its grip speeds up, or is carried along by the other, and the gyro does not confirm the
turning of both. Slip in bends is a share of the turning; such a track is beyond any share. If the speed
of one jumped when the mismatch began, it is the one that spins. If none did, it is the one with less
load: on a slope the upper one, in a fast bend the inner one. Until it grips again its speed is the one at
which the tracks turn as the gyro does. A track sensor that fails looks the same, and is treated the same.
Functions are plain Python, also for numba.
"""

import math
from typing import Annotated

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Flag, Size, Stamp

LEFT, UNKNOWN, RIGHT = -1, 0, 1
Side = Annotated[int, msgspec.Meta(ge=LEFT, le=RIGHT)]
# Turning that slip explains beyond that of the robot's own bends, as a share of it: standard deviations
# of its bends, the least share, and the largest shares below and above.
SIGMAS, LEAST_SHARE, MOST_BELOW, MOST_ABOVE = 5.0, 0.15, 0.4, 0.7
# Standard deviations once a track whose speed jumped is found: it spins until the speeds agree well.
SIGMAS_FOUND = 2.0
# Turning after which the robot's own bends count, and over which they are forgotten [rad].
ENOUGH_TURNING, MEMORY_OF_TURNING = 3.0, 20.0
LONGEST_INTERVAL = 0.1  # longest interval between samples of the gyro that counts as turning [s]
# Mismatch of the track speeds beyond that which counts: this much, or this share of the fastest speed.
LEAST_MISMATCH, SHARE_OF_FASTEST = 0.25, 0.1
# Distances of mismatch from which on a track may spin, and does [m]; time without mismatch after which it
# grips again [s]. A shorter mismatch is a sample of the gyro that is older than that of the tracks.
LIKELY_SPIN_DISTANCE, LEAST_SPIN_DISTANCE, GRIP_TIME = 0.04, 0.1, 0.2
# Greatest change of a robot's yaw rate [rad/s²]; beyond it the gyro fails, if its jump is this share of
# the mismatch that counts.
MOST_ACCELERATION, JUMP_SHARE = 30.0, 0.5
# A mismatch below this share of the one that counts is none, once a track spins or reads zero.
GONE_SHARE = 0.5
# Time over which the force to the left is averaged [s], and the least that indicates loads [m/s²].
LOAD_AVERAGING, LEAST_FORCE = 0.5, 0.15
# Time over which the error of the assumed speed, as large as the mismatch, is correlated [s].
CORRELATION = 0.3


class SpinRecord(msgspec.Struct):
    """Record of a spinning track."""

    left: float = 0.0  # newest reading of the left track [m/s]
    right: float = 0.0  # newest reading of the right track [m/s]
    rate: float = 0.0  # newest yaw rate by the gyro [rad/s]
    width: Size = 0.0  # effective track width that is used; 0 if it is not known [m]
    force: float = 0.0  # averaged specific force to the left [m/s²]; 0 without accelerometers
    mismatch: float = 0.0  # difference of track speeds that no slip in bends explains [m/s]
    side: Side = UNKNOWN  # `LEFT` or `RIGHT`, the track that spins, or `UNKNOWN`
    jumped: Flag = 0  # 1 if that is the track whose speed jumped when the mismatch began
    since: Stamp = NEVER  # stamp at which the mismatch began [ns], or NEVER
    newest: Stamp = NEVER  # stamp of the newest mismatch [ns], or NEVER
    way: float = 0.0  # distance of the mismatch since it began [m]
    gyro_jumped: Flag = 0  # 1 during a mismatch that began with a jump of the gyro: no spin
    times: Count = 0  # number of times that one was found
    stamp: Stamp = NEVER  # stamp of the newest sample of the gyro [ns], or NEVER
    turned: float = 0.0  # turning so far, with forgetting [rad]
    by_rate: float = 0.0  # sum of the tracks' difference times the yaw rate [m/s rad/s]
    of_rate: Size = 0.0  # sum of the yaw rate squared [rad²/s²]
    of_turning: Size = 0.0  # sum of the tracks' difference squared [m²/s²]


def width_of_bends(spin: SpinRecord) -> float:
    """Difference of the track speeds for each rad/s; 0 before bends show one [m]."""
    return max(0.0, spin.by_rate / spin.of_rate) if spin.turned >= ENOUGH_TURNING else 0.0


def spread_of_bends(spin: SpinRecord) -> float:
    """Standard deviation of the tracks' difference in bends, as a share of it."""
    explained = spin.by_rate * spin.by_rate
    return math.sqrt(max(0.0, spin.of_turning * spin.of_rate / explained - 1.0))


def unexplained(spin: SpinRecord, left: float, right: float, sigmas: float = SIGMAS) -> float:
    """Difference of track speeds [m/s] beyond `sigmas` of slip in the robot's bends."""
    if spin.width == 0.0:
        return 0.0
    turning, expected = right - left, spin.width * spin.rate
    share = sigmas * spread_of_bends(spin) if width_of_bends(spin) > 0.0 else MOST_ABOVE
    below = min(MOST_BELOW, max(LEAST_SHARE, share)) * abs(expected)
    above = min(MOST_ABOVE, max(LEAST_SHARE, share)) * abs(expected)
    # Slip explains an excess from -least to most, which is subtracted.
    least, most = (below, above) if expected > 0.0 else (above, below)
    excess = turning - expected
    return excess - most if excess > most else min(0.0, excess + least)


def learn_width(spin: SpinRecord, dt: float) -> None:
    """Add a sample of ordinary driving that lasts `dt` [s] to the robot's bends."""
    turned = abs(spin.rate) * dt
    decay = math.exp(-turned / MEMORY_OF_TURNING)
    spin.turned = decay * spin.turned + turned
    spin.by_rate = decay * spin.by_rate + (spin.right - spin.left) * spin.rate * dt
    spin.of_rate = decay * spin.of_rate + spin.rate * spin.rate * dt
    spin.of_turning = decay * spin.of_turning + (spin.right - spin.left) ** 2 * dt


def side_that_changed(
    mismatch: float, change_left: float, change_right: float, limit: float
) -> int:
    """Track whose speed jumped by `limit` or more [m/s]; `UNKNOWN` if none did."""
    # Jumps towards the mismatch count: a slower left or a faster right track, if it is positive.
    sign = 1.0 if mismatch > 0.0 else -1.0
    left_jump, right_jump = -sign * change_left, sign * change_right
    if max(left_jump, right_jump) < limit:
        return UNKNOWN
    return LEFT if left_jump > right_jump else RIGHT


def least_mismatch(fastest: float) -> float:
    """Least mismatch that counts, for a highest speed of a track [m/s]."""
    return max(LEAST_MISMATCH, SHARE_OF_FASTEST * fastest)


def is_found(spin: SpinRecord) -> bool:
    """Return True while a track is found spinning."""
    return spin.way >= LEAST_SPIN_DISTANCE


def certain_side(spin: SpinRecord) -> int:
    """Track that is found spinning: `LEFT`, `RIGHT` or `UNKNOWN`."""
    return spin.side if is_found(spin) else UNKNOWN


def is_likely(spin: SpinRecord) -> bool:
    """Return True if a track is found spinning or is likely to spin."""
    return spin.way >= LIKELY_SPIN_DISTANCE


def forget_mismatch(spin: SpinRecord) -> None:
    """Reset the record of a mismatch: no track spins."""
    spin.since, spin.newest, spin.side, spin.jumped = NEVER, NEVER, UNKNOWN, 0
    spin.mismatch = spin.way = 0.0


def add_mismatch(
    spin: SpinRecord, stamp: int, mismatch: float, dt: float, changed_side: int, zero_side: int
) -> None:
    """Add a mismatch [m/s] over `dt` [s], and choose the track that spins if one does."""
    was_found = is_found(spin)
    if spin.since == NEVER:
        spin.since, spin.way, spin.side = stamp, 0.0, changed_side
        spin.jumped = int(changed_side != UNKNOWN)
    if zero_side != UNKNOWN and not was_found:
        spin.side = zero_side
    elif spin.side == UNKNOWN and abs(spin.force) >= LEAST_FORCE:
        # A force to the left loads the right track.
        spin.side = LEFT if spin.force > 0.0 else RIGHT
    spin.mismatch, spin.newest = mismatch, stamp
    spin.way += abs(mismatch) * dt


def watch_spin(
    spin: SpinRecord,
    stamp: int,
    rate: float,
    force: float,
    change_left: float,
    change_right: float,
    fastest: float,
    zero_side: int,
    file_width: float,
) -> None:
    """Add a sample of the IMU, and decide whether a track spins.

    No spin is reported before the robot's own bends have shown its effective width: a wrong width or
    swapped sides in the robot file look the same. A track that reads zero is compared with the file's
    width, and with a lower limit: a sensor that fails reads exactly zero, a braked track rarely does.

    Args:
        spin: record, changed in place.
        stamp: stamp of the IMU sample [ns].
        rate: yaw rate by the gyro [rad/s].
        force: specific force to the left [m/s²], or NaN.
        change_left: newest change of the left track's speed [m/s].
        change_right: newest change of the right track's speed [m/s].
        fastest: highest speed of a track [m/s].
        zero_side: `LEFT` or `RIGHT`, the track that reads zero while the other drives, or `UNKNOWN`.
        file_width: effective track width by the robot file [m].
    """
    dt = (stamp - spin.stamp) * NANOSECOND
    dt = dt if 0.0 < dt < LONGEST_INTERVAL else 0.0
    rate_change = rate - spin.rate if dt > 0.0 else 0.0
    spin.stamp, spin.rate = stamp, rate
    if force == force:
        spin.force += min(1.0, dt / LOAD_AVERAGING) * (force - spin.force)
    was_found, reads_zero = is_found(spin), zero_side != UNKNOWN
    spin.width = width_of_bends(spin)
    if spin.width == 0.0 and reads_zero:
        spin.width = file_width
    sigmas = SIGMAS_FOUND if (was_found and spin.jumped) or reads_zero else SIGMAS
    mismatch = unexplained(spin, spin.left, spin.right, sigmas)
    limit = least_mismatch(fastest)
    if abs(mismatch) <= limit:
        spin.gyro_jumped = 0
    elif spin.since == NEVER and abs(rate_change) > MOST_ACCELERATION * dt:
        spin.gyro_jumped = int(abs(rate_change) * spin.width > JUMP_SHARE * limit)
    limit_now = GONE_SHARE * limit if was_found or reads_zero else limit
    # Tracks at rest do not begin to spin; the robot is pushed or carried.
    may_spin = was_found or max(abs(spin.left), abs(spin.right)) > limit_now
    is_mismatch = may_spin and not spin.gyro_jumped and abs(mismatch) > limit_now
    if is_mismatch and (spin.since == NEVER or mismatch * spin.mismatch > 0.0):
        changed_side = side_that_changed(mismatch, change_left, change_right, limit)
        add_mismatch(spin, stamp, mismatch, dt, changed_side, zero_side)
    elif spin.since != NEVER and (not was_found or (stamp - spin.newest) * NANOSECOND > GRIP_TIME):
        forget_mismatch(spin)
    if not (was_found and is_found(spin)) and not spin.gyro_jumped and not reads_zero:
        learn_width(spin, dt)
    if is_found(spin) and not was_found:
        spin.times += 1


def assumed_speeds(spin: SpinRecord, stamp: int, left: float, right: float) -> tuple[float, float]:
    """Speeds of both tracks, corrected by the gyro while one is likely to spin [m/s].

    The turning that the gyro does not confirm is subtracted from the track that spins. As long as it is
    not certain that a track spins, or which one, each gets half of it, which keeps their mean.
    """
    if (stamp - spin.stamp) * NANOSECOND > LONGEST_INTERVAL or not is_likely(spin):
        return left, right
    excess = right - left - spin.width * spin.rate
    share_of_left = 0.5 * (1.0 - certain_side(spin))
    return left + share_of_left * excess, right - (1.0 - share_of_left) * excess


def spin_density(spin: SpinRecord, side: int) -> float:
    """Error density of the speed of the track `LEFT` or `RIGHT` [m²/s]."""
    if not is_likely(spin) or certain_side(spin) == -side:
        return 0.0
    return CORRELATION * spin.mismatch * spin.mismatch
