"""Variants and cells of a study whose results agree to rounding: what they differ in does not act."""

from __future__ import annotations

from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats

# Statistics of a run that differ by less, relatively, are the same.
ROUNDING = 1e-9


def alike(values: Floats, axis: int) -> list[list[int]]:
    """Places along an axis at which all statistics are the same to rounding, in groups of two or more.

    Args:
        values: (filters, cells, runs, statistics); NaN where there is none.
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
