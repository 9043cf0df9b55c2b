"""Message decoding: from bytes to fields, by the type definitions of the bag."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from icreckon.replay.bags.records import Channel
from icreckon.replay.base.errors import ReplayError

NANOSECONDS = 1_000_000_000
Definitions = tuple[tuple[str, str], ...]
"""Definitions of message types that a bag may lack: (name, as `our_msgs/msg/Rate`, definition)."""
IDL_RULE = "=" * 80 + "\n"
LONGEST_DEFINITION = 500_000
"""Most characters of a type's definition."""
MOST_FIELDS, DEEPEST = 10_000, 50
"""Most fields of a message, those of the types in it included, and most types within one another."""
LONGEST_REASON = 200
"""Most characters of an error of rosbags, which may hold a whole definition."""


def stamp_of(header: Any) -> int:
    """Stamp of a std_msgs/Header [ns]."""
    return int(header.stamp.sec * NANOSECONDS + header.stamp.nanosec)


def decoder(channel: Channel, source: str, definitions: Definitions = ()) -> Callable[[bytes], Any]:
    """Build a decoder of a channel, from bytes to a message object with fields.

    The decoder raises the errors of rosbags if the bytes are not such a message.

    Args:
        channel: the channel.
        source: name of the bag, for error messages.
        definitions: used if the bag does not define the type.

    Raises:
        ReplayError: an encoding or a type definition that cannot be read.
    """
    where = f"{source}: topic {channel.topic!r} of type {channel.msgtype!r}"
    if channel.encoding not in ("cdr", "ros1"):
        raise ReplayError(f"{where}: its encoding {channel.encoding!r} is not known")
    try:
        store = _typestore(channel.msgtype, channel.definition, definitions)
    except Exception as problem:
        raise ReplayError(
            f"{where}: its definition cannot be read: {_reason(problem)}"
        ) from problem
    missing = _undefined(store, channel.msgtype)
    if missing is not None:
        what = "this type" if missing == channel.msgtype else f"{missing!r} in it"
        raise ReplayError(
            f"{where}: the bag holds no definition of {what}; give its .msg file with --msg"
        )
    decode = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr
    msgtype = channel.msgtype
    return lambda data: decode(data, msgtype)


def _undefined(store: Typestore, msgtype: str) -> str | None:
    """First undefined type that a message type depends on, or None."""
    seen: set[str] = set()
    waiting = [msgtype]
    while waiting:
        name = waiting.pop()
        if name not in store.fielddefs:
            return name
        if name not in seen:
            seen.add(name)
            waiting += [inner for inner, _ in reversed(_parts(store.fielddefs[name][1])) if inner]
    return None


def _parts(fields: Any) -> list[tuple[str, int]]:
    """Message type of each field, "" for numbers and texts, and its count."""
    found = []
    for _, (node, inner) in fields:
        count = 1
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            fixed = node == Nodetype.ARRAY
            (node, inner), length = inner
            if fixed and (node == Nodetype.NAME or inner[0] == "string"):
                count = length
        found.append((str(inner) if node == Nodetype.NAME else "", count))
    return found


def _check_extent(types: Mapping[str, Any]) -> None:
    """Refuse types that are too large or too deep to be decoded.

    Raises:
        ValueError: a message has more than `MOST_FIELDS` fields, or more than `DEEPEST` types within one
            another; a type holds itself.
    """
    extents: dict[str, tuple[int, int]] = {}

    def extent(name: str, depth: int) -> tuple[int, int]:
        """Number of fields, and of types within one another."""
        if name not in extents:
            parts = _parts(types[name][1]) if name in types else []
            inner = [
                extent(part, depth + 1) if part and depth <= DEEPEST else (1, 0)
                for part, _ in parts
            ]
            fields = sum(count * size for (_, count), (size, _) in zip(parts, inner, strict=True))
            extents[name] = fields, 1 + max((deep for _, deep in inner), default=0)
        fields, deepest = extents[name]
        if max(deepest, depth) > DEEPEST:
            raise ValueError(f"more than {DEEPEST} types are within one another")
        if fields > MOST_FIELDS:
            raise ValueError(f"{name!r} has {fields} fields, at most {MOST_FIELDS} are read")
        return extents[name]

    for name in types:
        extent(name, 0)


