"""Standstill detection: both tracks stopped, and a gyro whose mean is its bias.

The functions are written for plain Python and for numba, see `icreckon.estimator.base.records`. Yaw-rate
readings lie in a buffer beside the record, for their number is known only when a log is.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.records import NEVER
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.sensors.input_settings import InputSettings

# Size of a buffer of readings that grows.
ROOM = 64
# Standard deviations within which quiet readings are about their mean: of the file's noise, and of
# measured noise beyond that, which may be that of an engine and no white noise.
OF_FILE, OF_MEASURED = 5.0, 8.0
# Standard deviations within which their mean is about the bias.
OF_MEAN = 4.0
# Time without quiet readings after which a robot with its tracks at rest is carried: a robot rocks for a
# moment when it stops [s]. Its speed then, as a standard deviation [m/s].
ROCKING, CARRIED_SPEED = 1.0, 0.5


class StandstillRecord(msgspec.Struct):
    """Record of a standstill.

    Attributes:
        stopped_since: stamp of the first track speeds that were slow enough [ns], or NEVER.
        first: place in the buffer of the oldest reading that counts.
        end: place after the newest.
        restless_since: stamp from which on readings have not been quiet, although the tracks have stopped
            for long enough [ns], or NEVER.
        carried_since: stamp from which on the robot is carried [ns], or NEVER.
        carries: number of times that it was.
    """

    stopped_since: int = NEVER
    first: int = 0
    end: int = 0
    restless_since: int = NEVER
    carried_since: int = NEVER
    carries: int = 0


class StandstillMemory(msgspec.Struct, frozen=True):
    """Checkpoint of a standstill.

    Attributes:
        stopped_since: stamp of the first track speeds that were slow enough [ns], or NEVER.
        stamps: stamps of the yaw-rate readings since then [ns].
        rates: the readings [rad/s].
        restless_since: stamp from which on readings have not been quiet [ns], or NEVER.
        carried_since: stamp from which on the robot is carried [ns], or NEVER.
        carries: number of times that it was.
    """

    stopped_since: int = NEVER
    stamps: tuple[int, ...] = ()
    rates: tuple[float, ...] = ()
    restless_since: int = NEVER
    carried_since: int = NEVER
    carries: int = 0

    def __post_init__(self) -> None:
        if len(self.stamps) != len(self.rates):
            raise ValueError("each yaw-rate reading of a standstill needs a stamp")

    def shifted(self, by: int) -> StandstillMemory:
        """Copy for a clock that is ahead by so much [ns]."""
        stopped, restless, carried = (
            stamp if stamp == NEVER else stamp + by
            for stamp in (self.stopped_since, self.restless_since, self.carried_since)
        )
        stamps = tuple(stamp + by for stamp in self.stamps)
        return StandstillMemory(stopped, stamps, self.rates, restless, carried, self.carries)


def stopped_after(
    still: StandstillRecord, stamp: int, left: float, right: float, track_speed: float
) -> None:
    """Add track speeds.

    Args:
        still: record, changed in place.
        stamp: stamp of the speeds [ns].
        left: speed of the left track [m/s].
        right: speed of the right track [m/s].
        track_speed: slower tracks are stopped [m/s].
    """
    if abs(left) >= track_speed or abs(right) >= track_speed:
        if still.stopped_since != NEVER:
            still.stopped_since = NEVER
            settle(still)
            still.first = still.end = 0
    elif still.stopped_since == NEVER:
        still.stopped_since = stamp


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
    settings: InputSettings,
) -> float:
    """Add a yaw-rate reading; return the mean of quiet readings at standstill.

    Args:
        still: record, changed in place.
        stamps: buffer for stamps of readings [ns], as long as the readings of `duration_ns` and three.
        rates: buffer of the same length for readings [rad/s].
        stamp: stamp of the reading [ns].
        rate: the reading [rad/s], NaN if the gyro fails.
        noise: measured noise density of the gyro [rad/s/√Hz].
        settings: settings of the filter.

    Returns:
        The mean [rad/s]; NaN if the tracks move, have not stopped for long enough, or a reading is
        further from the mean than noise explains.

    Raises:
        ValueError: the buffers are too short.
    """
    if still.stopped_since == NEVER or rate != rate:
        return math.nan
    oldest_needed = stamp - settings.duration_ns
    first, end = still.first, still.end
    while first + 1 < end and stamps[first + 1] <= oldest_needed:
        first += 1
    if end >= len(stamps):
        for k in range(first, end):
            stamps[k - first], rates[k - first] = stamps[k], rates[k]
        first, end = 0, end - first
        if end >= min(len(stamps), len(rates)):
            raise ValueError(WRONG_SIZE)
    stamps[end], rates[end] = stamp, rate
    end += 1
    still.first, still.end = first, end
    if still.stopped_since > oldest_needed or stamps[first] > oldest_needed:
        return math.nan
    total = 0.0
    for k in range(first, end):
        total += rates[k]
    mean = total / (end - first)
    per_second = (end - first - 1) * 1e9 / (stamp - stamps[first])
    of_file = settings.gyro_noise_density
    spread = OF_FILE * of_file + OF_MEASURED * max(0.0, noise - of_file)
    quiet = max(settings.quiet_gyro, spread * math.sqrt(per_second))
    for k in range(first, end):
        if abs(rates[k] - mean) > quiet:
            keep_restless(still, stamp)
            return math.nan
    if abs(mean - settings.gyro_bias) > settings.most_bias:
        # Smooth, and no bias: it turns.
        keep_restless(still, stamp)
    else:
        settle(still)
    return mean


def keep_restless(still: StandstillRecord, stamp: int) -> None:
    """Add a sample [ns] at which the robot turns or is shaken with its tracks at rest."""
    if still.restless_since == NEVER:
        still.restless_since = stamp
    if not is_carried(still) and (stamp - still.restless_since) * NANOSECOND > ROCKING:
        still.carried_since = stamp
        still.carries += 1


def settle(still: StandstillRecord) -> None:
    """Reset the record of a robot that is carried."""
    still.restless_since, still.carried_since = NEVER, NEVER


def is_carried(still: StandstillRecord) -> bool:
    """Return True if the robot has been shaken for some time with its tracks at rest."""
    return still.carried_since != NEVER


def carried_density(still: StandstillRecord, start: int, end: int) -> float:
    """Error density of the velocity over a step of a robot that is carried [m²/s].

    With its tracks at rest it does not stand, and nothing shows where it goes: the distance is off by
    `CARRIED_SPEED` times the duration, at one standard deviation.

    Args:
        still: record.
        start: stamp of the step's start [ns].
        end: stamp of its end [ns].
    """
    since = still.restless_since
    if not is_carried(still):
        return 0.0
    age = max(0.0, 0.5 * (start - since + end - since) * NANOSECOND)
    return 2.0 * CARRIED_SPEED * CARRIED_SPEED * age


def stands(
    mean: float, bias: float, bias_variance: float, mean_variance: float, margin: float
) -> bool:
    """Return True if quiet readings are those of a standing robot.

    Args:
        mean: their mean; not a number if the robot moves [rad/s].
        bias: estimated bias of the gyro [rad/s].
        bias_variance: variance of that estimate [rad²/s²].
        mean_variance: variance of the mean [rad²/s²].
        margin: means this close to the bias are those of a standing robot in any case [rad/s].
    """
    return abs(mean - bias) <= max(margin, OF_MEAN * math.sqrt(bias_variance + mean_variance))


def is_full(still: StandstillRecord, stamps: Stamps) -> bool:
    """Return True if a buffer needs more room for a reading."""
    return still.end >= len(stamps) > 2 * still.first


class QuietReadings:
    """Buffers for the yaw-rate readings of one streaming filter.

    Attributes:
        stamps: stamps of the readings [ns].
        rates: the readings [rad/s].
    """

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
        settings: InputSettings,
    ) -> float:
        """Add a reading, see `quiet_mean`."""
        if is_full(still, self.stamps):
            self.make_room()
        return float(quiet_mean(still, self.stamps, self.rates, stamp, rate, noise, settings))

    def memory(self, still: StandstillRecord) -> StandstillMemory:
        """Checkpoint of the readings that count."""
        kept = slice(still.first, still.end)
        stamps, rates = self.stamps[kept].tolist(), self.rates[kept].tolist()
        readings = tuple(stamps), tuple(rates)
        carried = still.restless_since, still.carried_since, still.carries
        return StandstillMemory(still.stopped_since, *readings, *carried)

    def recall(self, still: StandstillRecord, memory: StandstillMemory) -> None:
        """Restore a checkpoint."""
        count = len(memory.stamps)
        still.stopped_since, still.first, still.end = memory.stopped_since, 0, count
        still.restless_since, still.carried_since = memory.restless_since, memory.carried_since
        still.carries = memory.carries
        self.stamps, self.rates = np.zeros(count + ROOM, np.int64), np.zeros(count + ROOM)
        self.stamps[:count], self.rates[:count] = memory.stamps, memory.rates
