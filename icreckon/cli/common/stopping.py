"""Ctrl-C and SIGTERM: cleaned up, one line, exit status 128 and the signal."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

NAMES = {
    "SIGINT": "interrupted",
    "SIGTERM": "terminated",
    "SIGHUP": "terminated: its terminal is gone",
}
# Packages that crash if an interrupt leaves unfinished what LLVM called them for.
FRAGILE = ("llvmlite.", "numba.")
SOON = 0.05  # time after which a command that could not be unwound is tried again [s]


class Stop:
    """Signal that stops a command, and the advice to print with it."""

    number = 0  # the signal, 0 if none came
    advice = ""  # how to go on, set by the command

    @classmethod
    def handle(cls, number: int, frame: FrameType | None) -> None:
        """Unwind the command once; the next signal ends it at once."""
        cls.number = number
        for name in NAMES:
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_DFL)
        cls.unwind(signal.SIGINT, frame)

    @classmethod
    def unwind(cls, _: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, as soon as no frame of `FRAGILE` is on the stack."""
        while frame is not None:
            if str(frame.f_globals.get("__name__")).startswith(FRAGILE) and cls.unwind_soon():
                return
            frame = frame.f_back
        raise KeyboardInterrupt

    @classmethod
    def unwind_soon(cls) -> bool:
        """Unwind again after `SOON`; return False on systems without such a timer."""
        if sys.platform == "win32":
            return False
        signal.signal(signal.SIGALRM, cls.unwind)
        signal.setitimer(signal.ITIMER_REAL, SOON)
        return True

    @classmethod
    def repeat(cls, ignored: sys.UnraisableHookArgs) -> None:
        """Unwind again if a callback or finalizer swallowed the interrupt."""
        if ignored.exc_type is not KeyboardInterrupt or not cls.number or not cls.unwind_soon():
            sys.__unraisablehook__(ignored)


@contextmanager
def stopped_in_one_line() -> Iterator[None]:
    """Clean up what runs in the block if a signal stops it, print a line, and exit.

    Ignored signals, as under `nohup`, remain ignored. Outside the main thread no signal is handled.
    """
    Stop.number, Stop.advice = 0, ""
    before = {}
    if threading.current_thread() is threading.main_thread():
        for name in NAMES:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, Stop.handle)
    hook, sys.unraisablehook = sys.unraisablehook, Stop.repeat
    try:
        yield
    except BaseException as end:
        # Libraries turn the interrupt into errors of their own.
        if not Stop.number or (isinstance(end, SystemExit) and not end.code):
            raise
        _leave()
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _leave() -> NoReturn:
    """Print the reason, and exit with 128 + signal.

    The interpreter is not taken down: that waits for threads, and crashes where one runs on.
    """
    reason = NAMES[signal.Signals(Stop.number).name]
    advice = f"; {Stop.advice}" if Stop.advice else ""
    sys.stderr.write(f"icreckon: {reason}{advice}\n")
    with suppress(OSError):
        sys.stdout.flush()
    os._exit(128 + Stop.number)


@contextmanager
def warned_in_one_line() -> Iterator[None]:
    """Show warnings on one line, and none of matplotlib on its cache folder."""

    def one_line(message: Warning | str, *_: object, **_more: object) -> str:
        return f"icreckon: {message}\n"

    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    before = warnings.formatwarning
    warnings.formatwarning = one_line
    try:
        yield
    finally:
        warnings.formatwarning = before
