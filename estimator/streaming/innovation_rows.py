"""Normalised innovations over time: how far measurements were from what a filter expected of them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.filter.health import Judged

# Of each sensor whose innovations are judged, the names of its components; units are gone, since each
# is divided by the standard deviation that it should have. Components as in `JudgedInnovation`.
COMPONENTS: dict[str, tuple[str, ...]] = {
    "gyro": ("gyro",),
    "accelerometer": ("accelerometer",),
    "position": ("position_x", "position_y"),
    "heading": ("heading",),
    "body velocity": ("body_velocity_x", "body_velocity_y"),
    "pose": ("pose_x", "pose_y", "pose_yaw"),
    "zero velocity": ("zero_velocity_x", "zero_velocity_y", "zero_velocity_w"),
}
INNOVATION_NAMES: tuple[str, ...] = tuple(name for names in COMPONENTS.values() for name in names)

Singles = NDArray[np.float32]


class InnovationRows:
    """Normalised innovations of a run, filled one row at a time.

    A row holds of each sensor the newest innovation that was judged since the row before, those that were
    rejected included, and NaN where there was none.

    Args:
        most: so many rows at most.
    """

    def __init__(self, most: int) -> None:
        self._columns: dict[str, Singles] = {}
        self._most = most
        self._seen: dict[str, int] = {}

    def put(self, row: int, judged: Iterable[tuple[str, Judged]]) -> None:
        """Write down what is new among the newest innovations of the sensors."""
        for sensor, (stamp, _, residual, covariance) in judged:
            if self._seen.get(sensor) == stamp:
                continue
            self._seen[sensor] = stamp
            for axis, name in enumerate(COMPONENTS[sensor]):
                variance = covariance[axis][axis]
                if variance > 0.0:
                    self.column(name)[row] = residual[axis] / math.sqrt(variance)

    def column(self, name: str) -> Singles:
        """Column (most,) of a component, NaN where nothing is written."""
        found = self._columns.get(name)
        if found is None:
            found = self._columns[name] = np.full(self._most, np.nan, np.float32)
        return found

    def finish(self, count: int) -> tuple[tuple[str, ...], Singles]:
        """Names (k,) of the components that were judged at all, and the first rows (count, k) [-]."""
        names = tuple(name for name in INNOVATION_NAMES if name in self._columns)
        rows = np.empty((count, len(names)), np.float32)
        for column, name in enumerate(names):
            rows[:, column] = self._columns[name][:count]
        return names, rows
