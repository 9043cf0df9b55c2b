"""Workers for the blocks of a study: threads, processes, or an executor."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager

from icreckon.estimator.base.worker_processes import worker_processes

AHEAD = 2  # blocks queued per worker: it is never idle, and little is lost if it dies
THREADS = "study"


# Workers can be opened again when they have died.
OpenWorkers = Callable[[], AbstractContextManager[Executor]]


@contextmanager
def opened(workers: int, executor: Executor | None, *, threads: bool) -> Iterator[Executor]:
    """Open threads or processes; an executor that is given is its caller's to close."""
    if executor is not None:
        yield executor
        return
    if not threads:
        with worker_processes(workers) as processes:
            yield processes
        return
    pool = ThreadPoolExecutor(workers, THREADS)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
