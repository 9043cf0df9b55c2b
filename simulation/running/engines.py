"""Engines that compute the runs of a study: same statistics, at different speeds.

An engine is a module with a function `block`, and optionally `why_not` of a `Plan`: the reason why it
cannot run that plan, or None.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, cast

from icreckon.simulation.study.cells import Cell, Filter, Plan
from icreckon.simulation.study.failures import RunScores

ROOM = "icreckon.simulation.running"


Block = Callable[[Cell, Sequence[Filter], int, int], RunScores]
"""Function that computes a block: cell, filters, first run and number of runs -> `RunScores`.

It is pure: it may run on any worker, and be repeated. Random streams derive from the study's seed and the
run's index (`icreckon.simulation.base.random_streams`); trajectory and truth take the index modulo
`cell.truths`. So cells and filters are paired, run by run.
"""


@dataclass(frozen=True)
class Engine:
    """Engine of a study."""

    name: str  # name in study files and commands
    module: str  # module of its functions
    block_runs: int  # runs of a block; part of the study's identity, independent of workers
    threads: bool  # True if it runs in threads (it releases the GIL), False if it needs processes

    @property
    def block(self) -> Block:
        """Function `block` of the engine's module."""
        return cast(Block, import_module(self.module).block)

    def why_not(self, plan: Plan) -> str | None:
        """Reason why it cannot run a study, by its module's `why_not`; None if it can."""
        check: Any = getattr(import_module(self.module), "why_not", None)
        return None if check is None else check(plan)


BATCH = Engine("batch", f"{ROOM}.batch_engine", block_runs=64, threads=True)
STREAMING = Engine("streaming", f"{ROOM}.streaming_engine", block_runs=4, threads=False)
ENGINES = [BATCH, STREAMING]  # the fastest first; the last one runs any study


def choose_engine(plan: Plan) -> Engine:
    """Choose the first engine that can run a study."""
    return next(engine for engine in ENGINES if engine.why_not(plan) is None)
