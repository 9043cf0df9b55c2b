"""Clock of the header stamps, watched against the time that passes.

A computer without a clock of its own starts in 1970 or at its last shutdown, and is set forward once it
has a network. By the stamps alone that is a hole of years in which the robot may have gone anywhere.
"""

from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from icreckon.replay.bags.decoding import NANOSECONDS

T = TypeVar("T")
LEAST_STEP = 3 * NANOSECONDS  # least forward step of a clock [ns]; less is bridged
WITNESSES = 5  # messages in a row of one stream that indicate a step of the clock


class _Held(NamedTuple, Generic[T]):
    """Message that is held back."""

    stamp: int  # its stamp [ns]
    arrival: int  # time of its arrival, of a clock that is never set [ns]
    message: T


@dataclass
class _Stream(Generic[T]):
    """State of a stream."""

    stamp: int  # newest accepted stamp [ns]
    offset: int  # largest stamp less arrival since the clock was set back [ns]
    behind: int = 0  # number of newest messages in a row whose stamps are far before `stamp`
    held: list[_Held[T]] = field(default_factory=list)  # messages whose stamps are far ahead


class Watched(NamedTuple, Generic[T]):
    """Outcome of a message."""

    ready: list[T]  # messages that can be used, in the order of their coming
    step: int = 0  # time by which the clock was set forward before these [ns], 0 if it was not
    lost: int = 0  # number of messages that were held back and are not used


class ClockWatch(Generic[T]):
    """Watch over stamps that run ahead of the time that passes."""

    def __init__(self) -> None:
        self._streams: dict[str, _Stream[T]] = {}

    def take(self, stream: str, stamp: int, arrival: int, message: T) -> Watched[T]:
        """Add a message with its stamp and its arrival, by a clock that is never set [ns]."""
        state, offset = self._streams.get(stream), stamp - arrival
        if state is None:
            self._streams[stream] = _Stream(stamp, offset)
            return Watched([message])
        if offset - state.offset <= LEAST_STEP:
            return self._accept(state, stamp, offset, message)
        held, lost = state.held, 0
        # A set clock keeps its new offset; other stamps are wrong.
        if held and abs(offset - (held[0].stamp - held[0].arrival)) > LEAST_STEP:
            lost = len(held)
            held.clear()
        held.append(_Held(stamp, arrival, message))
        if len(held) < WITNESSES:
            return Watched([], lost=lost)
        step = held[0].stamp - held[0].arrival - state.offset
        # All streams are set forward; the messages that they hold are ready, by arrival.
        released: list[_Held[T]] = []
        for other in self._streams.values():
            other.stamp, other.offset = other.stamp + step, other.offset + step
            released += other.held
            if other.held:
                other.stamp = other.held[-1].stamp
                other.held.clear()
        released.sort(key=lambda one: one.arrival)
        return Watched([one.message for one in released], step, lost)

    def _accept(self, state: _Stream[T], stamp: int, offset: int, message: T) -> Watched[T]:
        """Accept a message that is not ahead, and discard those that are held back."""
        lost = len(state.held)
        state.held.clear()
        # Messages from before a step may still come: only several in a row are a clock set back.
        state.behind = state.behind + 1 if stamp < state.stamp - LEAST_STEP else 0
        if state.behind == WITNESSES:
            state.stamp, state.offset, state.behind = stamp, offset, 0
        elif not state.behind:
            state.stamp, state.offset = stamp, max(state.offset, offset)
        return Watched([message], lost=lost)
