"""Held track speeds: newest values, acceleration, and error densities.

The functions are written for plain Python and for numba, see `icreckon.estimator.base.records`.
"""

import math

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Interval, Size, Stamp
from icreckon.estimator.faults.failed_gyro import GyroRecord, watch_gyro
from icreckon.estimator.faults.odd_wheels import WheelsRecord
from icreckon.estimator.faults.sliding_robot import AVERAGING, SlideRecord, watch_slide
from icreckon.estimator.faults.spinning_tracks import (
    LEFT,
    RIGHT,
    UNKNOWN,
    SpinRecord,
    assumed_speeds,
    forget_mismatch,
    is_found,
    watch_spin,
    width_of_bends,
)
from icreckon.estimator.faults.stuck_tracks import (
    Repeating,
    frozen_from,
    may_stick,
    reads_zero,
    repeating_after,
    stuck_from,
)
from icreckon.estimator.log.measurements import Vector3
from icreckon.estimator.sensors.imu_clock import Clocked
from icreckon.estimator.sensors.imu_noise import DIFFERENCE_VARIANCE, SIGMA_OVER_MEAN_SIZE
from icreckon.estimator.sensors.input_settings import InputSettings

ACCELERATION_AVERAGING = 0.1  # time over which the change of the track speeds is averaged [s]
SMOOTHING = 0.2  # time constant of the smoothed speeds [s]
DYING_AWAY = 2.0  # time constant with which stale speeds decay [s]
USUAL_TRACK_INTERVAL = 0.02  # assumed interval before it is measured [s]
# The file's noise counts while the measured density is at most this many times as large.
MORE_NOISE = 25.0
# Speeds are averaged over this share of `hold` if their noise times the root of the interval, about 0.6
# of the distance per count, is larger than `COARSE` [m].
AVERAGED_SHARE, COARSE = 0.3, 1.5e-3
NOISE_MEMORY = 30.0  # time of driving over which the noise is averaged [s]
NOISE_FREE = 50  # the average begins as if this many differences had no noise: a start is a jump


class TrackRecord(msgspec.Struct):
    """Record of the track speeds; each is the average since the previous sample."""

    stamp: Stamp = NEVER  # stamp of the newest sample [ns], or NEVER
    # `stamp`, or the stamp of a later sample that is averaged with the next ones; averages since `stamp`
    arrived: Stamp = NEVER
    average_left: float = 0.0  # of the left track [m/s]
    average_right: float = 0.0  # of the right track [m/s]
    left: float = 0.0  # newest speed of the left track [m/s]
    right: float = 0.0  # newest speed of the right track [m/s]
    interval: Interval = USUAL_TRACK_INTERVAL  # time between the newest two samples [s]
    acceleration_left: float = 0.0  # averaged acceleration of the left track [m/s²]
    acceleration_right: float = 0.0  # averaged acceleration of the right track [m/s²]
    smooth_left: float = 0.0  # smoothed speed of the left track [m/s]
    smooth_right: float = 0.0  # smoothed speed of the right track [m/s]
    mean: float = 0.0  # mean speed of both, averaged over `sliding_robot.AVERAGING` [m/s]
    # records of readings that repeat themselves, and of the wheels of each side
    repeating_left: Repeating = msgspec.field(default_factory=Repeating)
    repeating_right: Repeating = msgspec.field(default_factory=Repeating)
    left_wheels: WheelsRecord = msgspec.field(default_factory=WheelsRecord)
    right_wheels: WheelsRecord = msgspec.field(default_factory=WheelsRecord)
    # records of a spinning track, of slides along the tracks, and of the gyro's faults
    spin: SpinRecord = msgspec.field(default_factory=SpinRecord)
    forward: SlideRecord = msgspec.field(default_factory=SlideRecord)
    gyro: GyroRecord = msgspec.field(default_factory=GyroRecord)
    change: float = 0.0  # of right speed less left, since the sample before [m/s]
    noise: Size = 0.0  # mean size of its differences, as a noise density [m/s/√Hz]
    run: Count = 0  # number of samples since the newest gap
    driven: Count = NOISE_FREE  # number of differences in `noise`
    stuck: Count = 0  # number of times that a track's sensor was found stuck
    counted_from: Stamp = NEVER  # estimate from which distances are counted [ns], or NEVER
    ahead_left: float = 0.0  # distance of the left track from then to the newest sample [m]
    ahead_right: float = 0.0  # distance of the right track [m]
    behind: float = 0.0  # distance before then that the newest sample adds, mean of both tracks [m]


