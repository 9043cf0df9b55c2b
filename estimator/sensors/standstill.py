"""Standstill detection: both tracks stopped and a quiet gyro, whatever its mean.

A bias that differs from the estimate jumped, or walked, since the robot last stood. A robot that is
turned slowly and steadily with its tracks at rest looks the same; the uncertainty of the yaw covers that.

The functions are written for plain Python and for numba, see `icreckon.estimator.base.records`. Yaw-rate
readings lie in a buffer outside the record, for their number is known only when a log is.
"""

import math
from typing import Any, NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.errors import WRONG_SIZE
from icreckon.estimator.base.records import NEVER, Stamp
from icreckon.estimator.sensors.input_settings import InputSettings

ROOM = 64  # size of a buffer of readings that grows
# Largest distance of quiet readings from their mean, in standard deviations: of the file's noise, plus of
# the measured noise above that, which may be due to an engine and not white.
SIGMAS_OF_FILE, SIGMAS_OF_MEASURED = 5.0, 8.0
SIGMAS_OF_MEAN = 4.0  # standard deviations beyond which their mean shows that the bias has changed
SLOW_TURN = 0.5  # a slow turn is this share of a bias that changed, at one standard deviation
# Time without quiet readings after which a robot with its tracks at rest is carried [s]; a robot that
# stops rocks for a moment.
ROCKING_TIME = 1.0
CARRIED_SPEED = 0.5  # standard deviation of the speed of a carried robot [m/s]
# Time for which the mean must differ to be a bias that changed at rest [s]: a robot that begins to turn
# moves its encoders sooner, coarse ones too.
LASTING = 2.0


class StandstillRecord(msgspec.Struct):
    """Record of a standstill."""

    stopped_since: Stamp = NEVER  # stamp of the first slow track speeds [ns], or NEVER
    first: int = 0  # place in the buffer of the oldest reading that counts
    end: int = 0  # place after the newest
    restless_since: Stamp = NEVER  # stamp since which readings at rest are not quiet [ns], or NEVER
    carried_since: Stamp = NEVER  # stamp from which on the robot is carried [ns], or NEVER
    carries: int = 0  # number of times that it was carried
    steady_mean: float = 0.0  # mean since the robot stands, until another one lasts [rad/s]
    quiet_at: Stamp = NEVER  # stamp of the newest reading at which the robot stood [ns], or NEVER
    quiet_mean: float = 0.0  # mean of the readings then [rad/s]
    mean_before: float = 0.0  # the same at the end of the rest before [rad/s]
    changed_at: Stamp = NEVER  # stamp since which it differs from `mean_before` [ns], or NEVER
    moved_at: Stamp = NEVER  # stamp since which it differs from `steady_mean` [ns], or NEVER
    rest_time: float = 0.0  # time at rest before the newest quiet reading [s]
    drive_time: float = 0.0  # time of driving since the last standstill [s]; 0 without one


class QuietMemory(NamedTuple):
    """Copy of the yaw-rate readings of a standstill that count."""

    stamps: tuple[Stamp, ...] = ()  # their stamps [ns]
    rates: tuple[float, ...] = ()  # the readings [rad/s]


def stopped_after(
    still: StandstillRecord, stamp: int, left: float, right: float, track_speed: float
) -> None:
    """Add speeds of both tracks [m/s] at a stamp [ns]; below `track_speed` they rest."""
    if abs(left) >= track_speed or abs(right) >= track_speed:
        if still.stopped_since != NEVER:
            end_rest(still)
    elif still.stopped_since == NEVER:
        still.stopped_since = stamp


def end_rest(still: StandstillRecord) -> None:
    """End the rest of the tracks."""
    still.stopped_since = still.changed_at = NEVER
    still.mean_before = still.quiet_mean
    settle(still)
    still.first = still.end = 0


def tracks_rest(still: StandstillRecord) -> bool:
    """Return True if the newest track speeds are those of resting tracks."""
    return still.stopped_since != NEVER


