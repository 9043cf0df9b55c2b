"""Normalised innovations over time, by component of each sensor."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.filter.health import Judged
from icreckon.estimator.sensors.measurement_models import IMU_SENSORS, innovation_components

Singles = NDArray[np.float32]


class InnovationRows:
    """Normalised innovations of a run, filled one row at a time.

    A row has the newest innovation of each sensor since the row before, of rejected measurements too, and
    NaN if there was none.

    Args:
        most: highest number of rows.
    """

    def __init__(self, most: int) -> None:
        self._components = innovation_components()
        self._columns: dict[str, Singles] = {}
        self._most = most
        self._written: dict[str, int] = {}

    def put(self, row: int, judged: Iterable[tuple[str, Judged]]) -> None:
        """Fill a row with those of the newest innovations of fixes that are in no row yet."""
        for sensor, (stamp, _, residual, covariance) in judged:
            if sensor in IMU_SENSORS or self._written.get(sensor) == stamp:
                continue
            self._written[sensor] = stamp
            for axis, name in enumerate(self._components[sensor]):
                variance = covariance[axis][axis]
                if variance > 0.0:
                    self.column(name)[row] = residual[axis] / math.sqrt(variance)

    def put_all(self, names: Sequence[str], values: Floats) -> None:
        """Fill columns (most, n) of components, but for those without any innovation."""
        for name, column in zip(names, values.T, strict=True):
            if not np.isnan(column).all():
                self._columns[name] = column.astype(np.float32)

    def column(self, name: str) -> Singles:
        """Column (most,) of a component, NaN if nothing was written."""
        found = self._columns.get(name)
        if found is None:
            found = self._columns[name] = np.full(self._most, np.nan, np.float32)
        return found

    def finish(self, count: int) -> tuple[tuple[str, ...], Singles]:
        """Names (k,) of components with innovations, and the first rows (count, k) [-]."""
        components = (name for names in self._components.values() for name in names)
        names = tuple(name for name in components if name in self._columns)
        rows = np.empty((count, len(names)), np.float32)
        for column, name in enumerate(names):
            rows[:, column] = self._columns[name][:count]
        return names, rows
