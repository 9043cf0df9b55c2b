"""Clock of the header stamps, watched against the time that passes.

A computer without a clock of its own starts in 1970 or at its last shutdown, and is set forward once it
has a network. By the stamps alone that is a hole of years in which the robot may have gone anywhere.
"""

from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from icreckon.replay.bags.decoding import NANOSECONDS

T = TypeVar("T")
LEAST_STEP = 3 * NANOSECONDS
"""Least time by which a clock is found set forward [ns]; less is bridged as a hole."""
WITNESSES = 5
"""Messages in a row of one stream that indicate a step of the clock."""


class _Held(NamedTuple, Generic[T]):
    """Message that is held back, with its stamp and the time at which it came [ns]."""

    stamp: int
    came: int
    message: T


@dataclass
class _Stream(Generic[T]):
    """State of a stream: newest accepted stamp, and messages held back; times in ns.

    `ahead` is the largest stamp less arrival since the clock was set back: stamps may stand, not time.
    """

    stamp: int
    ahead: int
    behind: int = 0
    held: list[_Held[T]] = field(default_factory=list)


class Watched(NamedTuple, Generic[T]):
    """Outcome of a message."""

    ready: list[T]  # messages that can be used, in the order of their coming
    step: int = 0  # time by which the clock was set forward before these [ns], 0 if it was not
    lost: int = 0  # number of messages that were held back and are not used


class ClockWatch(Generic[T]):
    """Watch over stamps that run ahead of the time that passes."""

    def __init__(self) -> None:
        self._streams: dict[str, _Stream[T]] = {}

    def take(self, stream: str, stamp: int, came: int, message: T) -> Watched[T]:
        """Add a message.

        Args:
            stream: name of its stream.
            stamp: its stamp [ns].
            came: time at which it came, of a clock that is not set [ns].
            message: the message.
        """
        known = self._streams.get(stream)
        if known is None:
            self._streams[stream] = _Stream(stamp, stamp - came)
            return Watched([message])
        if stamp - came - known.ahead <= LEAST_STEP:
            return self._as_usual(known, stamp, came, message)
        held, lost = known.held, 0
        # Stamps that do not advance at the pace of time are wrong, and no clock that was set.
        if held and abs(stamp - held[0].stamp - (came - held[0].came)) > LEAST_STEP:
            lost = len(held)
            held.clear()
        held.append(_Held(stamp, came, message))
        if len(held) < WITNESSES:
            return Watched([], lost=lost)
        step = held[0].stamp - held[0].came - known.ahead
        return Watched(self._stepped(step), step, lost)

    def _as_usual(self, known: _Stream[T], stamp: int, came: int, message: T) -> Watched[T]:
        """Accept a message that is not ahead, which refutes those that are held back."""
        lost = len(known.held)
        known.held.clear()
        # Messages from before a step may still come: only several in a row are a clock set back.
        known.behind = known.behind + 1 if stamp < known.stamp - LEAST_STEP else 0
        if known.behind == WITNESSES:
            known.stamp, known.ahead, known.behind = stamp, stamp - came, 0
        elif not known.behind:
            known.stamp, known.ahead = stamp, max(known.ahead, stamp - came)
        return Watched([message], lost=lost)

    def _stepped(self, step: int) -> list[T]:
        """Set all streams forward; return their held messages in order of arrival."""
        released: list[_Held[T]] = []
        for stream in self._streams.values():
            stream.stamp, stream.ahead = stream.stamp + step, stream.ahead + step
            released += stream.held
            if stream.held:
                stream.stamp = stream.held[-1].stamp
                stream.held.clear()
        return [held.message for held in sorted(released, key=lambda held: held.came)]

    def restart(self) -> None:
        """Forget all streams, and what is held back."""
        self._streams.clear()
