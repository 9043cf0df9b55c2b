"""Normalised innovations over time, by component of each sensor."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.filter.health import Judged
from icreckon.estimator.sensors.measurement_models import innovation_components

Singles = NDArray[np.float32]


class InnovationRows:
    """Normalised innovations of a run, filled one row at a time.

    A row holds of each sensor the newest innovation that was judged since the row before, those that were
    rejected included, and NaN where there was none.

    Args:
        most: so many rows at most.
    """

    def __init__(self, most: int) -> None:
        self._components = innovation_components()
        self._columns: dict[str, Singles] = {}
        self._most = most
        self._seen: dict[str, int] = {}

    def put(self, row: int, judged: Iterable[tuple[str, Judged]]) -> None:
        """Write down what is new among the newest innovations of the sensors."""
        for sensor, (stamp, _, residual, covariance) in judged:
            if self._seen.get(sensor) == stamp:
                continue
            self._seen[sensor] = stamp
            for axis, name in enumerate(self._components[sensor]):
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
        known = (name for names in self._components.values() for name in names)
        names = tuple(name for name in known if name in self._columns)
        rows = np.empty((count, len(names)), np.float32)
        for column, name in enumerate(names):
            rows[:, column] = self._columns[name][:count]
        return names, rows