def smoothing_share(interval: float, time_constant: float) -> float:
    """Weight of a new value in an exponential average; `interval` since the last [s]."""
    return -math.expm1(-interval / time_constant)


def mean_decay(held: TrackRecord, start: int, end: int, hold_ns: int) -> float:
    """Mean factor by which stale speeds have decayed between two stamps [ns]."""
    stale = end - held.stamp - hold_ns
    if stale <= 0 or end <= start or held.stamp == NEVER:
        return 1.0
    dt, to_age = (end - start) * NANOSECOND, stale * NANOSECOND
    from_age = max(0, start - held.stamp - hold_ns) * NANOSECOND
    fresh_time = dt - (to_age - from_age)
    # The factor is 1 in that time, and exp(-age / DYING_AWAY) after it.
    decayed = math.exp(-from_age / DYING_AWAY) - math.exp(-to_age / DYING_AWAY)
    return (fresh_time + DYING_AWAY * decayed) / dt


def average(held: TrackRecord, stamp: int, left: float, right: float, hold: float) -> bool:
    """Add track speeds [m/s] to their averages; return True if these are to be held.

    Speeds of coarse encoders are averaged over a share of `hold` [s]: noise of a few counts would look
    like motion, and change the forces and the weight of the accelerometers in the model.
    """
    interval = (stamp - held.stamp) * NANOSECOND
    # An average of equal speeds is exactly that speed, so that a stuck sensor is still found.
    share = (stamp - held.arrived) * NANOSECOND / interval
    held.arrived = stamp
    held.average_left += share * (left - held.average_left)
    held.average_right += share * (right - held.average_right)
    is_coarse = held.noise * held.noise * held.interval > COARSE * COARSE
    return not (is_coarse and interval < AVERAGED_SHARE * hold)


def take_tracks(
    held: TrackRecord, stamp: int, left: float, right: float, settings: InputSettings
) -> None:
    """Add a later sample at a stamp [ns] to a record: speeds of both tracks [m/s]."""
    repeating = held.repeating_left, held.repeating_right
    was_frozen = frozen_from(*repeating, settings.track_speed) != NEVER
    left_newly_stuck = repeating_after(repeating[0], stamp, left, right, settings.hold)
    right_newly_stuck = repeating_after(repeating[1], stamp, right, left, settings.hold)
    newly_frozen = not was_frozen and frozen_from(*repeating, settings.track_speed) != NEVER
    spin, rests = held.spin, left == 0.0 and right == 0.0
    change = right - left - (spin.right - spin.left)
    spin.left, spin.right = left, right
    left, right = assumed_speeds(spin, stamp, left, right)
    smooth_weight, mean_weight = 1.0, 1.0  # after a gap the averages start again
    interval = (stamp - held.stamp) * NANOSECOND
    if interval <= settings.hold:
        held.interval = interval
        smooth_weight = smoothing_share(interval, SMOOTHING)
        mean_weight = min(1.0, interval / AVERAGING)
        rate = min(1.0, interval / ACCELERATION_AVERAGING) / interval
        a_l, a_r = held.acceleration_left, held.acceleration_right
        held.acceleration_left = a_l + rate * (left - held.left - a_l * interval)
        held.acceleration_right = a_r + rate * (right - held.right - a_r * interval)
        held.run += 1
    else:
        held.acceleration_left = held.acceleration_right = 0.0
        held.run = 1
    measure_track_noise(held, change, interval, rests)
    held.smooth_left += smooth_weight * (left - held.smooth_left)
    held.smooth_right += smooth_weight * (right - held.smooth_right)
    held.mean += mean_weight * (0.5 * (left + right) - held.mean)
    held.stamp, held.left, held.right = stamp, left, right
    held.arrived, held.average_left, held.average_right = stamp, 0.0, 0.0
    # Frozen: both sensors repeat one reading at the same time.
    held.stuck += left_newly_stuck + right_newly_stuck + 2 * newly_frozen


