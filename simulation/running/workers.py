"""Workers for the blocks of a study: threads, processes, or a cluster."""

import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from icreckon.estimator.base.worker_processes import worker_processes
from icreckon.simulation.base.errors import SimulationError

AHEAD = 2  # blocks queued per worker: it is never idle, and little is lost if it dies
CONNECT_SECONDS = 20.0
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


@contextmanager
def cluster(address: str) -> Iterator[Workplace]:
    """Connect to the workers of a `dask.distributed` scheduler, as tcp://host:8786."""
    try:
        import distributed
    except ImportError:
        raise SimulationError(
            "a cluster needs the extra of that name: pip install 'icreckon[cluster]'"
        ) from None
    _require_listener(address)
    connect: Any = distributed.Client
    try:
        client = connect(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as problem:
        raise SimulationError(f"no cluster at {address!r}: {problem}") from None
    try:
        threads = client.nthreads
        yield Workplace(client.get_executor(), lambda: AHEAD * max(1, sum(threads().values())))
    finally:
        client.close()


def _require_listener(address: str) -> None:
    """Reject an address at which nothing listens, for which the client would wait."""
    # Addresses that are no TCP sockets are left to the client.
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.scheme not in {"tcp", "tls"}:
        return
    try:
        host, port = parts.hostname, parts.port
    except ValueError:  # no number, or out of range
        host, port = None, None
    if host is None or port is None:
        raise SimulationError(f"no cluster at {address!r}: give host and port, as tcp://host:8786")
    try:
        socket.create_connection((host, port), CONNECT_SECONDS).close()
    except OSError as problem:
        raise SimulationError(f"no cluster at {address!r}: {problem}") from None
