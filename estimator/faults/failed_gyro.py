"""Faults of the gyro: jumps, repeats, clipping, contradiction of the tracks.

A vehicle's yaw rate does not jump between two samples. After a jump readings are not used until they jump
back, or agree with the turning of the tracks for some time. A gyro that is clipped or frozen repeats its
reading to the last digit. Coarse gyros and slow sensors repeat theirs, too; so repetition counts only if
the turning of the tracks changes meanwhile, and much longer than in the gyro's own earlier repetitions.

A gyro whose element sticks reads noise about zero while the robot turns; one whose sign is turned reads
bends to the other side. Slip explains that in bends to one side: a track that spins or stands turns the
tracks, and not the robot. It does not explain it in bends to both sides, after which the readings are not
used until they show the turning of the tracks again. The yaw is uncertain by the turning that they have
not shown so far.

The functions are written for plain Python and for numba, see `icreckon.estimator.base.records`.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Size, plain_copy

WORKS, JUMPED, REPEATS, BEYOND, CONTRADICTS = range(5)
# Least jump between two samples [rad/s]: this much, a change that fast [rad/s²], or so many times their
# mean change; and that mean before it is known.
LEAST_JUMP, MOST_ACCELERATION, MEAN_CHANGES, AT_START = 0.5, 60.0, 8.0, 0.15
# Time over which the changes are averaged [s], and most that a change counts, over their mean.
AVERAGING, CLIP = 1.0, 4.0
# A longer interval between samples is a gap [s]: nothing is a jump.
LONGEST_INTERVAL = 0.1
# A change against the jump, of this share of it, ends the fault.
BACK = 0.4
# So does agreement with the tracks, at once if they turned by this share of it within a moment, or else
# for so long [s]: within so much [m/s], or this share of the turning.
AGREES, WITHIN, SHARE = 0.5, 0.1, 0.15
# Changes of the reading that have shown how long the gyro repeats itself, and least number of changes of
# the tracks' turning over equal readings that is a fault: this, and so many times the most so far.
LEARNT, LEAST_REPEATS, UNUSUAL = 200, 5, 4
# Turning of the tracks over which a side's bends are forgotten, and over which the turning is that the
# gyro did not show [rad]; the shares of the turning that a gyro shows at most, on both sides, if it
# contradicts the tracks, and at least, on one, if it no longer does.
BENDS, NOT_SHOWN, CONTRADICTED, SHOWN = 0.6, 6.0, 0.3, 0.6
# Least yaw rate of the tracks in bends [rad/s], time over which it and the gyro's are smoothed [s], and
# least turning to a side that shows something [rad].
LEAST_BEND, SMOOTHING, LEAST_TURNING = 0.1, 0.3, 0.35
# Error of the turning that the gyro has not shown: slip in the bends before [rad].
OF_BENDS_BEFORE = 0.4
# Standard deviation of the tracks' turning in bends, as a share, up to which they contradict a gyro.
CLEAR_BENDS = 0.5
# Share of the range from which on a reading is clipped.
FULL_SCALE = 0.995


class BendRecord(msgspec.Struct):
    """Record of the bends to one side, as tracks and gyro show them, with forgetting.

    Attributes:
        by_rate: sum of the turning by the tracks times the yaw rate [rad²/s].
        of_turning: sum of the turning by the tracks squared [rad²/s].
        turned: turning by the tracks [rad].
    """

    by_rate: float = 0.0
    of_turning: Size = 0.0
    turned: Size = 0.0


class GyroRecord(msgspec.Struct):
    """Record of the gyro's faults.

    Attributes:
        stamp: stamp of the newest sample [ns], or NEVER.
        rate: its yaw rate [rad/s].
        size: mean size of the changes between samples [rad/s].
        turning: difference of the track speeds at it [m/s].
        changes: number of changes of the reading while the tracks' turning changed, at most `LEARNT`.
        repeats: number of changes of the turning since the reading last changed.
        most_repeats: largest such number without a fault.
        fault: `WORKS`, `JUMPED`, `REPEATS` or `BEYOND` its range.
        since: stamp at which the fault was found [ns], or NEVER.
        before: yaw rate before the jump [rad/s].
        jump: change of the yaw rate by the jump, 0 when that is over [rad/s].
        agreed: time for which the readings have agreed with the tracks since [s].
        times: number of faults that were found.
        jumped: number of readings that were not used after a jump.
        repeated: number of repeated ones that were not used.
        beyond: number of those beyond the range.
        contradicted: number of those that contradicted the tracks.
        smooth_rate: smoothed yaw rate [rad/s].
        smooth_turning: smoothed yaw rate by the tracks [rad/s].
        bends_left: bends to the left.
        bends_right: bends to the right.
        not_shown: turning of the tracks that the gyro has not shown, with forgetting [rad].
        way: way of the tracks in bends, with the same forgetting [m].
    """

    stamp: int = NEVER
    rate: float = 0.0
    size: Size = AT_START
    turning: float = 0.0
    changes: Count = 0
    repeats: Count = 0
    most_repeats: Count = 0
    fault: Annotated[int, msgspec.Meta(ge=WORKS, le=CONTRADICTS)] = WORKS
    since: int = NEVER
    before: float = 0.0
    jump: float = 0.0
    agreed: Size = 0.0
    times: Count = 0
    jumped: Count = 0
    repeated: Count = 0
    beyond: Count = 0
    contradicted: Count = 0
    smooth_rate: float = 0.0
    smooth_turning: float = 0.0
    bends_left: BendRecord = msgspec.field(default_factory=BendRecord)
    bends_right: BendRecord = msgspec.field(default_factory=BendRecord)
    not_shown: float = 0.0
    way: Size = 0.0

    def shifted(self, by: int) -> GyroRecord:
        """Copy for a clock that is ahead by so much [ns]."""
        twin = plain_copy(GyroRecord, self)
        if twin.stamp != NEVER:
            twin.stamp += by
        if twin.since != NEVER:
            twin.since += by
        return twin


def watch_gyro(
    gyro: GyroRecord,
    stamp: int,
    rate: float,
    turning: float,
    width: float,
    spread: float,
    before: float,
    speed: float,
    most: float,
) -> float:
    """Add a reading of the gyro; return it, or NaN if it is not to be used.

    Args:
        gyro: record, changed in place.
        stamp: stamp of the sample [ns].
        rate: yaw rate [rad/s].
        turning: speed of the right track less that of the left [m/s].
        width: what that is in bends for each rad/s; 0 if unknown [m].
        spread: its standard deviation, as a share.
        before: `turning` a moment before, smoothed [m/s].
        speed: forward speed by the tracks [m/s].
        most: range of the gyro; 0 if unknown [rad/s].
    """
    dt = (stamp - gyro.stamp) * NANOSECOND if gyro.stamp != NEVER else 0.0
    change = rate - gyro.rate
    is_gap = not 0.0 < dt < LONGEST_INTERVAL
    gyro.stamp, gyro.rate = stamp, rate
    count_repeats(gyro, turning, change == 0.0 and not is_gap)
    was, fault = gyro.fault, WORKS
    if gyro.jump != 0.0:
        if is_over(gyro, dt, change, turning, width, spread, before):
            gyro.jump = 0.0
    elif was == WORKS and not is_gap and abs(change) > least_jump(gyro, dt):
        gyro.before, gyro.jump, gyro.agreed = rate - change, change, 0.0
        if is_over(gyro, 0.0, 0.0, turning, width, spread, before):
            gyro.jump = 0.0
    if 0.0 < most * FULL_SCALE <= abs(rate):
        fault = BEYOND
    elif gyro.jump != 0.0:
        fault = JUMPED
    elif is_frozen(gyro):
        fault = REPEATS
    elif width > 0.0 and contradicts(gyro, 0.0 if is_gap else dt, turning / width, speed, spread):
        fault = CONTRADICTS
    elif was == WORKS and not is_gap:
        size = min(abs(change), CLIP * gyro.size)
        gyro.size += min(1.0, dt / AVERAGING) * (size - gyro.size)
    if fault != WORKS and was == WORKS:
        gyro.since = stamp
        gyro.times += 1
    if fault == WORKS:
        gyro.since = NEVER
    gyro.fault = fault
    gyro.jumped += fault == JUMPED
    gyro.repeated += fault == REPEATS
    gyro.beyond += fault == BEYOND
    gyro.contradicted += fault == CONTRADICTS
    return rate if fault == WORKS else math.nan


def count_repeats(gyro: GyroRecord, turning: float, repeated: bool) -> None:
    """Count changes of the tracks' turning over equal readings.

    Args:
        gyro: record, changed in place.
        turning: speed of the right track less that of the left [m/s].
        repeated: the newest reading is that before.
    """
    turned = turning != gyro.turning
    gyro.turning = turning
    if repeated:
        gyro.repeats += turned
        return
    if gyro.fault != REPEATS:
        gyro.most_repeats = max(gyro.most_repeats, gyro.repeats)
    gyro.repeats = 0
    if turned and gyro.changes < LEARNT:
        gyro.changes += 1


def is_frozen(gyro: GyroRecord) -> bool:
    """Return True if the gyro repeats its reading for longer than it ever did."""
    least = max(LEAST_REPEATS, UNUSUAL * gyro.most_repeats)
    return gyro.changes >= LEARNT and gyro.repeats >= least


def least_jump(gyro: GyroRecord, dt: float) -> float:
    """Least change between two samples, an interval [s] apart, that is a jump [rad/s]."""
    return max(LEAST_JUMP, MOST_ACCELERATION * dt, MEAN_CHANGES * gyro.size)


def is_over(
    gyro: GyroRecord,
    dt: float,
    change: float,
    turning: float,
    width: float,
    spread: float,
    before: float,
) -> bool:
    """Return True if the gyro reads a yaw rate again, after a jump."""
    if change * gyro.jump < 0.0 and abs(change) > BACK * abs(gyro.jump):
        return True
    expected = width * gyro.rate
    if width == 0.0:
        agrees = abs(gyro.rate - gyro.before) < BACK * abs(gyro.jump)
    else:
        share = max(SHARE, 3.0 * spread)
        agrees = abs(turning - expected) < max(WITHIN, share * abs(expected))
        jumped = (turning - before) * gyro.jump
        if agrees and jumped > BACK * width * gyro.jump * gyro.jump:
            return True
    gyro.agreed = gyro.agreed + dt if agrees else 0.0
    return gyro.agreed > AGREES


def contradicts(gyro: GyroRecord, dt: float, turning: float, speed: float, spread: float) -> bool:
    """Add a reading to the bends, and return True if the gyro contradicts the tracks.

    Args:
        gyro: record with the newest reading, changed in place.
        dt: time since the reading before [s].
        turning: yaw rate by the tracks [rad/s].
        speed: forward speed by the tracks [m/s].
        spread: standard deviation of the tracks' turning in the robot's bends, as a share.
    """
    weight = min(1.0, dt / SMOOTHING)
    gyro.smooth_rate += weight * (gyro.rate - gyro.smooth_rate)
    gyro.smooth_turning += weight * (turning - gyro.smooth_turning)
    turning, rate = gyro.smooth_turning, gyro.smooth_rate
    if abs(turning) > LEAST_BEND:
        bends, turned = gyro.bends_left if turning > 0.0 else gyro.bends_right, abs(turning) * dt
        kept = math.exp(-turned / BENDS)
        bends.by_rate = kept * bends.by_rate + turning * rate * dt
        bends.of_turning = kept * bends.of_turning + turning * turning * dt
        bends.turned = kept * bends.turned + turned
        kept = math.exp(-turned / NOT_SHOWN)
        gyro.not_shown = kept * gyro.not_shown + (turning - rate) * dt
        gyro.way = kept * gyro.way + abs(speed) * dt
    left, right = share_shown(gyro.bends_left), share_shown(gyro.bends_right)
    if gyro.fault == CONTRADICTS:
        return max(left, right) < SHOWN
    return max(left, right) < CONTRADICTED and spread < CLEAR_BENDS


def shows_bends(gyro: GyroRecord) -> bool:
    """Return True if the gyro has shown the newest bends to both sides."""
    return min(share_shown(gyro.bends_left), share_shown(gyro.bends_right)) > CONTRADICTED


def share_shown(bends: BendRecord) -> float:
    """Share of the tracks' turning that the gyro shows; 1 before there was enough."""
    return bends.by_rate / bends.of_turning if bends.turned > LEAST_TURNING else 1.0


def contradiction_density(gyro: GyroRecord, start: int, end: int) -> tuple[float, float]:
    """Error densities of the yaw rate [rad²/s] and of the speed [m²/s] over a step.

    They are those of all the turning that the gyro has not shown, and of the way in bends, in the step
    after which it is found to contradict the tracks.

    Args:
        gyro: record.
        start: stamp of the step's start [ns].
        end: stamp of its end [ns].
    """
    if gyro.fault != CONTRADICTS or not start < gyro.since <= end:
        return 0.0, 0.0
    square = gyro.not_shown * gyro.not_shown + OF_BENDS_BEFORE * OF_BENDS_BEFORE
    of_turn = square / ((end - start) * NANOSECOND)
    return of_turn, of_turn * gyro.way * gyro.way
