"""Whether a measurement can be right by itself, before the filter is asked."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from estimator.errors import EstimatorError
from estimator.log import NANOSECOND

# So many samples in a row must agree before a clock that jumped ahead is believed.
CLOCK_WITNESSES = 10


class Admission:
    """Keeps the newest stamp of each stream, and objects to what does not fit.

    Args:
        late: a measurement this much older than the estimate is still taken [s].
        longest_gap: a stamp this much ahead of the estimate is not believed, unless
            `CLOCK_WITNESSES` of its stream in a row are [s].

    Attributes:
        newest: stream -> stamp of its newest admitted measurement [ns].
    """

    def __init__(self, late: float, longest_gap: float) -> None:
        self._late = late
        self._longest_gap = int(longest_gap / NANOSECOND)
        self.newest: dict[str, int] = {}
        # Of each stream: how many samples in a row were far ahead, and the newest of them.
        self._witnesses: dict[str, tuple[int, int]] = {}

    def objection(
        self,
        stream: str,
        stamp: int,
        now: int | None,
        values: Sequence[float],
        variance: float = 1.0,
    ) -> str | None:
        """Why a measurement cannot be right; None admits it.

        Args:
            stream: name of the stream.
            stamp: of the measurement [ns].
            now: stamp of the estimate [ns], or None before the first.
            values: all that it measured.
            variance: of what it measured.

        Raises:
            EstimatorError: the stamp is no integer.
        """
        if not isinstance(stamp, int | np.integer):
            raise EstimatorError(f"{stream}: a stamp is an integer of nanoseconds, found {stamp!r}")
        newest = self.newest.get(stream)
        if not all(map(math.isfinite, values)):
            return "not finite"
        if not (math.isfinite(variance) and variance > 0.0):
            return "variance not positive"
        if newest is not None and stamp == newest:
            return "duplicate stamp"
        if newest is not None and stamp < newest:
            return "stamp goes backward"
        if now is not None and (now - stamp) * NANOSECOND > self._late:
            return "too late"
        if now is not None and self._is_far_ahead(stream, stamp, now):
            return "stamp far ahead"
        self.newest[stream] = stamp
        return None

    def _is_far_ahead(self, stream: str, stamp: int, now: int) -> bool:
        """Whether a stamp is so far ahead that it is wrong, unless others of its stream agree."""
        if stamp - now <= self._longest_gap:
            self._witnesses.pop(stream, None)
            return False
        count, before = self._witnesses.get(stream, (0, stamp))
        agrees = 0 <= stamp - before <= self._longest_gap
        count = count + 1 if agrees else 1
        self._witnesses[stream] = (count, stamp)
        return count < CLOCK_WITNESSES


def require_three(name: str, values: Sequence[float]) -> None:
    """Raise EstimatorError unless these are three numbers."""
    try:
        count = len([float(value) for value in values])
    except (TypeError, ValueError):
        count = 0
    if count != 3:
        raise EstimatorError(f"{name} must be three numbers, found {values!r}")
