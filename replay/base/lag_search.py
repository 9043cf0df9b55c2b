"""Lag search: sub-step minimum of a cost sampled on an even grid."""

from __future__ import annotations

from icreckon.estimator.base.array_types import Floats


def beside_lowest(costs: Floats, lowest: int) -> float:
    """Offset of the parabola's minimum from the lowest cost, in grid steps [-].

    Args:
        costs: (n,) on an even grid.
        lowest: index of the lowest cost, not at either end.
    """
    before, at, after = costs[lowest - 1 : lowest + 2]
    bend = before - 2.0 * at + after
    return float(0.5 * (before - after) / bend) if bend > 0.0 else 0.0
