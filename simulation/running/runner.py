"""Job queue of a study: blocks are submitted to workers, and their results stored."""

from collections import deque
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
from contextlib import AbstractContextManager, contextmanager, nullcontext
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
DEAD = BrokenExecutor, CancelledError  # of blocks whose worker died
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


def run_jobs(
    plan: Plan,
    engine: Engine,
    jobs: Sequence[Job],
    store: BlockStore,
    *,
    workers: int,
    executor: Executor | None = None,
    report: Report | None = None,
) -> None:
    """Compute all blocks (jobs) that the store does not have.

    They run on the executor, or else on threads or processes. `report` is called at the start and after
    each block.

    Raises:
        SimulationError: a block fails, or a worker dies; finished blocks are kept.
    """
    report = report or (lambda _: None)
    waiting = deque(job for job in jobs if store.read(job) is None)
    filters, finished = len(plan.labels), len(jobs) - len(waiting)
    runs_left = filters * sum(job.count for job in waiting)
    progress = Progress(finished, len(jobs), finished, runs=0, runs_left=runs_left)
    report(progress)
    if not waiting:
        return
    futures: dict[Future[Worked], Job] = {}
    with _opened(workers, executor, threads=engine.threads) as pool:
        try:
            while waiting or futures:
                while waiting and len(futures) < BLOCKS_PER_WORKER * workers:
                    job = waiting.popleft()
                    cell = plan.cells[job.cell]
                    futures[pool.submit(work, engine, cell, job.first_run, job.count)] = job
                done, _ = wait(futures, timeout=POLL_SECONDS, return_when=FIRST_COMPLETED)
                for future in done:
                    job = futures.pop(future)
                    values, reasons = _result(future, plan.cells[job.cell], job)
                    store.write(job, values, reasons)
                    runs = filters * job.count
                    progress = replace(
                        progress,
                        blocks=progress.blocks + 1,
                        runs=progress.runs + runs,
                        runs_left=progress.runs_left - runs,
                    )
                    report(progress)
        except DEAD as problem:
            raise SimulationError(
                f"a worker died (out of memory?): {problem}; finished blocks are kept: give the same "
                "command again, with fewer workers"
            ) from problem
        except BaseException:
            for future in futures:
                future.cancel()
            raise


def _opened(
    workers: int, executor: Executor | None, *, threads: bool
) -> AbstractContextManager[Executor]:
    """Executor of the caller, who closes it, or else threads or processes."""
    if executor is not None:
        return nullcontext(executor)
    return _worker_threads(workers) if threads else worker_processes(workers)


def _result(future: Future[Worked], cell: Cell, job: Job) -> tuple[Floats, Reasons]:
    """Statistics and reasons of a block; a SimulationError if it failed."""
    try:
        values, reasons, versions = future.result()
    except DEAD:
        raise
    except Exception as problem:
        changes = ", ".join(f"{key} = {value}" for key, value in cell.values.items())
        where = f" ({changes})" if changes else ""
        raise SimulationError(
            f"cell {cell.index}{where}, runs from {job.first_run} on: {type(problem).__name__}: {problem}"
        ) from problem
    if versions != computing_versions():
        raise SimulationError(
            f"a worker computes with {versions}, and this command with {computing_versions()}: "
            "results would be a mixture; give all workers the same versions"
        )
    return values, reasons
