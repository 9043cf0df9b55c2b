"""Batch engine in single precision: twice as many lanes, with seven digits."""

from collections.abc import Sequence

from icreckon.simulation.running import batch_engine as study_batch
from icreckon.simulation.running.batch_engine import why_not
from icreckon.simulation.study.cells import Cell, Filter
from icreckon.simulation.study.failures import RunScores

__all__ = ["block", "why_not"]


def block(
    cell: Cell, filters: Sequence[Filter], first_run: int, count: int
) -> dict[str, RunScores]:
    """Statistics of some runs; see `icreckon.simulation.running.engines.Block`."""
    return study_batch.block(cell, filters, first_run, count, bits=32)
