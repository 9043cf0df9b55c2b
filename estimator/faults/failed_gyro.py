"""Faults of the gyro that its own readings show: jumps, repeats, clipping.

A vehicle's yaw rate does not jump further between two samples than friction can turn it. After such a
jump readings are not used until they jump back, or agree with the turning of the tracks. A gyro that is
clipped or frozen repeats its reading to the last digit. (The yaw rate does not: hardly an IMU is mounted
square, and the noise of its other axes is in that rate.) Coarse gyros and slow sensors repeat their
readings, too; so repetition counts only if the turning of the tracks changes meanwhile, and much longer
than in the gyro's own earlier repetitions. A gyro that contradicts the tracks without any of these signs
is used: tracks slip every day. Functions are plain Python, also for numba.
"""

import math
from typing import Annotated

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Size, Stamp

WORKS, JUMPED, REPEATS, BEYOND = range(4)
# Least jump between two samples [rad/s]: this, what friction can turn (`InputSettings`), or this many
# times the mean change; and that mean before it is known.
LEAST_JUMP, MEAN_CHANGES, MEAN_CHANGE_AT_START = 0.5, 8.0, 0.15
# Time over which the changes are averaged [s], and most that a change counts, over their mean.
AVERAGING, MOST_OF_MEAN = 1.0, 4.0
LONGEST_INTERVAL = 0.1  # a longer interval between samples is a gap [s]: nothing is a jump
# A change against the jump, of this share of it, ends the fault. So does turning of the tracks that
# jumped along by this share, and a distance from it of less than this share for so long [s].
JUMP_SHARE, AGREEMENT_TIME = 0.4, 0.5
# Changes of the reading that have shown how long the gyro repeats itself, and least number of changes of
# the tracks' turning over equal readings that is a fault: this, and this multiple of the most so far.
LEARNT, LEAST_REPEATS, UNUSUAL_FACTOR = 200, 5, 4
FULL_SCALE = 0.995  # share of the range from which on a reading is clipped


class GyroRecord(msgspec.Struct):
    """Record of the gyro's faults."""

    stamp: Stamp = NEVER  # stamp of the newest sample [ns], or NEVER
    rate: float = 0.0  # its yaw rate [rad/s]
    reading: float = 0.0  # its reading about the most upright axis of the IMU [rad/s]
    size: Size = MEAN_CHANGE_AT_START  # mean size of the changes between samples [rad/s]
    turning: float = 0.0  # difference of the track speeds at it [m/s]
    changes: Count = 0  # changes of the reading as the tracks' turning changed, up to `LEARNT`
    repeats: Count = 0  # number of changes of the turning since the reading last changed
    most_repeats: Count = 0  # largest such number without a fault
    # `WORKS`, `JUMPED`, `REPEATS` or `BEYOND` its range
    fault: Annotated[int, msgspec.Meta(ge=WORKS, le=BEYOND)] = WORKS
    since: Stamp = NEVER  # stamp at which the fault was found [ns], or NEVER
    jump: float = 0.0  # change of the yaw rate by the jump, 0 when that is over [rad/s]
    agreed: Size = 0.0  # time for which the readings have agreed with the tracks since [s]
    times: Count = 0  # number of faults that were found
    jumped: Count = 0  # number of readings that were not used after a jump
    repeated: Count = 0  # number of repeated ones that were not used
    beyond: Count = 0  # number of those beyond the range


def watch_gyro(
    gyro: GyroRecord,
    stamp: int,
    rate: float,
    reading: float,
    turning: float,
    width: float,
    turning_before: float,
    gyro_range: float,
    acceleration: float,
) -> float:
    """Add a reading of the gyro; return it, or NaN if it is not to be used.

    Args:
        gyro: record, changed in place.
        stamp: stamp of the sample [ns].
        rate: yaw rate [rad/s].
        reading: reading about the most upright axis of the IMU [rad/s].
        turning: speed of the right track less that of the left [m/s].
        width: effective track width, which turns that into a yaw rate [m].
        turning_before: `turning` a moment before, smoothed [m/s].
        gyro_range: range of the gyro; 0 if unknown [rad/s].
        acceleration: largest angular acceleration that friction can give the robot [rad/s²].
    """
    dt = (stamp - gyro.stamp) * NANOSECOND
    change = rate - gyro.rate
    is_gap = not 0.0 < dt < LONGEST_INTERVAL
    count_repeats(gyro, turning, reading == gyro.reading and not is_gap)
    gyro.stamp, gyro.rate, gyro.reading = stamp, rate, reading
    fault_before, fault = gyro.fault, WORKS
    if fault_before == WORKS and not is_gap and abs(change) > least_jump(gyro, dt, acceleration):
        gyro.jump, gyro.agreed = change, 0.0
    if gyro.jump != 0.0 and is_jump_over(gyro, dt, change, turning / width, turning_before / width):
        gyro.jump = 0.0
    if 0.0 < gyro_range * FULL_SCALE <= abs(reading):
        fault = BEYOND
    elif gyro.jump != 0.0:
        fault = JUMPED
    elif is_frozen(gyro):
        fault = REPEATS
    elif fault_before == WORKS and not is_gap:
        size = min(abs(change), MOST_OF_MEAN * gyro.size)
        gyro.size += min(1.0, dt / AVERAGING) * (size - gyro.size)
    if fault == WORKS:
        gyro.since = NEVER
    elif fault_before == WORKS:
        gyro.since = stamp
        gyro.times += 1
    gyro.fault = fault
    gyro.jumped += fault == JUMPED
    gyro.repeated += fault == REPEATS
    gyro.beyond += fault == BEYOND
    return rate if fault == WORKS else math.nan


def count_repeats(gyro: GyroRecord, turning: float, repeated: bool) -> None:
    """Count changes of the tracks' `turning` [m/s] while the reading is `repeated`."""
    has_changed = turning != gyro.turning
    gyro.turning = turning
    if repeated:
        gyro.repeats += has_changed
        return
    if gyro.fault != REPEATS:
        gyro.most_repeats = max(gyro.most_repeats, gyro.repeats)
    gyro.repeats = 0
    if has_changed and gyro.changes < LEARNT:
        gyro.changes += 1


def is_frozen(gyro: GyroRecord) -> bool:
    """Return True if the gyro repeats its reading for longer than it ever did."""
    least = max(LEAST_REPEATS, UNUSUAL_FACTOR * gyro.most_repeats)
    return gyro.changes >= LEARNT and gyro.repeats >= least


def least_jump(gyro: GyroRecord, dt: float, acceleration: float) -> float:
    """Least change between two samples, an interval [s] apart, that is a jump [rad/s]."""
    return max(LEAST_JUMP, acceleration * dt, MEAN_CHANGES * gyro.size)


def is_jump_over(
    gyro: GyroRecord, dt: float, change: float, track_rate: float, track_rate_before: float
) -> bool:
    """Return True if the gyro reads a yaw rate again, after a jump.

    True once the reading jumps back, the tracks have jumped along, or both agreed for `AGREEMENT_TIME`.
    `change` is that of the reading over `dt` [s], `track_rate` the yaw rate by the tracks [rad/s].
    """
    limit = JUMP_SHARE * abs(gyro.jump)
    jump_sign = 1.0 if gyro.jump > 0.0 else -1.0
    if -jump_sign * change > limit or jump_sign * (track_rate - track_rate_before) > limit:
        return True
    gyro.agreed = gyro.agreed + dt if abs(gyro.rate - track_rate) < limit else 0.0
    return gyro.agreed > AGREEMENT_TIME
