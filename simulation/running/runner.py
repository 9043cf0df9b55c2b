"""Job queue of a study: blocks are submitted, stored, and submitted again if lost."""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import IcreckonError
from icreckon.estimator.base.worker_processes import worker_processes
from icreckon.estimator.streaming.lost import described
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.running.engines import Block, Engine
from icreckon.simulation.running.manifest import computing_versions
from icreckon.simulation.running.store import BlockStore, Job, Reasons
from icreckon.simulation.study.cells import Cell, Plan
from icreckon.simulation.study.failures import RunScores, exclude_failed, unscored

BLOCKS_PER_WORKER = 2  # blocks queued: no worker is ever idle, and little is lost if one dies
MOST_TRIES = 4  # A block is not tried again after this many workers have died in it
POLL_SECONDS = 0.5  # longest wait for blocks between checks for signals [s]


@dataclass(frozen=True)
class Progress:
    """Progress of a study, in blocks, and in runs of one filter each."""

    blocks: int  # finished blocks
    all_blocks: int  # blocks of the study
    found_blocks: int  # blocks in the store at the start
    runs: int  # runs computed by this command
    runs_left: int  # runs still to compute


Report = Callable[[Progress], None]
Worked = tuple[Floats, Reasons, dict[str, str]]  # statistics, reasons and versions, see `work`


def work(engine: Engine, cell: Cell, first_run: int, count: int) -> Worked:
    """Compute a block on the worker: `count` runs of a cell from run `first_run` on.

    If the block raises an exception, its runs are repeated one by one, and only those that raise it
    again fail. The result is the statistics (filters, runs, statistics), NaN for failed runs, the
    reasons of failed runs (filters, runs), empty for the others, and the versions of the packages that
    compute.
    """
    try:
        scores = engine.block(cell, cell.filters, first_run, count)
    except MemoryError:
        raise
    except Exception:
        scores = _run_by_run(engine.block, cell, first_run, count)
    exclude_failed(scores, cell.horizons)
    return scores.values, scores.reasons.astype(str), computing_versions()


def _run_by_run(block: Block, cell: Cell, first_run: int, count: int) -> RunScores:
    """Score runs one at a time; an exception becomes the reason of a failed run.

    Only MemoryError is raised: it is a failure of the worker, not of the run.
    """
    scores = unscored(len(cell.filters), count, cell.horizons)
    for place, row in np.ndindex(scores.reasons.shape):
        try:
            single = block(cell, [cell.filters[place]], first_run + row, 1)
        except MemoryError:
            raise
        except IcreckonError as problem:
            scores.reasons[place, row] = str(problem)
        except Exception as problem:
            scores.reasons[place, row] = described(problem)
        else:
            scores.values[place, row] = single.values[0, 0]
            scores.reasons[place, row] = single.reasons[0, 0]
    return scores


@contextmanager
def _worker_threads(count: int) -> Iterator[Executor]:
    """Open threads; if the block raises an error, do not wait for them."""
    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


class Runner:
    """Runner of a study: computes all blocks (jobs) that the store does not have.

    `report` is called at the start and after each block.
    """

    def __init__(
        self,
        plan: Plan,
        engine: Engine,
        jobs: Sequence[Job],
        store: BlockStore,
        report: Report | None,
    ) -> None:
        self._plan, self._engine, self._store = plan, engine, store
        self._report = report or (lambda _: None)
        self._waiting = deque(job for job in jobs if store.read(job) is None)
        finished, left = len(jobs) - len(self._waiting), sum(map(self._runs_of, self._waiting))
        self._progress = Progress(finished, len(jobs), finished, runs=0, runs_left=left)
        self._lost: Counter[Job] = Counter()

    def run(self, workers: int, executor: Executor | None) -> None:
        """Run all blocks on an executor, or else on workers; open workers that died again.

        Raises:
            SimulationError: a block fails, or its workers die repeatedly.
        """
        self._report(self._progress)
        while self._waiting:
            # If workers die, all submitted blocks are queued again; the next workers are new.
            with self._opened(workers, executor) as pool, suppress(BrokenExecutor):
                self._work_through(pool.submit, BLOCKS_PER_WORKER * workers)

    def _opened(self, workers: int, executor: Executor | None) -> AbstractContextManager[Executor]:
        """Executor of the caller, who closes it, or else threads or processes."""
        if executor is not None:
            return nullcontext(executor)
        return _worker_threads(workers) if self._engine.threads else worker_processes(workers)

    def _work_through(self, submit: Callable[..., Future[Worked]], most: int) -> None:
        """Settle all blocks, `most` at once; if workers die, queue theirs again and raise."""
        futures: dict[Future[Worked], Job] = {}
        try:
            while self._waiting or futures:
                while self._waiting and len(futures) < most:
                    job = self._waiting[0]
                    block = (self._plan.cells[job.cell], job.first_run, job.count)
                    futures[submit(work, self._engine, *block)] = job
                    self._waiting.popleft()  # only now: `submit` raises if the workers have died
                done, _ = wait(futures, timeout=POLL_SECONDS, return_when=FIRST_COMPLETED)
                for future in done:
                    self._settle(future, futures.pop(future))
        except BrokenExecutor as problem:
            for job in futures.values():
                self._lose(job, problem)
            raise
        except BaseException:
            for future in futures:
                future.cancel()
            raise

    def _settle(self, future: Future[Worked], job: Job) -> None:
        """Store the result of a block, or queue it again if its worker has died."""
        try:
            values, reasons, versions = future.result()
        except (BrokenExecutor, CancelledError) as problem:
            self._lose(job, problem)
            if isinstance(problem, BrokenExecutor):
                raise
            return
        except Exception as problem:
            text = f"{self._named(job)}: {type(problem).__name__}: {problem}"
            raise SimulationError(text) from problem
        if versions != computing_versions():
            raise SimulationError(
                f"a worker computes with {versions}, and this command with {computing_versions()}: "
                "results would be a mixture; give all workers the same versions"
            )
        self._store.write(job, values, reasons)
        done, runs = self._progress, self._runs_of(job)
        self._progress = replace(
            done, blocks=done.blocks + 1, runs=done.runs + runs, runs_left=done.runs_left - runs
        )
        self._report(self._progress)

    def _lose(self, job: Job, problem: BaseException) -> None:
        """Queue a block again whose worker has died."""
        self._lost[job] += 1
        if self._lost[job] >= MOST_TRIES:
            raise SimulationError(
                f"{self._named(job)}: its worker died {MOST_TRIES} times (out of memory?); the last "
                f"time: {type(problem).__name__}: {problem}"
            ) from problem
        self._waiting.appendleft(job)

    def _named(self, job: Job) -> str:
        cell = self._plan.cells[job.cell]
        values = ", ".join(f"{key} = {value}" for key, value in cell.values.items())
        where = f" ({values})" if values else ""
        return f"cell {job.cell}{where}, runs from {job.first_run} on"

    def _runs_of(self, job: Job) -> int:
        return job.count * len(self._plan.labels)
