"""Wheels of one side that disagree: one spins, is blocked, or its sensor fails.

The wheels of a side roll over the ground at one speed. If each has a motor and a sensor of its own, one
that loses its grip or sticks shows it with certainty. Of three wheels or more the median counts. Of two,
the one counts that fits the other side's speed and the gyro; as long as that does not decide, their mean
does, and its error grows with the time. Wheels that are coupled never disagree. Functions are plain
Python, also for numba.
"""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple, TypeAlias

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.records import NEVER, Count, Size, Stamp
from icreckon.estimator.faults.spinning_tracks import (
    LONGEST_INTERVAL,
    SpinRecord,
    is_found,
    spread_of_bends,
    width_of_bends,
)

Wheels: TypeAlias = "Sequence[float] | Floats"  # speeds of the wheels of one side
NO_WHEEL = -1
# Distance of two wheels of a side that is more than control and tyres explain: this much [m/s], or this
# share of the fastest speed.
LEAST_APART, SHARE_OF_FASTEST = 0.15, 0.1
# Distance by which wheels must have disagreed to be reported [m], and time of agreement that ends it [s].
LEAST_ODD_DISTANCE, AGREEMENT_TIME = 0.1, 0.2
# The gyro decides between two speeds of a side: one must be nearer to the speed by the gyro, whose error
# is added, than this share of the distance of the two.
NEAR_SHARE = 0.3
# Error of the speed by the gyro: this many standard deviations of the robot's bends, at least this share
# of the difference of the sides; and before bends have shown how the robot turns, for each rad/s [m].
SIGMAS, LEAST_ERROR_SHARE, UNKNOWN_WIDTH = 3.0, 0.15, 2.0


class WheelsRecord(msgspec.Struct):
    """Record of the wheels of one side."""

    since: Stamp = NEVER  # stamp of the first sample in which they disagree [ns], or NEVER
    newest: Stamp = NEVER  # stamp of the newest sample in which they disagree [ns], or NEVER
    decided: Stamp = NEVER  # newest sample in which the right wheel was certain [ns], or NEVER
    # index of the wheel that is not used, or `NO_WHEEL`
    odd: Annotated[int, msgspec.Meta(ge=NO_WHEEL)] = NO_WHEEL
    # distance of that wheel from the side's speed, or else of both possible speeds from their mean [m/s]
    apart: Size = 0.0
    doubt: Size = 0.0  # standard deviation of the side's speed while no wheel is certain [m/s]
    way: Size = 0.0  # distance by which the wheels have disagreed [m]
    samples: Count = 0  # number of samples in which they disagree
    times: Count = 0  # number of times that they were found to disagree


class SideSpeeds(NamedTuple):
    """Speeds that a side may have, by its wheels."""

    low: float  # the lower one [m/s]
    high: float  # the higher one; the same if the wheels decide [m/s]
    agrees: bool  # True if no wheel disagrees


def least_apart(fastest: float) -> float:
    """Least distance of two wheels that disagree, by the fastest track [m/s]."""
    return max(LEAST_APART, SHARE_OF_FASTEST * fastest)


