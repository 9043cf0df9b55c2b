"""Standstill detection: both tracks stopped, and a gyro that reads only its bias.

The functions are written for plain Python and for numba, see `estimator.base.records`. Yaw-rate readings
lie in a buffer beside the record, for their number is known only when a log is.
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence

import msgspec

from icreckon.estimator.base.records import NEVER
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.sensors.input_settings import InputSettings

# Size of a buffer of readings that grows.
ROOM = 64


class StandstillRecord(msgspec.Struct):
    """Record of a standstill.

    Attributes:
        stopped_since: stamp of the first track speeds that were slow enough [ns], or NEVER.
        first: place in the buffer of the oldest reading that counts.
        end: place after the newest.
    """

    stopped_since: int = NEVER
    first: int = 0
    end: int = 0


class StandstillMemory(msgspec.Struct, frozen=True):
    """Checkpoint of a `StandstillDetector`.

    Attributes:
        stopped_since: stamp of the first track speeds that were slow enough [ns], or NEVER.
        stamps: stamps of the yaw-rate readings since then [ns].
        rates: the readings [rad/s].
    """

    stopped_since: int = NEVER
    stamps: tuple[int, ...] = ()
    rates: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.stamps) != len(self.rates):
            raise ValueError("each yaw-rate reading of a standstill needs a stamp")

    def shifted(self, by: int) -> StandstillMemory:
        """Copy for a clock that is ahead by so much [ns]."""
        since = self.stopped_since if self.stopped_since == NEVER else self.stopped_since + by
        return StandstillMemory(since, tuple(stamp + by for stamp in self.stamps), self.rates)


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
            still.first = still.end = 0
    elif still.stopped_since == NEVER:
        still.stopped_since = stamp


def quiet_mean(
    still: StandstillRecord,
    stamps: MutableSequence[int],
    rates: MutableSequence[float],
    stamp: int,
    rate: float,
    settings: InputSettings,
) -> float:
    """Add a yaw-rate reading; return the mean of quiet readings at standstill.

    Args:
        still: record, changed in place.
        stamps: buffer for stamps of readings [ns], as long as the readings of `duration_ns` and three.
        rates: buffer of the same length for readings [rad/s].
        stamp: stamp of the reading [ns].
        rate: the reading [rad/s].
        settings: settings of the filter.

    Returns:
        The mean [rad/s]; NaN if the tracks move, have not stopped for long enough, or the gyro is not
        quiet.

    Raises:
        ValueError: the buffers are too short.
    """
    if still.stopped_since == NEVER:
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
    quiet = max(settings.quiet_gyro, 5.0 * settings.gyro_noise_density * math.sqrt(per_second))
    for k in range(first, end):
        if abs(rates[k] - mean) > quiet:
            return math.nan
    return mean


def stands(mean: float, bias: float, bias_sigma: float, margin: float) -> bool:
    """Return True if quiet readings are those of a standing robot.

    Args:
        mean: their mean; not a number if the robot moves [rad/s].
        bias: estimated bias of the gyro [rad/s].
        bias_sigma: standard deviation of that estimate [rad/s].
        margin: means this close to the bias are those of a standing robot in any case [rad/s].
    """
    return abs(mean - bias) <= max(margin, 4.0 * bias_sigma)


class StandstillDetector:
    """Detector of standstill of one streaming filter.

    Args:
        settings: settings of the filter.
    """

    def __init__(self, settings: InputSettings) -> None:
        self._settings = settings
        self._record = StandstillRecord()
        self._stamps, self._rates = [0] * ROOM, [0.0] * ROOM

    def memory(self) -> StandstillMemory:
        """Checkpoint of the present state."""
        record = self._record
        if record.end == 0:
            return StandstillMemory(record.stopped_since)
        kept = slice(record.first, record.end)
        return StandstillMemory(
            record.stopped_since, tuple(self._stamps[kept]), tuple(self._rates[kept])
        )

    def recall(self, memory: StandstillMemory) -> None:
        """Restore a checkpoint."""
        count = len(memory.stamps)
        self._record = StandstillRecord(memory.stopped_since, 0, count)
        self._stamps = [*memory.stamps, *[0] * ROOM]
        self._rates = [*memory.rates, *[0.0] * ROOM]

    def track_speeds(self, stamp: int, left: float, right: float) -> None:
        """Add track speeds [m/s] at a stamp [ns]."""
        stopped_after(self._record, stamp, left, right, self._settings.track_speed)

    def yaw_rate(self, stamp: int, reading: float) -> float:
        """Add a yaw-rate reading [rad/s] at a stamp [ns]; return the `quiet_mean`."""
        record, stamps, rates = self._record, self._stamps, self._rates
        if record.stopped_since == NEVER:
            return math.nan
        if record.end == len(stamps) and record.first < len(stamps) // 2:
            stamps += [0] * len(stamps)
            rates += [0.0] * len(rates)
        return quiet_mean(record, stamps, rates, stamp, reading, self._settings)
