"""Variants and cells of a study whose results agree to rounding.

The keys in which they differ have no effect.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats

# Relative difference up to which statistics of a run count as equal.
ROUNDING = 1e-9


def alike(values: Floats, axis: int) -> list[list[int]]:
    """Group the indices along an axis at which all statistics are equal to rounding.

    Groups have two or more indices.

    Args:
        values: (filters, cells, runs, statistics); NaN for missing values.
        axis: 0 for filters, 1 for cells.
    """
    places = np.moveaxis(values, axis, 0)
    known = np.isfinite(places)
    sums = np.where(known, places, 0.0).reshape(len(places), -1).sum(axis=1)
    found: list[list[int]] = []
    previous = None
    for place in np.argsort(sums, kind="stable").tolist():
        if not known[place].any():
            continue
        if previous is not None and _same(places[previous], places[place]):
            found[-1].append(place)
        else:
            found.append([place])
            previous = place
    return sorted(sorted(group) for group in found if len(group) > 1)


def _same(one: Any, other: Any) -> bool:
    larger = np.maximum(np.abs(one), np.abs(other))
    apart = np.abs(one - other) > ROUNDING * larger
    return bool(np.array_equal(np.isfinite(one), np.isfinite(other)) and not apart.any())
