"""Lag search: the lowest place of a cost that is known on an even grid."""

from __future__ import annotations

from icreckon.estimator.base.array_types import Floats


def beside_lowest(costs: Floats, lowest: int) -> float:
    """How far beside the lowest of even costs (n,) the parabola there is lowest, in steps [-]."""
    before, at, after = costs[lowest - 1 : lowest + 2]
    bend = before - 2.0 * at + after
    return float(0.5 * (before - after) / bend) if bend > 0.0 else 0.0
