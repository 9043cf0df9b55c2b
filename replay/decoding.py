"""From a message's bytes to its fields, with the type definitions that the bag holds."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from replay.errors import ReplayError
from replay.records import Channel

NANOSECONDS = 1_000_000_000
IDL_RULE = "=" * 80 + "\n"


def decoder(channel: Channel, source: str) -> Callable[[bytes], Any]:
    """A function that turns the bytes of a channel's messages into objects with their fields.

    The function raises whatever rosbags raises on bytes that are no such message.

    Args:
        channel: the channel.
        source: name of the bag, for messages.

    Raises:
        ReplayError: an encoding or a type definition that cannot be read.
    """
    where = f"{source}: topic {channel.topic!r} of type {channel.msgtype!r}"
    if channel.encoding not in ("cdr", "ros1"):
        raise ReplayError(f"{where}: its encoding {channel.encoding!r} is not known")
    try:
        store = _typestore(channel.msgtype, channel.definition)
    except Exception as problem:
        raise ReplayError(f"{where}: its definition cannot be read: {problem}") from problem
    if channel.msgtype not in store.fielddefs:
        raise ReplayError(f"{where}: the bag holds no definition of this type")
    decode = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr
    msgtype = channel.msgtype
    return lambda data: decode(data, msgtype)


class Header(NamedTuple):
    """A message's header: stamp [ns] and frame."""

    stamp: int
    frame_id: str


def header_reader(channel: Channel) -> Callable[[bytes], Header] | None:
    """A function that reads only the header of a channel's messages, or None where there is none.

    The function raises struct.error or UnicodeDecodeError on bytes that are no such message.
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
def _typestore(msgtype: str, definition: MessageDefinition) -> Typestore:
    if definition.format == MessageDefinitionFormat.NONE:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.EMPTY)
    if definition.format == MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(definition.data, msgtype))
        return store
    if not definition.data.startswith(f"{IDL_RULE}IDL: "):
        store.register(get_types_from_idl(definition.data))
        return store
    types = {}
    for part in definition.data.split(IDL_RULE)[1:]:
        types.update(get_types_from_idl(part.partition("\n")[2]))
    store.register(types)
    return store
