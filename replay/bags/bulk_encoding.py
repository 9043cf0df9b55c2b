"""Bulk serialisation of messages that differ in numbers only.

One message is made and serialised as a pattern. Each number stands where bytes of the pattern change with
it; there the numbers of all other messages are written. This takes a thirtieth of the time of
serialising each (nav_msgs/Odometry: 0.7 instead of 22 µs).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.messages import Messages

AT_A_TIME = 256
"""Messages of a topic that are in memory at once."""
NUMBER, PART_OF_A_STAMP = np.dtype("<f8"), np.dtype("<u4")
"""Types of numbers in messages: all but the two parts of a stamp are of the first."""

Numbers = NDArray[Any] | Callable[[slice], NDArray[Any]]


@dataclass(frozen=True)
class Packing:
    """Messages that differ in numbers only.

    Attributes:
        msgtype: their type.
        pattern: one of them; its numbers are overwritten.
        stamps: (n,) of all of them [ns].
        numbers: path of a field, as "pose.pose.position.x" or "transforms.0.header.stamp" for a stamp ->
            its values, (n,) or for an array (n, count), or a function that returns them for a slice of
            the messages. Fields other than stamps are of type float64.
    """

    msgtype: str
    pattern: Any
    stamps: Any
    numbers: Mapping[str, Numbers]

    def serialised(self, messages: Messages) -> Iterator[bytes]:
        """Yield the serialised messages in order."""
        columns = self._columns(slice(0, 0))
        formats = {name: (_type(name), values.shape[1:]) for name, values in columns.items()}
        pattern = self._bytes(messages)
        record = np.dtype(
            {
                "names": list(formats),
                "formats": list(formats.values()),
                "offsets": [self._place(messages, name) for name in formats],
                "itemsize": pattern.size,
            }
        )
        for begin in range(0, len(self.stamps), AT_A_TIME):
            part = slice(begin, begin + AT_A_TIME)
            rows = np.tile(pattern, (len(self.stamps[part]), 1))
            view = rows.view(record)[:, 0]
            for name, values in self._columns(part).items():
                view[name] = values
            for row in rows:
                yield row.tobytes()

    def _columns(self, part: slice) -> dict[str, NDArray[Any]]:
        """Numbers of a slice of the messages, by the paths of primitive fields."""
        columns = {}
        for name, given in self.numbers.items():
            values = given(part) if callable(given) else given[part]
            if name.endswith("stamp"):
                seconds, nanoseconds = np.divmod(values, NANOSECONDS)
                columns[f"{name}.sec"], columns[f"{name}.nanosec"] = seconds, nanoseconds
            else:
                columns[name] = values
        return columns

    def _bytes(self, messages: Messages) -> NDArray[np.uint8]:
        return np.frombuffer(bytes(messages.serialize(self.pattern, self.msgtype)), np.uint8)

    def _place(self, messages: Messages, path: str) -> int:
        """Offset of a number, or of the numbers of an array, in the serialised pattern."""
        *inner, name = path.split(".")
        owner = self.pattern
        for step in inner:
            owner = owner[int(step)] if step.isdigit() else getattr(owner, step)
        found = []
        # No byte of the one number is equal to that of the other.
        for byte in (b"\0", b"\1"):
            number = np.frombuffer(byte * _type(path).itemsize, _type(path))[0].item()
            is_array = isinstance(getattr(owner, name), np.ndarray)
            setattr(owner, name, np.full_like(getattr(owner, name), number) if is_array else number)
            found.append(self._bytes(messages))
        return int(np.flatnonzero(found[0] != found[1])[0])


def _type(path: str) -> np.dtype[Any]:
    return PART_OF_A_STAMP if path.endswith(("stamp.sec", "stamp.nanosec")) else NUMBER
