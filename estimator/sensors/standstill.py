"""Standstill detection: both tracks stopped, and a gyro that reads only its bias."""

from __future__ import annotations

import math
from collections import deque

import msgspec

from icreckon.estimator.robot.settings import StandstillSettings


class StandstillMemory(msgspec.Struct, frozen=True):
    """Checkpoint of a `StandstillDetector`.

    Attributes:
        stopped_since: stamp of the first track speeds that were slow enough [ns], or None.
        readings: yaw-rate readings since then: stamp [ns], reading [rad/s].
    """

    stopped_since: int | None = None
    readings: tuple[tuple[int, float], ...] = ()


class StandstillDetector:
    """Detector of standstill from track speeds and yaw-rate readings."""

    def __init__(self, settings: StandstillSettings, gyro_noise_density: float) -> None:
        self._settings = settings
        self._density = gyro_noise_density
        self._stopped_since: int | None = None
        self._readings: deque[tuple[int, float]] = deque()

    def memory(self) -> StandstillMemory:
        """Checkpoint of the present state."""
        return StandstillMemory(self._stopped_since, tuple(self._readings))

    def recall(self, memory: StandstillMemory) -> None:
        """Restore a checkpoint."""
        self._stopped_since = memory.stopped_since
        self._readings = deque(memory.readings)

    def track_speeds(self, stamp: int, left: float, right: float) -> None:
        """Add track speeds [m/s] at a stamp [ns]."""
        if max(abs(left), abs(right)) >= self._settings.track_speed:
            self._stopped_since = None
            self._readings.clear()
        elif self._stopped_since is None:
            self._stopped_since = stamp

    def yaw_rate(self, stamp: int, reading: float, bias: float, bias_sigma: float) -> bool:
        """Add a yaw-rate reading; return True if the robot stands.

        Args:
            stamp: stamp of the reading [ns].
            reading: measured yaw rate [rad/s].
            bias: present estimate of the gyro's bias [rad/s].
            bias_sigma: standard deviation of that estimate [rad/s].
        """
        if self._stopped_since is None:
            return False
        settings = self._settings
        readings = self._readings
        readings.append((stamp, reading))
        oldest_needed = stamp - int(settings.duration * 1e9)
        while len(readings) > 1 and readings[1][0] <= oldest_needed:
            readings.popleft()
        if self._stopped_since > oldest_needed or readings[0][0] > oldest_needed:
            return False
        values = [value for _, value in readings]
        mean = math.fsum(values) / len(values)
        rate = (len(values) - 1) * 1e9 / (readings[-1][0] - readings[0][0])
        quiet = max(settings.quiet_gyro, 5.0 * self._density * math.sqrt(rate))
        if max(abs(value - mean) for value in values) > quiet:
            return False
        return abs(mean - bias) <= max(settings.bias_margin, 4.0 * bias_sigma)
