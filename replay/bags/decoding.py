"""Message decoding: from bytes to fields, by the type definitions of the bag."""

import os
import struct
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from icreckon.replay.bags.records import Channel
from icreckon.replay.base.errors import ReplayError

NANOSECONDS = 1_000_000_000
Definitions = tuple[tuple[str, str], ...]
"""Definitions of message types that a bag may lack: (name, as `our_msgs/msg/Rate`, definition)."""
# Line before each type in the definition of an IDL type that contains others.
IDL_RULE = "=" * 80 + "\n"
LONGEST_REASON = 200  # most characters of an error of rosbags, which may hold a whole definition


def stamp_of(header: Any) -> int:
    """Stamp of a std_msgs/Header [ns]."""
    return int(header.stamp.sec * NANOSECONDS + header.stamp.nanosec)


def decoder(channel: Channel, source: str, definitions: Definitions = ()) -> Callable[[bytes], Any]:
    """Build a decoder of a channel, from bytes to a message object with fields.

    The decoder raises the errors of rosbags if the bytes are not such a message. `source` names the
    bag in errors; `definitions` are those that the bag may lack.

    Raises:
        ReplayError: an encoding or a type definition that cannot be read.
    """
    where = f"{source}: topic {channel.topic!r} of type {channel.msgtype!r}"
    if channel.encoding not in ("cdr", "ros1"):
        raise ReplayError(f"{where}: its encoding {channel.encoding!r} is not known")
    try:
        store = _typestore(channel.msgtype, channel.definition, definitions)
    except Exception as error:
        raise ReplayError(f"{where}: its definition cannot be read: {_reason(error)}") from error
    undefined = _undefined_type(store, channel.msgtype)
    if undefined is not None:
        name = "this type" if undefined == channel.msgtype else f"{undefined!r} in it"
        text = f"the bag holds no definition of {name}; give its .msg file with --msg"
        raise ReplayError(f"{where}: {text}")
    decode = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr
    msgtype = channel.msgtype
    return lambda data: decode(data, msgtype)


def _undefined_type(store: Typestore, msgtype: str) -> str | None:
    """First undefined type among a message type and those it contains, or None."""
    seen: set[str] = set()
    waiting = [msgtype]
    while waiting:
        name = waiting.pop()
        if name not in store.fielddefs:
            return name
        if name not in seen:
            seen.add(name)
            fields: Any = store.fielddefs[name][1]
            types = []
            for _, (node, inner) in fields:
                if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                    (node, inner), _length = inner
                if node == Nodetype.NAME:
                    types.append(str(inner))
            waiting += reversed(types)  # a stack: the first field is searched first
    return None


def header_reader(channel: Channel) -> Callable[[bytes], tuple[int, str]] | None:
    """Build a reader of the stamps [ns] and frames of a channel; None without headers.

    The reader decodes the first bytes only, which is fast. It raises struct.error or UnicodeDecodeError
    if the bytes are not such a message.
    """
    try:
        store = _typestore(channel.msgtype, channel.definition)
        _, fields = store.fielddefs[channel.msgtype]
        _, (_, first_type) = fields[0]
    except Exception:
        return None  # `decoder` reports definitions that cannot be read
    if first_type != "std_msgs/msg/Header":
        return None
    return _ros1_header if channel.encoding == "ros1" else _cdr_header


def _cdr_header(data: bytes) -> tuple[int, str]:
    """Stamp [ns] and frame of a ROS 2 message, after 4 bytes with the byte order."""
    order = "<" if data[1] & 1 else ">"
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, 4)
    frame = bytes(data[16 : 16 + length]).rstrip(b"\0").decode()
    return seconds * NANOSECONDS + nanoseconds, frame


def _ros1_header(data: bytes) -> tuple[int, str]:
    """Stamp [ns] and frame of a ROS 1 message, after its sequence number."""
    _, seconds, nanoseconds, length = struct.unpack_from("<4I", data)
    return seconds * NANOSECONDS + nanoseconds, bytes(data[16 : 16 + length]).decode()


@cache
def _typestore(msgtype: str, known: MessageDefinition, definitions: Definitions = ()) -> Typestore:
    """Types by the bag's definition; if none, those of Humble and `definitions`."""
    types: dict[str, Any] = {}
    if known.format == MessageDefinitionFormat.NONE:
        store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in definitions:
            types.update(get_types_from_msg(text, name))
        # A file outside of its package's folder has the right name, and another package.
        kind = msgtype.rpartition("/")[2]
        alike = [text for name, text in definitions if name.rpartition("/")[2] == kind]
        if msgtype not in types and len(alike) == 1:
            types.update(get_types_from_msg(alike[0], msgtype))
        store.register({name: kind for name, kind in types.items() if name not in store.fielddefs})
        return store
    if known.format == MessageDefinitionFormat.MSG:
        types.update(get_types_from_msg(known.data, msgtype))
    elif not known.data.startswith(f"{IDL_RULE}IDL: "):
        types.update(get_types_from_idl(known.data))
    else:
        for section in known.data.split(IDL_RULE)[1:]:
            _title, _, idl = section.partition("\n")
            types.update(get_types_from_idl(idl))
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def read_definitions(files: Sequence[Path]) -> Definitions:
    """Read message definitions, from `our_msgs/msg/Rate.msg` or `our_msgs/Rate.msg`.

    Raises:
        ReplayError: no such file, or not a definition.
    """
    definitions = []
    for file in files:
        folder = Path(os.path.realpath(file)).parent
        package = folder.parent.name if folder.name == "msg" else folder.name
        name = f"{package}/msg/{file.stem}"
        try:
            text = file.read_text(encoding="utf-8")
            get_types_from_msg(text, name)
        except (OSError, UnicodeDecodeError) as problem:
            raise ReplayError(f"{file}: cannot be read: {problem}") from None
        except Exception as error:
            reason = _reason(error)
            raise ReplayError(f"{file}: not a message definition (.msg): {reason}") from None
        definitions.append((name, text))
    return tuple(definitions)


def _reason(problem: Exception) -> str:
    """Message of an error in one line, shortened."""
    text = " ".join(str(problem).split())
    return text if len(text) <= LONGEST_REASON else f"{text[:LONGEST_REASON]}..."
