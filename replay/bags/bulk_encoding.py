"""Bulk serialisation of messages that differ in numbers only.

One message is made and serialised as a pattern. The definition of its type gives the offset of each
number, by the rules of ROS 1 (no alignment) or of CDR (each primitive aligned to its size, after a
header of four bytes for the encoding). The numbers of all other messages are written at these offsets.
This takes a thirtieth of the time of serialising each (nav_msgs/Odometry: 0.7 instead of 22 µs).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.messages import Messages

AT_A_TIME = 256
"""Messages of a topic that are in memory at once."""

CDR_HEADER = 4
LENGTH = 4
"""Bytes of the length field of a string or a sequence."""

NAMES = {"byte": "uint8", "octet": "uint8", "char": "uint8", "bool": "uint8"}


Numbers = NDArray[Any] | Callable[[slice], NDArray[Any]]


class Place(NamedTuple):
    """Offset and numpy type of a number in a message, and its length if an array."""

    offset: int
    dtype: np.dtype[Any]
    length: int | None


@dataclass(frozen=True)
class Packing:
    """Messages that differ in numbers only.

    Attributes:
        msgtype: their type.
        pattern: one of them.
        stamps: (n,) of all of them [ns].
        numbers: path of a field, as "pose.pose.position.x" or "transforms.0.header.stamp" for a stamp ->
            its values, (n,) or for an array (n, count), or a function that returns them for a slice of
            the messages.
    """

    msgtype: str
    pattern: Any
    stamps: Any
    numbers: Mapping[str, Numbers]

    def serialised(self, messages: Messages) -> Iterator[bytes]:
        """Yield the serialised messages in order."""
        data = bytes(messages.serialize(self.pattern, self.msgtype))
        places = _places(messages, self.msgtype, self.pattern)
        size, columns = len(data), list(self._columns(slice(0, 0)))
        record = np.dtype(
            {
                "names": list(columns),
                "formats": [_format(places[name]) for name in columns],
                "offsets": [places[name].offset for name in columns],
                "itemsize": size,
            }
        )
        pattern = np.frombuffer(data, np.uint8)
        for begin in range(0, len(self.stamps), AT_A_TIME):
            part = slice(begin, begin + AT_A_TIME)
            rows = np.tile(pattern, (len(self.stamps[part]), 1))
            view = rows.view(record)[:, 0]
            for name, values in self._columns(part).items():
                view[name] = values
            whole = rows.tobytes()
            for start in range(0, len(whole), size):
                yield whole[start : start + size]

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


def _format(place: Place) -> Any:
    return place.dtype if place.length is None else (place.dtype, (place.length,))


def _places(messages: Messages, msgtype: str, message: Any) -> dict[str, Place]:
    """Offsets of the numbers of a message, by their paths."""
    walk = _Walk(messages, CDR_HEADER if not messages.ros1 else 0)
    walk.message(msgtype, message, "")
    return walk.places


class _Walk:
    """Traversal of a message in the order of serialisation."""

    def __init__(self, messages: Messages, start: int) -> None:
        self.places: dict[str, Place] = {}
        self._messages, self._start, self._at = messages, start, start
        self._aligned = not messages.ros1

    def message(self, msgtype: str, value: Any, path: str) -> None:
        for name, (kind, spec) in self._messages.store.fielddefs[msgtype][1]:
            self._field(kind.name, spec, getattr(value, name), f"{path}.{name}" if path else name)

    def _field(self, kind: str, spec: Any, value: Any, path: str) -> None:
        if kind == "BASE":
            self._primitive(spec[0], value, path)
        elif kind == "NAME":
            self.message(spec, value, path)
        else:
            (inner, inner_spec), _ = spec
            if kind == "SEQUENCE":
                self._align(LENGTH)
                self._at += LENGTH
            if inner.name == "BASE" and inner_spec[0] != "string":
                dtype = _dtype(inner_spec[0])
                if len(value):
                    self._align(dtype.itemsize)
                    self.places[path] = Place(self._at, dtype, len(value))
                    self._at += dtype.itemsize * len(value)
                return
            for index, one in enumerate(value):
                self._field(inner.name, inner_spec, one, f"{path}.{index}")

    def _primitive(self, name: str, value: Any, path: str) -> None:
        if name == "string":
            self._align(LENGTH)
            self._at += LENGTH + len(value.encode()) + (1 if self._aligned else 0)
            return
        dtype = _dtype(name)
        self._align(dtype.itemsize)
        self.places[path] = Place(self._at, dtype, None)
        self._at += dtype.itemsize

    def _align(self, size: int) -> None:
        if self._aligned:
            self._at += -(self._at - self._start) % size


def _dtype(name: str) -> np.dtype[Any]:
    return np.dtype(NAMES.get(name, name)).newbyteorder("<")
