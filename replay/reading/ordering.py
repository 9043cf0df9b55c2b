"""Sorting of messages that arrive slightly out of order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Stamps
from icreckon.estimator.log.log import screen

WINDOW = 1.0
"""Stamps out of order by up to this are sorted; others are dropped and counted [s]."""


def arrival_in_order(stamps: Stamps) -> tuple[NDArray[np.int64], int]:
    """Permutation that sorts samples that are early or late by up to `WINDOW`.

    Samples that are further out of order stay in place, for `screen` to drop.

    Args:
        stamps: (n,) [ns] in the order of arrival.

    Returns:
        (n,) indices of the samples in the new order; number of samples that moved.
    """
    count = len(stamps)
    places = np.arange(count)
    rising, _ = screen("", stamps)
    if rising.all():
        return places, 0
    kept = np.flatnonzero(rising)
    # Nearest in-order samples before and after each sample.
    place = np.searchsorted(kept, places, side="right")
    before = stamps[kept[np.maximum(place - 1, 0)]]
    after = stamps[kept[np.minimum(place, len(kept) - 1)]]
    near = np.minimum(_apart(stamps, before), _apart(stamps, after)) <= round(WINDOW / NANOSECOND)
    movable = np.flatnonzero(rising | near)
    ordered = places.copy()
    ordered[movable] = movable[np.argsort(stamps[movable], kind="stable")]
    moved = near & ~rising & (stamps != before) & (stamps != after)
    return ordered, int(moved.sum())


def _apart(stamps: Stamps, others: Stamps) -> NDArray[np.uint64]:
    """Absolute differences, unsigned so that damaged stamps cannot overflow them."""
    high, low = np.maximum(stamps, others), np.minimum(stamps, others)
    return high.astype(np.uint64) - low.astype(np.uint64)
