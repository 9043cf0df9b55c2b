"""Choice of the clock of each stream: header stamps or the time of recording.

Header stamps are times of measurement, times of recording are times of arrival. Header stamps are
better if their clocks agree with one another.
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple

from icreckon.replay.mapping.topics import Clock

CLOCKS_APART = 1.0  # header stamps with offsets further apart come from different clocks [s]
SAME = 0.0005  # offset below which header stamps are reported as equal to the time of recording [s]
DAY = 86_400.0


UsedClock = Literal["header", "recording"]


class Evidence(NamedTuple):
    """Evidence about the clock of a stream."""

    asked: Clock  # the robot file's setting
    offset: float | None  # typical header stamp minus time of recording [s]; None without headers
    constant: bool = False  # whether all of several header stamps are equal


class Choice(NamedTuple):
    """A clock and the reason of its choice; `by_default` if there was no alternative."""

    clock: UsedClock
    reason: str
    by_default: bool


def choose_clocks(streams: Mapping[str, Evidence]) -> dict[str, Choice]:
    """Choose the clock of each stream.

    Header stamps are used if the streams' header clocks agree. If not, streams within `CLOCKS_APART`
    of the recorder's clock keep header stamps, and the others use the time of recording.
    """
    agree = clocks_agree(streams)
    return {purpose: _choice(stream, agree) for purpose, stream in streams.items()}


def clocks_agree(streams: Mapping[str, Evidence]) -> bool:
    """Report whether all header clocks agree, and with the recorder's if it is used."""
    offsets = [
        stream.offset
        for stream in streams.values()
        if stream.offset is not None and not stream.constant and stream.asked != "recording"
    ]
    if len(offsets) < len(streams):
        offsets.append(0.0)  # the other streams use the recorder's clock
    return not offsets or max(offsets) - min(offsets) <= CLOCKS_APART


def _choice(stream: Evidence, agree: bool) -> Choice:
    if stream.asked != "auto":
        return Choice(stream.asked, "as set in the robot file", by_default=True)
    if stream.offset is None:
        return Choice("recording", "the messages have no header", by_default=False)
    if stream.constant:
        return Choice("recording", "all header stamps are the same", by_default=False)
    size, side = abs(stream.offset), "ahead of" if stream.offset > 0 else "behind"
    distance = f"{size / DAY:.1f} days" if size >= DAY else f"{size:.3f} s"
    off = f"header stamps run {distance} {side} the times of recording"
    if size < SAME:
        off = "header and recording times agree within 1 ms"
    if agree or size <= CLOCKS_APART:
        return Choice("header", off, by_default=True)
    return Choice("recording", f"{off}, those of other streams do not", by_default=False)