def measure_track_noise(held: TrackRecord, change: float, interval: float, rests: bool) -> None:
    """Add a change of right speed less left [m/s] over an interval [s] to the noise.

    Second differences cancel accelerations. Unlike for the IMU, differences of zero are included and none
    is clipped: steps of a coarse encoder are its noise. Encoders at rest have none.
    """
    size = abs(change - held.change) * math.sqrt(interval / DIFFERENCE_VARIANCE)
    held.change = change
    if held.run < 3 or rests:
        return
    held.driven += 1
    held.noise += max(1.0 / held.driven, interval / NOISE_MEMORY) * (size - held.noise)


def take_motion(
    held: TrackRecord,
    stamp: int,
    rate: float,
    reading: float,
    force_x: float,
    force_y: float,
    settings: InputSettings,
) -> float:
    """Add an IMU sample to the watches over spinning tracks, slides and the gyro.

    Args:
        held: record of the track speeds, changed in place.
        stamp: stamp of the IMU sample [ns].
        rate: yaw rate by the gyro [rad/s], NaN if it is not known.
        reading: reading of the gyro about the most upright axis of the IMU [rad/s].
        force_x: specific force forward [m/s²], or NaN.
        force_y: specific force to the left [m/s²], or NaN.
        settings: settings of the filter.

    Returns:
        The yaw rate, or NaN if the gyro fails.
    """
    if held.stamp == NEVER or rate != rate:
        return rate
    spin = held.spin
    width = width_of_bends(spin) or settings.track_width  # 0 before the robot has turned enough
    # Right speed less left [m/s], effective track width [m], and the smoothed difference [m/s].
    by_tracks = spin.right - spin.left, width, held.smooth_right - held.smooth_left
    limits = settings.gyro_range, settings.yaw_acceleration
    rate = watch_gyro(held.gyro, stamp, rate, reading, *by_tracks, *limits)
    if rate != rate or stamp - held.stamp > settings.hold_ns:
        return rate
    watch_slide(held.forward, stamp, force_x, held.mean)
    # Sensors that repeat their readings may be stuck: that is not spin.
    left, right = held.repeating_left, held.repeating_right
    left_zero, right_zero = reads_zero(left), reads_zero(right)
    may_be_stuck = (may_stick(left) and not left_zero) or (may_stick(right) and not right_zero)
    is_frozen = frozen_from(left, right, settings.track_speed) != NEVER
    if (may_be_stuck or is_frozen) and not is_found(spin):
        forget_mismatch(spin)
        spin.stamp = stamp
        return rate
    zero_side = LEFT if left_zero else RIGHT if right_zero else UNKNOWN
    changes = spin.left - held.smooth_left, spin.right - held.smooth_right
    fastest, file_width = settings.fastest, settings.track_width
    watch_spin(spin, stamp, rate, force_y, *changes, fastest, zero_side, file_width)
    return rate


def is_hole(held: Clocked, stamp: int, hold: float) -> bool:
    """Return True if a sample at a stamp [ns] follows a gap longer than `hold` [s]."""
    return held.stamp != NEVER and (stamp - held.stamp) * NANOSECOND > hold


def late_density(held: TrackRecord, start: int, end: int, settings: InputSettings) -> float:
    """Error density of the yaw rate by late track speeds, over a step [rad²/s].

    The step is between two stamps [ns]. A speed is the mean of the interval before its stamp, and is held
    after it. So its middle is older than the middle of the step. The change of the yaw rate in between
    is one standard deviation, independent from step to step. For stale speeds see `gap_density`.
    """
    dt, held_for = (end - start) * NANOSECOND, (end - held.stamp) * NANOSECOND
    if held_for > settings.hold:
        return 0.0
    age = held_for + 0.5 * (held.interval - dt)
    change = (held.acceleration_right - held.acceleration_left) * age / settings.track_width
    return change * change * dt


def speeds_at(held: TrackRecord, now: int, hold_ns: int) -> tuple[float, float]:
    """Speeds of the left and the right track at a stamp [ns]; stale ones decay [m/s]."""
    stale = now - held.stamp - hold_ns
    if stale <= 0 or held.stamp == NEVER:
        return held.left, held.right
    decay = math.exp(-stale * NANOSECOND / DYING_AWAY)
    return decay * held.left, decay * held.right


