"""Lag search: sub-step minimum of a cost on an even grid, and its standard error."""

from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats, Indexes

BLOCKS = 8  # blocks of a log that are left out in turn for a standard error (jackknife)
BEYOND = 2.36  # standard errors of `BLOCKS` blocks in half a 95 % interval (Student's t)


def without_blocks(rows: Indexes) -> list[Indexes]:
    """Rows (n,) without each of `BLOCKS` blocks of them, for `jackknife_sigma`."""
    return [np.delete(rows, block) for block in np.array_split(np.arange(len(rows)), BLOCKS)]


def jackknife_sigma(without: Floats) -> Floats:
    """Standard errors (...) of an estimate, by those (b, ...) without one block each."""
    blocks, deviations = len(without), without - without.mean(axis=0)
    return np.asarray(np.sqrt((blocks - 1) / blocks * (deviations**2).sum(axis=0)))


def beside_lowest(costs: Floats, lowest: Any) -> Floats:
    """Offset of the parabola's minimum from the lowest cost, in grid steps [-].

    Costs (..., n) are on an even grid; `lowest` (...) is the index of the lowest one, not at either end.
    The offset is 0 where the costs do not bend upward.
    """
    places = np.expand_dims(lowest, -1) + np.arange(-1, 2)
    before, at, after = np.moveaxis(np.take_along_axis(costs, places, -1), -1, 0)
    bend = before - 2.0 * at + after
    return np.where(bend > 0.0, 0.5 * (before - after) / np.where(bend > 0.0, bend, 1.0), 0.0)
