"""Wheels or accelerations that come in messages of their own, interpolated."""

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.replay.reading.wheels import TOGETHER, interpolated

LONGEST = round(2.0 * TOGETHER / NANOSECOND)  # time between messages that belong together [ns]
CLEARLY_SLOWER = 0.9  # ratio of messages below which another wheel becomes the slowest [-]


class ApartMessages:
    """Newest values of wheels, until those of all can be interpolated.

    A row is ready once each wheel has a value at its stamp or later: up to an interval of the wheels
    after its message. Rows have the stamps of column `at`, or else of the slowest wheel, which is that
    with the fewest messages so far.
    """

    def __init__(self, at: int | None = None) -> None:
        self._at = at
        self._rows: list[tuple[int, Floats]] = []
        self._counts = np.zeros(0)  # messages of each wheel; empty before the first
        self._slowest = at or 0
        self._newest = -1  # stamp of the last row [ns]
        self._together = False  # True once a message has had all wheels

    def take(self, stamp: int, values: Floats, wrap: float | None) -> list[tuple[int, Floats]]:
        """Add a message; return the rows (k,) that it completes, with their stamps [ns].

        Values (k,) are NaN for wheels that it does not have; counters begin again at `wrap`.
        """
        known = ~np.isnan(values)
        self._together |= bool(known.all())
        if self._together:
            return [(stamp, values)]
        if self._rows and abs(stamp - self._rows[-1][0]) > LONGEST:
            self._rows, self._newest = [], -1  # a hole, or a clock that was set
        # Rows of the other wheels would pile up if one wheel never came.
        kept = [row for row in self._rows if stamp - row[0] <= LONGEST]
        self._rows = sorted([*kept, (stamp, values)], key=lambda row: row[0])
        self._counts = known + (self._counts if len(self._counts) else 0.0)
        fewest = CLEARLY_SLOWER * self._counts[self._slowest] - 1.0
        if self._at is None and self._counts.min() < fewest:
            self._slowest = int(self._counts.argmin())
        table = np.array([row for _, row in self._rows])
        if np.isnan(table).all(axis=0).any():
            return []  # a wheel has not come yet
        stamps = np.array([row_stamp for row_stamp, _ in self._rows])
        rows = zip(*interpolated(stamps, table, wrap, self._slowest), strict=True)
        ready = [(int(row_stamp), row) for row_stamp, row in rows if row_stamp > self._newest]
        if ready:
            self._newest, _ = ready[-1]
            # The next row needs the last value of each wheel.
            is_used = stamps <= self._newest
            first = min(stamps[is_used & ~np.isnan(column)].max() for column in table.T)
            self._rows = [row for row in self._rows if row[0] >= first]
        return ready
