"""Messages that come out of order, put in order where that is by little."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Stamps
from icreckon.estimator.log.log import screen

WINDOW = 1.0
"""Stamps that are out of order by less than this are sorted, others are dropped and counted [s]."""


def arrival_in_order(stamps: Stamps) -> tuple[NDArray[np.int64], int]:
    """How to take samples so that those early or late by less than `WINDOW` stand in place.

    What is further out stays where it is, for `screen` to drop.

    Args:
        stamps: (n,) [ns] in the order of arrival.

    Returns:
        (n,) places of the samples, in the new order; how many samples moved.
    """
    count = len(stamps)
    places = np.arange(count)
    rising, _ = screen("", stamps)
    if rising.all():
        return places, 0
    kept = np.flatnonzero(rising)
    # Of each sample the ones next to it, before and after, that are in order.
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
    """Distances; unsigned ones do not overflow, however far apart damaged stamps are."""
    high, low = np.maximum(stamps, others), np.minimum(stamps, others)
    return high.astype(np.uint64) - low.astype(np.uint64)