def quiet_mean(
    still: StandstillRecord,
    stamps: Stamps,
    rates: Floats,
    stamp: int,
    rate: float,
    noise: float,
    is_silent: bool,
    settings: InputSettings,
) -> float:
    """Add a yaw-rate reading; return the mean of quiet readings at standstill.

    The mean is NaN if the tracks move, the readings were not quiet for long enough, or the mean is too
    large for a bias. If the track speeds are stale, a rest ends where readings or their mean change.

    Args:
        still: record, changed in place.
        stamps: buffer for stamps [ns], with room for the readings of `duration_ns` and three more.
        rates: buffer of the same length for readings [rad/s]; `ValueError` if either is too short.
        stamp: stamp of the reading [ns].
        rate: the reading [rad/s], NaN if the gyro fails.
        noise: measured noise density of the gyro [rad/s/√Hz].
        is_silent: the newest track speeds are stale.
        settings: settings of the filter.
    """
    if still.stopped_since == NEVER or rate != rate:
        return math.nan
    oldest_needed = stamp - settings.duration_ns
    add_reading(still, stamps, rates, stamp, rate, oldest_needed)
    first, end = still.first, still.end
    total = 0.0
    for k in range(first, end):
        total += rates[k]
    mean = total / (end - first)
    window = max(NANOSECOND, (stamp - stamps[first]) * NANOSECOND)  # [s]
    readings_per_second = (end - first - 1) / window
    file_noise = settings.gyro_noise_density
    spread = SIGMAS_OF_FILE * file_noise + SIGMAS_OF_MEASURED * max(0.0, noise - file_noise)
    most_apart = max(settings.quiet_gyro, spread * math.sqrt(readings_per_second))  # [rad/s]
    for k in range(end - 1, first - 1, -1):
        if abs(rates[k] - mean) > most_apart:
            # Readings begin to count after the newest one that is not quiet.
            still.first = k + 1 if k + 1 < end else k
            if still.stopped_since <= oldest_needed:
                add_restless(still, stamp, is_silent)
            return math.nan
    if still.stopped_since > oldest_needed or stamps[first] > oldest_needed:
        return math.nan
    mean_sigma = max(file_noise, noise) / math.sqrt(settings.duration_ns * NANOSECOND)
    by_noise = SIGMAS_OF_MEAN * math.sqrt(2.0) * mean_sigma  # for a difference of two means
    has_stood = still.quiet_at >= still.stopped_since
    may_drive = is_silent and has_stood and abs(mean - still.quiet_mean) > by_noise
    if may_drive or abs(mean - settings.gyro_bias) > settings.most_bias:
        add_restless(still, stamp, is_silent)
        return math.nan
    settle(still)
    add_quiet(still, stamp, mean, settings.usual_change + by_noise)
    follow_mean(still, stamp, by_noise, settings)
    return mean


def add_reading(
    still: StandstillRecord, stamps: Stamps, rates: Floats, stamp: int, rate: float, oldest: int
) -> None:
    """Add a reading, and drop those whose intervals end before `oldest` [ns]."""
    first, end = still.first, still.end
    while first + 1 < end and stamps[first + 1] <= oldest:
        first += 1
    if end >= len(stamps):
        # The buffer is full: move the readings that count to its start.
        for k in range(first, end):
            stamps[k - first], rates[k - first] = stamps[k], rates[k]
        first, end = 0, end - first
        if end >= min(len(stamps), len(rates)):
            raise ValueError(WRONG_SIZE)
    stamps[end], rates[end] = stamp, rate
    still.first, still.end = first, end + 1


def add_quiet(still: StandstillRecord, stamp: int, mean: float, usual_change: float) -> None:
    """Add a stamp [ns] at which the robot stands, with its quiet mean [rad/s].

    Noise and the walk of the bias explain a change of the mean up to `usual_change` [rad/s].
    """
    last_quiet = still.quiet_at
    rest_began = max(still.stopped_since, last_quiet)
    still.rest_time = (stamp - rest_began) * NANOSECOND
    still.quiet_at, still.quiet_mean = stamp, mean
    if last_quiet == NEVER:
        still.drive_time, still.mean_before = 0.0, mean
    else:
        still.drive_time = (rest_began - last_quiet) * NANOSECOND
    change = abs(mean - still.mean_before)
    if change < 0.5 * usual_change:
        still.changed_at = NEVER
    elif change > usual_change and still.changed_at == NEVER:
        still.changed_at = stamp


def follow_mean(
    still: StandstillRecord, stamp: int, by_noise: float, settings: InputSettings
) -> None:
    """Set the steady mean when the robot has stopped, or its quiet mean has changed.

    If the mean differs by more than `by_noise` [rad/s] for `LASTING`, the bias changed at rest:
    `rest_time` becomes the time since that change.
    """
    if still.rest_time + still.drive_time < settings.duration_ns * NANOSECOND:
        if abs(still.quiet_mean - still.steady_mean) <= by_noise:
            still.moved_at = NEVER
            return
        if still.moved_at == NEVER:
            still.moved_at = stamp
        changed_time = (stamp - still.moved_at) * NANOSECOND
        if changed_time < LASTING:
            return
        still.rest_time = changed_time
    still.moved_at = NEVER
    still.steady_mean = still.quiet_mean


def add_restless(still: StandstillRecord, stamp: int, is_silent: bool) -> None:
    """Add a stamp [ns] of unrest with resting tracks; a robot is carried if it lasts.

    If the track speeds are stale (`is_silent`), the robot may drive, and the rest ends.
    """
    if still.restless_since == NEVER:
        still.restless_since = stamp
    if is_carried(still) or (stamp - still.restless_since) * NANOSECOND <= ROCKING_TIME:
        return
    if is_silent:
        end_rest(still)
    else:
        still.carried_since = stamp
        still.carries += 1


