"""Worker processes that end with their parent, and leave interrupts to it."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

STOPS = (signal.SIGINT, signal.SIGTERM)


class _Pool(ProcessPoolExecutor):
    """Pool whose workers never see Ctrl-C, from their first instruction on."""

    def submit(self, *call: Any, **options: Any) -> Future[Any]:
        """Submit a call, as `ProcessPoolExecutor.submit`, which may start a worker."""
        with _postponed(), _blocked():
            return super().submit(*call, **options)


@contextmanager
def _blocked() -> Iterator[None]:
    """Block Ctrl-C in this thread; a process that is started inherits that."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _postponed() -> Iterator[None]:
    """Handle signals after the block, so that no process is left half started."""
    postponed: list[int] = []
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in STOPS:
            if callable(signal.getsignal(number)):
                before[number] = signal.signal(number, lambda number, _: postponed.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if postponed:
            signal.raise_signal(postponed[0])


@contextmanager
def worker_processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of processes; kill them if the block raises, or this process dies."""
    context = multiprocessing.get_context("spawn")
    # Nothing is ever sent: a worker that waits at `workers_end` exits when `own_end` is closed, as it is
    # when this process dies.
    workers_end, own_end = context.Pipe(duplex=False)
    children_before = multiprocessing.active_children()
    pool = _Pool(count, context, _begin, (workers_end,))
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            if process not in children_before:
                process.kill()
        pool.shutdown(cancel_futures=True)
        raise
    else:
        pool.shutdown()
    finally:
        own_end.close()
        workers_end.close()


def _begin(closes: Connection) -> None:
    """Begin a worker that exits when its parent closes the pipe or dies."""
    threading.Thread(target=_exit_with_parent, args=(closes,), daemon=True).start()


def _exit_with_parent(closes: Connection) -> None:
    try:
        closes.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)
