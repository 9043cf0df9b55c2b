"""Workers for the blocks of a study: threads, processes, or an executor."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from icreckon.estimator.base.worker_processes import worker_processes

AHEAD = 2  # blocks queued per worker: it is never idle, and little is lost if it dies
THREADS = "study"


@dataclass(frozen=True)
class Workplace:
    """Workers behind an executor."""

    executor: Executor  # executor of the workers
    capacity: Callable[[], int]  # returns the number of blocks to submit at a time


# A workplace can be opened again when its workers have died.
OpenWorkplace = Callable[[], AbstractContextManager[Workplace]]


@contextmanager
def here(workers: int, *, threads: bool) -> Iterator[Workplace]:
    """Open workers on this machine: threads or processes."""
    if not threads:
        with worker_processes(workers) as processes:
            yield Workplace(processes, lambda: AHEAD * workers)
        return
    pool = ThreadPoolExecutor(workers, THREADS)
    try:
        yield Workplace(pool, lambda: AHEAD * workers)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


@contextmanager
def given(executor: Executor, workers: int) -> Iterator[Workplace]:
    """Use workers behind an executor that the caller opens and closes."""
    yield Workplace(executor, lambda: AHEAD * workers)
