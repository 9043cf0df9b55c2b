"""What became of the measurements: taken, rejected and why."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class SensorHealth:
    """Counts of one kind of measurement.

    Attributes:
        used: how many updated the filter.
        rejected: reason -> how many did not.
        nis_sum: sum of the normalised innovations squared of those that were used.
        degrees: sum of their degrees of freedom, which `nis_sum` should be near.
    """

    used: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    nis_sum: float = 0.0
    degrees: int = 0

    @property
    def nis_per_degree(self) -> float:
        """Mean NIS per degree of freedom; 1 when the filter's uncertainty is right, NaN if unused."""
        return self.nis_sum / self.degrees if self.degrees else float("nan")


@dataclass
class Health:
    """Counts of all kinds of measurements, by name, and of the standstill updates."""

    sensors: dict[str, SensorHealth] = field(default_factory=dict)
    standstill_updates: int = 0

    def sensor(self, name: str) -> SensorHealth:
        """The counts of one kind, made when first asked for."""
        return self.sensors.setdefault(name, SensorHealth())

    def rejections(self) -> dict[str, int]:
        """How many measurements were rejected, by "sensor: reason"."""
        return {
            f"{name}: {reason}": count
            for name, sensor in self.sensors.items()
            for reason, count in sorted(sensor.rejected.items())
        }