def count_distance(
    held: TrackRecord, start: int, before: int, left: float, right: float, hold_ns: int
) -> None:
    """Add the distances of the newest sample: its speeds are means since the last.

    The estimate, at `start` [ns] or NEVER, was made with the old speeds: the distance that they missed is
    added to `behind`. After a gap, longer than `hold_ns`, the new speeds count from the estimate on. The
    last sample had the stamp `before` [ns], or NEVER, and the speeds `left` and `right` [m/s].
    """
    if held.counted_from != start:
        held.counted_from = start
        held.ahead_left = held.ahead_right = held.behind = 0.0
    if start == NEVER or held.stamp < start:
        return
    before = start if held.stamp - before > hold_ns else before
    known = max(before, start)
    time_ahead, time_behind = (held.stamp - known) * NANOSECOND, (known - before) * NANOSECOND
    held.ahead_left += time_ahead * held.left
    held.ahead_right += time_ahead * held.right
    held.behind += 0.5 * time_behind * (held.left - left + held.right - right)


def mean_speeds(held: TrackRecord, start: int, end: int, hold_ns: int) -> Vector3:
    """Mean speeds of the left and the right track between two stamps [ns] [m/s].

    The third number is the speed that adds the distance `behind`, missed before the first stamp.
    """
    if held.stamp == NEVER or end <= start:
        left, right = speeds_at(held, start, hold_ns)
        return left, right, 0.0
    left, right, behind, known_until = 0.0, 0.0, 0.0, start
    if held.counted_from == start <= held.stamp:
        left, right, behind = held.ahead_left, held.ahead_right, held.behind
        known_until = held.stamp
    # The newest speeds hold over the rest of the step.
    dt, rest_s = (end - start) * NANOSECOND, (end - known_until) * NANOSECOND
    rest_s *= mean_decay(held, known_until, end, hold_ns)
    return (left + rest_s * held.left) / dt, (right + rest_s * held.right) / dt, behind / dt


def coarse_density(held: TrackRecord, settings: InputSettings) -> float:
    """Error density of each track's speed by coarse encoders [m²/s].

    It is added to the density of the file, and zero unless the measured noise is clearly larger.
    """
    # `noise` is the mean size of the difference of both tracks: half of its variance is of each.
    half = 0.5 * SIGMA_OVER_MEAN_SIZE * SIGMA_OVER_MEAN_SIZE
    return max(0.0, half * held.noise * held.noise - MORE_NOISE * settings.track_density)


def gap_density(held: TrackRecord, start: int, end: int, settings: InputSettings) -> float:
    """Error density of stale or frozen speeds between two stamps [ns] [m²/s]."""
    since = frozen_from(held.repeating_left, held.repeating_right, settings.track_speed)
    if since == NEVER:
        if end - held.stamp <= settings.hold_ns or held.stamp == NEVER:
            return 0.0
        since = held.stamp + settings.hold_ns
    return unknown_density(since, start, end, settings)


def stuck_density(track: Repeating, start: int, end: int, settings: InputSettings) -> float:
    """Error density over a step between two stamps [ns] of a track, if stuck [m²/s]."""
    # Most readings change with each sample: decided first, to save time.
    if track.since == track.newest:
        return 0.0
    since = stuck_from(track, settings.hold)
    return 0.0 if since == NEVER else unknown_density(since, start, end, settings)


def unknown_density(since: int, start: int, end: int, settings: InputSettings) -> float:
    """Error density over a step of speeds that are unknown since a stamp [ns] [m²/s].

    If a speed is a random walk of density g², the variance of its distance after a time T is g² T³ / 3.
    White noise of density g² t² gives the same. The error of the distance is at most T times the fastest
    speed: white noise of density 2 v² t has that variance.
    """
    dt = (end - start) * NANOSECOND
    if dt <= 0.0:
        return 0.0
    from_age, to_age = max(0, start - since) * NANOSECOND, max(0, end - since) * NANOSECOND
    square_growth = (to_age * to_age - from_age * from_age) / dt
    mean_square = (to_age * to_age * to_age - from_age * from_age * from_age) / (3.0 * dt)
    walk, fastest = settings.gap_acceleration, settings.fastest
    return min(walk * walk * mean_square, fastest * fastest * square_growth)