def message_types(channel: Channel) -> Mapping[str, Any]:
    """Constants and fields of a channel's type and its nested types, as in the bag."""
    return _typestore(channel.msgtype, channel.definition).fielddefs


def standard_types(*, ros1: bool) -> Mapping[str, Any]:
    """Return the standard message types in the format of `message_types`."""
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE).fielddefs


class Header(NamedTuple):
    """Message header: stamp [ns] and frame."""

    stamp: int
    frame_id: str


def header_reader(channel: Channel) -> Callable[[bytes], Header] | None:
    """Build a reader of only the headers of a channel; None if there are none.

    The reader raises struct.error or UnicodeDecodeError if the bytes are not such a message.
    """
    try:
        store = _typestore(channel.msgtype, channel.definition)
        first = store.fielddefs[channel.msgtype][1][0]
    except Exception:
        return None
    if first[1][1] != "std_msgs/msg/Header":
        return None
    return _ros1_header if channel.encoding == "ros1" else _cdr_header


def _cdr_header(data: bytes) -> Header:
    order = "<" if data[1] & 1 else ">"
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, 4)
    frame = bytes(data[16 : 16 + length]).rstrip(b"\0").decode()
    return Header(seconds * NANOSECONDS + nanoseconds, frame)


def _ros1_header(data: bytes) -> Header:
    _, seconds, nanoseconds, length = struct.unpack_from("<4I", data)
    return Header(seconds * NANOSECONDS + nanoseconds, bytes(data[16 : 16 + length]).decode())


@cache
def _typestore(
    msgtype: str, definition: MessageDefinition, definitions: Definitions = ()
) -> Typestore:
    if definition.format == MessageDefinitionFormat.NONE:
        store = get_typestore(Stores.ROS2_HUMBLE)
        known: dict[str, Any] = {}
        for name, text in definitions:
            known.update(get_types_from_msg(text, name))
        added = {name: kind for name, kind in known.items() if name not in store.fielddefs}
        _check_extent({**store.fielddefs, **added})
        store.register(added)
        return store
    types = _types(msgtype, definition)
    _check_extent(types)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def _types(msgtype: str, definition: MessageDefinition) -> dict[str, Any]:
    """Parse the definition of a type, with those of the types in it."""
    text = definition.data
    if len(text) > LONGEST_DEFINITION:
        raise ValueError(f"it has {len(text)} characters, at most {LONGEST_DEFINITION} are read")
    types: dict[str, Any] = {}
    if definition.format == MessageDefinitionFormat.MSG:
        types.update(get_types_from_msg(text, msgtype))
    elif not text.startswith(f"{IDL_RULE}IDL: "):
        types.update(get_types_from_idl(text))
    else:
        for part in text.split(IDL_RULE)[1:]:
            types.update(get_types_from_idl(part.partition("\n")[2]))
    return types


def read_definitions(files: Sequence[Path]) -> Definitions:
    """Message definitions from `.msg` files.

    Args:
        files: each in the folder of its package, as `our_msgs/msg/Rate.msg` or `our_msgs/Rate.msg`.

    Raises:
        ReplayError: no such file, or not a definition.
    """
    found = []
    for file in files:
        folder = Path(os.path.realpath(file)).parent
        package = folder.parent.name if folder.name == "msg" else folder.name
        name = f"{package}/msg/{file.stem}"
        try:
            text = file.read_text(encoding="utf-8")
            _check_extent(get_types_from_msg(text, name))
        except (OSError, UnicodeDecodeError) as problem:
            raise ReplayError(f"{file}: cannot be read: {problem}") from None
        except Exception as problem:
            raise ReplayError(
                f"{file}: not a message definition (.msg): {_reason(problem)}"
            ) from None
        found.append((name, text))
    return tuple(found)


def _reason(problem: Exception) -> str:
    """Message of an error in one line, shortened."""
    text = " ".join(str(problem).split())
    return text if len(text) <= LONGEST_REASON else f"{text[:LONGEST_REASON]}..."
