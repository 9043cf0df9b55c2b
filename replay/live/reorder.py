"""Reorder buffer: from the order of arrival to the order of stamps."""

import heapq
import math
from itertools import count, groupby

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.input_checks import Key, key_of
from icreckon.estimator.log.measurements import Measurement

JUMP = 1.0  # step between two stamps beyond which the clock has jumped and nothing is held any more [s]


class ReorderBuffer:
    """Buffer that holds measurements for a wait [s], until older ones have come."""

    def __init__(self, wait: float) -> None:
        self._wait = round(wait / NANOSECOND)
        self._jump = self._wait + round(JUMP / NANOSECOND)
        # The numbers keep equal keys in the order of arrival.
        self._heap: list[tuple[Key, int, Measurement]] = []
        self._numbers = count()
        self._last: int | None = None

    def put(self, measurements: list[Measurement]) -> list[list[Measurement]]:
        """Add measurements; return those that are due, one list for each stamp, in order."""
        due: list[list[Measurement]] = []
        for measurement in measurements:
            before, self._last = self._last, measurement.stamp
            if before is not None and abs(measurement.stamp - before) > self._jump:
                due += self.take_all()
            heapq.heappush(self._heap, (key_of(measurement), next(self._numbers), measurement))
        if not self._wait:
            return due + self.take_all()
        # A stamp is complete only when a later one is there.
        return due + self.take_all((self._last or 0) - self._wait)

    def take_all(self, until: float = math.inf) -> list[list[Measurement]]:
        """Remove all measurements before a stamp [ns]; return a list for each stamp."""
        ready = []
        while self._heap and self._heap[0][-1].stamp < until:
            ready.append(heapq.heappop(self._heap)[-1])
        by_stamp = groupby(ready, key=lambda measurement: measurement.stamp)
        return [list(group) for _, group in by_stamp]