def side_speeds(mean: float, wheels: Wheels, limit: float) -> SideSpeeds:
    """Speeds that a side may have, by the mean and the speeds of its wheels [m/s].

    Fewer than two wheels show nothing; two disagree if they are more than `limit` apart [m/s].
    """
    if len(wheels) < 2 or range_of(wheels) <= limit:
        return SideSpeeds(mean, mean, True)
    # The two middle wheels; of an odd number both are the median.
    low = nth_smallest(wheels, (len(wheels) - 1) // 2)
    high = nth_smallest(wheels, len(wheels) // 2)
    if high - low > limit:
        return SideSpeeds(low, high, False)
    return SideSpeeds(0.5 * (low + high), 0.5 * (low + high), False)


def range_of(wheels: Wheels) -> float:
    """Fastest less slowest wheel [m/s]."""
    return nth_smallest(wheels, len(wheels) - 1) - nth_smallest(wheels, 0)


def nth_smallest(wheels: Wheels, n: int) -> float:
    """Return the n-th smallest speed, counted from 0, without a sorted copy (for C)."""
    for speed in wheels:
        lower = equal = 0
        for other in wheels:
            lower += other < speed
            equal += other == speed
        if lower <= n < lower + equal:
            return speed
    return math.nan


def are_found(wheels: WheelsRecord) -> bool:
    """Return True while wheels are found to disagree."""
    return wheels.way >= LEAST_ODD_DISTANCE


def take_wheels(
    left: WheelsRecord,
    right: WheelsRecord,
    spin: SpinRecord,
    stamp: int,
    speeds: tuple[float, float],
    left_wheels: Wheels,
    right_wheels: Wheels,
    fastest: float,
    keeps: bool = True,
) -> tuple[float, float]:
    """Add a sample of the wheels of both sides; return the speeds of the sides [m/s].

    Args:
        left: record of the left side, changed in place.
        right: record of the right side, changed in place.
        spin: record of a spinning track, with the gyro's yaw rate.
        stamp: stamp of the sample [ns].
        speeds: means of the left and of the right wheels [m/s].
        left_wheels: speeds of the left wheels [m/s].
        right_wheels: speeds of the right wheels [m/s].
        fastest: highest speed of a track [m/s].
        keeps: add the sample; otherwise the records stay as they are.
    """
    limit = least_apart(fastest)
    on_left = side_speeds(speeds[0], left_wheels, limit)
    on_right = side_speeds(speeds[1], right_wheels, limit)
    turning, error = turning_by_gyro(spin, stamp)
    expected_left = on_right.low - turning if on_right.low == on_right.high else math.nan
    expected_right = on_left.low + turning if on_left.low == on_left.high else math.nan
    left_speed = side_speed(left, on_left, left_wheels, expected_left, error)
    right_speed = side_speed(right, on_right, right_wheels, expected_right, error)
    if keeps:
        is_left_certain = is_certain(on_left, expected_left, error)
        take_side(left, stamp, on_left, left_wheels, left_speed, is_left_certain)
        is_right_certain = is_certain(on_right, expected_right, error)
        take_side(right, stamp, on_right, right_wheels, right_speed, is_right_certain)
    return left_speed, right_speed


def turning_by_gyro(spin: SpinRecord, stamp: int) -> tuple[float, float]:
    """Right less left side by the gyro, NaN if not known, and its error [m/s]."""
    if abs(stamp - spin.stamp) * NANOSECOND > LONGEST_INTERVAL or is_found(spin):
        return math.nan, 0.0
    width = width_of_bends(spin)
    if width == 0.0:
        return 0.0, UNKNOWN_WIDTH * abs(spin.rate)
    turning = width * spin.rate
    return turning, max(LEAST_ERROR_SHARE, SIGMAS * spread_of_bends(spin)) * abs(turning)


def is_certain(possible: SideSpeeds, expected: float, error: float) -> bool:
    """Return True if it is certain which speed of a side is right.

    Either the wheels leave one speed, or one is near the speed `expected` by gyro and other side, with
    its `error` [m/s]. An expected speed of NaN, which is not known, makes nothing certain.
    """
    distance = min(abs(possible.low - expected), abs(possible.high - expected))
    limit = NEAR_SHARE * (possible.high - possible.low)
    return possible.low == possible.high or distance + error < limit


def side_speed(
    side: WheelsRecord, possible: SideSpeeds, wheels: Wheels, expected: float, error: float
) -> float:
    """Choose the speed of one side from the two that its wheels allow [m/s].

    If it `is_certain`, that is the one nearer to the expected speed; otherwise the one further from the
    wheel that was odd before; without such a wheel the mean of both.
    """
    low, high = possible.low, possible.high
    if is_certain(possible, expected, error):
        return low if abs(low - expected) < abs(high - expected) else high
    if 0 <= side.odd < len(wheels):
        odd = wheels[side.odd]  # excluded from now on, while `take_side` lets the doubt grow
        return high if abs(odd - low) < abs(odd - high) else low
    return 0.5 * (low + high)


def take_side(
    side: WheelsRecord,
    stamp: int,
    possible: SideSpeeds,
    wheels: Wheels,
    speed: float,
    certain: bool,
) -> None:
    """Add a sample with the chosen `speed` of one side; agreement resets its record."""
    if possible.agrees:
        if side.since != NEVER and (stamp - side.newest) * NANOSECOND > AGREEMENT_TIME:
            side.since = side.newest = side.decided = NEVER
            side.odd, side.samples = NO_WHEEL, 0
            side.apart = side.doubt = side.way = 0.0
        return
    if side.since == NEVER:
        side.since = side.newest = stamp
    was_found, before = are_found(side), side.newest
    side.newest = stamp
    side.samples += 1
    interval = min(AGREEMENT_TIME, (stamp - before) * NANOSECOND)
    side.way += range_of(wheels) * interval
    side.times += are_found(side) and not was_found
    side.doubt = half = 0.5 * (possible.high - possible.low)
    if certain:
        side.doubt, side.decided = 0.0, stamp
    elif not 0 <= side.odd < len(wheels):
        side.apart = half
        return
    # The odd wheel is the one furthest from the speed of the side.
    side.odd, side.apart = 0, abs(wheels[0] - speed)
    for k in range(1, len(wheels)):
        if abs(wheels[k] - speed) > side.apart:
            side.odd, side.apart = k, abs(wheels[k] - speed)


def wheel_density(side: WheelsRecord, newest: int, start: int, end: int) -> float:
    """Density of the error of a side's speed by wheels that disagree [m²/s].

    The error of the speed is constant, with the standard deviation `side.doubt`: after a time t the
    variance of the distance is (doubt t)², which grows by 2 doubt² t per second. The density is the mean
    of this over a step from `start` to `end` [ns]. It is zero unless the wheels disagree in the newest
    track speeds, of the stamp `newest` [ns].
    """
    if side.doubt == 0.0 or side.newest != newest or newest == NEVER:
        return 0.0
    since = max(side.since, side.decided)
    # Time t in the middle of the step [s].
    age = max(0.0, 0.5 * (start - since + end - since) * NANOSECOND)
    return 2.0 * side.doubt * side.doubt * age
