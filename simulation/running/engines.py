"""What works out the runs of a study: engines that give the same statistics, at different speeds.

An engine is a module with a function `block` and, if it has something to say, `why_not` and
`in_threads`, of a `Plan`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, cast

from icreckon.estimator.base.errors import nearest_hint
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.study.cells import Cell, Filter, Plan
from icreckon.simulation.study.failures import RunScores

AUTO = "auto"


class Block(Protocol):
    """Some runs of a cell: a pure function, so that it may run anywhere, and again."""

    def __call__(
        self, cell: Cell, filters: Sequence[Filter], first_run: int, count: int
    ) -> dict[str, RunScores]:
        """The statistics of the runs.

        Random numbers are those of `simulation.scenario.random_streams` by the study's seed and the
        run's index, those of drive and truth by the index modulo `cell.truths`; so cells and filters
        are paired, run by run.

        Args:
            cell: where the runs belong.
            filters: which of its filters to run.
            first_run: index of the first run.
            count: number of runs.

        Returns:
            Label of the filter -> statistics of the runs, and reasons of those that failed.
        """


@dataclass(frozen=True)
class Engine:
    """An engine.

    Attributes:
        name: what it is chosen by.
        module: where its functions are.
        block_runs: runs of a block; part of the study's identity, never a matter of workers.
        threads: whether it works in threads (it lets go of the interpreter), or needs processes, unless
            its module says otherwise of a study.
    """

    name: str
    module: str
    block_runs: int
    threads: bool

    @property
    def block(self) -> Block:
        """Its function."""
        return cast(Block, import_module(self.module).block)

    def why_not(self, plan: Plan) -> str | None:
        """Why it cannot work out a study, by its module's `why_not`; None where it can."""
        ask: Any = getattr(import_module(self.module), "why_not", None)
        return None if ask is None else ask(plan)

    def in_threads(self, plan: Plan) -> bool:
        """Whether it works out a study in threads, by its module's `in_threads` or by `threads`."""
        ask: Any = getattr(import_module(self.module), "in_threads", None)
        return self.threads if ask is None else bool(ask(plan))


# The first that can is chosen by "auto".
ENGINES = {
    engine.name: engine
    for engine in (
        Engine("batch", "icreckon.simulation.running.batch_engine", block_runs=64, threads=True),
        Engine(
            "streaming", "icreckon.simulation.running.streaming_engine", block_runs=4, threads=False
        ),
        Engine(
            "single", "icreckon.simulation.running.single_precision", block_runs=64, threads=True
        ),
    )
}


def why_slow(plan: Plan, chosen: Engine) -> str | None:
    """Why the fastest engine was not chosen, for people; None where it was, or another was wanted."""
    fastest = next(iter(ENGINES.values()))
    return None if chosen.name == fastest.name else fastest.why_not(plan)


def choose_engine(plan: Plan, wanted: str | None = None) -> Engine:
    """The engine for a study.

    Args:
        plan: the study.
        wanted: name of an engine or "auto"; that of the study where left out.

    Raises:
        SimulationError: no such engine, or one that cannot work out this study (says why).
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
