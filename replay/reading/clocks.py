"""Which clock stamps a stream: the headers' own, or the recorder's.

Header stamps tell when something was measured, the time of recording when it came in; so headers are
better as long as their clocks agree with one another.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

from icreckon.replay.mapping.topics import Clock

CLOCKS_APART = 1.0
"""Header stamps whose offsets differ by more than this come from different clocks [s]."""
SAME = 0.0005
"""They are called the same as the time of recording below this offset [s]."""
DAY = 86_400.0


class Evidence(NamedTuple):
    """What a stream shows of its clock.

    Attributes:
        topic: its topic.
        asked: what the robot file says.
        offset: median of header stamp less time of recording [s]; None without headers.
        constant: whether all of several header stamps are the same.
    """

    topic: str
    asked: Clock
    offset: float | None
    constant: bool = False


class Choice(NamedTuple):
    """A clock and why it was chosen; `by_default` where there was nothing to decide."""

    clock: Literal["header", "recording"]
    reason: str
    by_default: bool


def choose_clocks(streams: Mapping[str, Evidence]) -> dict[str, Choice]:
    """The clock of each stream.

    Header stamps are used where the streams' header clocks agree. Where they do not, those within
    `CLOCKS_APART` of the recorder's clock are, and the others go by the time of recording.

    Args:
        streams: by purpose.
    """
    usable = {
        purpose: stream.offset
        for purpose, stream in streams.items()
        if stream.offset is not None and not stream.constant and stream.asked != "recording"
    }
    others = any(
        stream.asked == "recording" or purpose not in usable for purpose, stream in streams.items()
    )
    offsets = list(usable.values()) + ([0.0] if others else [])
    agree = not offsets or max(offsets) - min(offsets) <= CLOCKS_APART
    return {purpose: _choice(stream, agree) for purpose, stream in streams.items()}


def _choice(stream: Evidence, agree: bool) -> Choice:
    if stream.asked != "auto":
        return Choice(stream.asked, "as the robot file says", by_default=True)
    if stream.offset is None:
        return Choice("recording", "the messages have no header", by_default=False)
    if stream.constant:
        return Choice("recording", "all header stamps are the same", by_default=False)
    off = (
        "the header stamps are the times of recording, to a millisecond"
        if abs(stream.offset) < SAME
        else f"the header stamps are {_span(stream.offset)} the time of recording"
    )
    if agree:
        return Choice("header", off, by_default=True)
    if abs(stream.offset) <= CLOCKS_APART:
        return Choice("header", off, by_default=True)
    return Choice("recording", f"{off}, and not those of all streams are", by_default=False)


def _span(seconds: float) -> str:
    side = "after" if seconds > 0 else "before"
    size = abs(seconds)
    if size >= DAY:
        return f"{size / DAY:.1f} days {side}"
    return f"{size:.3f} s {side}"