def settle(still: StandstillRecord) -> None:
    """Record that the robot is neither shaken nor carried."""
    still.restless_since, still.carried_since = NEVER, NEVER


def is_carried(still: StandstillRecord) -> bool:
    """Return True if the robot has been shaken for some time with its tracks at rest."""
    return still.carried_since != NEVER


def carried_density(still: StandstillRecord, start: int, end: int) -> float:
    """Error density of a carried robot's velocity between two stamps [ns] [m²/s]."""
    since = still.restless_since
    if not is_carried(still):
        return 0.0
    # The standard deviation of the distance is the speed times the time since then.
    age = max(0.0, 0.5 * (start - since + end - since) * NANOSECOND)
    return 2.0 * CARRIED_SPEED * CARRIED_SPEED * age


def turn_density(still: StandstillRecord, start: int, end: int) -> float:
    """Error density of the yaw between stamps [ns] if the quiet mean changed [rad²/s]."""
    if still.changed_at == NEVER:
        return 0.0
    rate, since = SLOW_TURN * (still.quiet_mean - still.mean_before), still.changed_at
    return rate * rate * max(0.0, (start - since + end - since) * NANOSECOND)


def creep_density(coarse: float, interval: float, settings: InputSettings) -> float:
    """Density of the yaw rate at rest that coarse encoders hide [rad²/s].

    Each track may move by less than a count, which follows from the error density of coarse encoders
    [m²/s] and the interval of the track speeds [s].
    """
    # In counts squared, readings of an encoder have a variance of 1/6, distances below one count a mean
    # square of 1/3. White noise of this density gives the mean over the duration that variance.
    width, duration = settings.track_width, settings.duration_ns * NANOSECOND
    return 4.0 * coarse * interval / (width * width * duration)


class BiasChange(NamedTuple):
    """Variances to add when the mean of quiet readings, the gyro's bias, changes."""

    bias: Any  # of the bias [rad²/s²]
    shared: Any  # of yaw and bias together [rad²/s]
    yaw: Any  # of the yaw [rad²]


def bias_change(change: Any, variance: Any, rest_time: Any, drive_time: Any) -> BiasChange:
    """Variances to add to bias and yaw; 0 if noise explains the change of the bias.

    The quiet mean differs from the estimated bias by `change` [rad/s]; `variance` is by noise. The new
    bias acted during all of the rest time, and may have begun at any moment of the drive time [s].
    """
    excess = max(0.0, change * change - SIGMAS_OF_MEAN * SIGMAS_OF_MEAN * variance)
    at_rest = (1.0 + SLOW_TURN * SLOW_TURN) * (rest_time * rest_time)
    # The mean of the square of a time uniform from 0 to `drive_time`.
    in_drive = drive_time * drive_time * (1.0 / 3.0)
    return BiasChange(excess, -excess * rest_time, excess * (at_rest + in_drive))


def is_full(still: StandstillRecord, stamps: Stamps) -> bool:
    """Return True if a buffer is full, and less than half of it can be freed."""
    return still.end >= len(stamps) > 2 * still.first


class QuietReadings:
    """Buffers for yaw-rate readings [rad/s] of a filter, and their stamps [ns]."""

    def __init__(self) -> None:
        self.stamps: Stamps = np.zeros(ROOM, np.int64)
        self.rates: Floats = np.zeros(ROOM)

    def make_room(self) -> None:
        """Double the buffers."""
        self.stamps = np.concatenate([self.stamps, np.zeros_like(self.stamps)])
        self.rates = np.concatenate([self.rates, np.zeros_like(self.rates)])

    def mean(
        self,
        still: StandstillRecord,
        stamp: int,
        rate: float,
        noise: float,
        is_silent: bool,
        settings: InputSettings,
    ) -> float:
        """Add a reading, see `quiet_mean`."""
        if is_full(still, self.stamps):
            self.make_room()
        sample = stamp, rate, noise, is_silent
        return float(quiet_mean(still, self.stamps, self.rates, *sample, settings))

    def memory(self, still: StandstillRecord) -> QuietMemory:
        """Copy the readings that count; the record gets their places in the copy."""
        kept = slice(still.first, still.end)
        still.first, still.end = 0, still.end - still.first
        return QuietMemory(tuple(self.stamps[kept].tolist()), tuple(self.rates[kept].tolist()))

    def recall(self, memory: QuietMemory) -> None:
        """Restore a copy."""
        count = len(memory.stamps)
        self.stamps, self.rates = np.zeros(count + ROOM, np.int64), np.zeros(count + ROOM)
        self.stamps[:count], self.rates[:count] = memory.stamps, memory.rates
