"""Engines that compute the runs of a study: same statistics, at different speeds.

An engine is a module with a function `block`, and optionally `why_not` of a `Plan`: the reason why it
cannot run that plan, or None.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, cast

from icreckon.estimator.base.errors import nearest_hint
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.study.cells import Cell, Filter, Plan
from icreckon.simulation.study.failures import RunScores

AUTO = "auto"
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


# "auto" chooses the first engine that can run the study; the last one runs any.
ENGINES = {
    engine.name: engine
    for engine in (
        Engine("batch", f"{ROOM}.batch_engine", block_runs=64, threads=True),
        Engine("streaming", f"{ROOM}.streaming_engine", block_runs=4, threads=False),
    )
}


def choose_engine(plan: Plan, wanted: str | None = None) -> Engine:
    """Choose the engine for a study: a wanted one, "auto", or None for the study's.

    Raises:
        SimulationError: no such engine, or one that cannot run this study (the message says why).
    """
    name = wanted or plan.study.engine
    if name == AUTO:
        return next(engine for engine in ENGINES.values() if engine.why_not(plan) is None)
    if name not in ENGINES:
        raise SimulationError(f"no engine {name!r}{nearest_hint(name, [AUTO, *ENGINES])}")
    reason = ENGINES[name].why_not(plan)
    if reason is not None:
        raise SimulationError(f"the engine {name!r} cannot work out this study: {reason}")
    return ENGINES[name]
