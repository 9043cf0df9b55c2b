"""Recovery of ROS 1 bags and MCAP files: sequential reading without the index.

A killed recorder leaves a file without an index, often cut in the middle of a chunk. Both formats are
sequences of records with a length field, so everything before the break is readable, and what follows a
damaged chunk, too. Formats: ROS bag 2.0 (wiki.ros.org/Bags/Format/2.0), MCAP (mcap.dev/spec).
"""

import struct
from binascii import crc32
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from icreckon.replay.bags.records import LATEST, Channel, Record, ros2_type_name
from icreckon.replay.bags.unpacking import DECOMPRESSORS, unpack

MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
MCAP_FOOTER, MCAP_SCHEMA, MCAP_CHANNEL, MCAP_MESSAGE, MCAP_CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
MCAP_DATA_END = 0x0F
ROS1_MESSAGE, ROS1_CHUNK, ROS1_CONNECTION = 0x02, 0x05, 0x07

NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
MSG, IDL = MessageDefinitionFormat.MSG, MessageDefinitionFormat.IDL
DEFINITION_FORMATS = {"ros1msg": MSG, "ros2msg": MSG, "ros2idl": IDL, "omgidl": IDL}


class BreakError(Exception):
    """The records end before the end that the format prescribes."""


DAMAGE = (BreakError, struct.error, IndexError, KeyError, UnicodeDecodeError)
"""Exceptions of records that are not as the format prescribes."""


_Schemas = dict[int, tuple[str, MessageDefinition]]  # name and definition of a message type, by id
_Fields = dict[bytes, bytes]  # fields of a ROS 1 header, by name


class RecordWalk:
    """Sequential reader of the records of one file."""

    def __init__(self, path: Path) -> None:
        self.path = path  # a ROS 1 bag or an MCAP file, by its first bytes
        self.channels: dict[int, Channel] = {}  # the channels found so far, by id
        self.position = 0  # byte up to which whole records (or a chunk's whole messages) were read
        self.complete = False  # whether the last walk reached the end that the format prescribes
        self.damaged: list[int] = []  # places of damaged chunks, of which the beginning was read

    def records(self) -> Iterator[Record]:
        """Yield the messages in the order of the file, up to the break.

        Raises:
            OSError: the file cannot be read.
            ReplayError: a chunk unpacks to more than the limit.
        """
        self.channels, self.position, self.complete, self.damaged = {}, 0, False, []
        with self.path.open("rb") as file:
            magic = file.read(len(MCAP_MAGIC))
            try:
                if magic == MCAP_MAGIC:
                    yield from self._mcap(file)
                else:
                    file.seek(len(ROS1_MAGIC))
                    yield from self._ros1(file)
            except DAMAGE:
                return
            self.complete = True

    def _until_damage(self, records: Iterator[Record], *, is_cut: bool) -> Iterator[Record]:
        """Yield the records of a chunk up to its damage, which is noted."""
        # Reading can go on after that, but not after a chunk that the end of the file cuts: BreakError.
        try:
            yield from records
        except DAMAGE:
            if not is_cut:
                self.damaged.append(self.position)
        if is_cut:
            raise BreakError

    def _mcap(self, file: BinaryIO) -> Iterator[Record]:
        """Yield the messages of an MCAP file, from the end of its magic bytes."""
        schemas: _Schemas = {}
        while True:
            self.position = file.tell()
            operation, length = struct.unpack("<BQ", file.read(9))
            if operation in (MCAP_DATA_END, MCAP_FOOTER):
                return
            # A damaged length may be huge: no memory is reserved for it.
            content = file.read(min(length, _bytes_left(file)))
            if operation == MCAP_CHUNK:
                records = self._mcap_chunk(content, schemas)
                yield from self._until_damage(records, is_cut=len(content) < length)
            elif len(content) < length:
                raise BreakError
            else:
                yield from self._mcap_record(operation, content, schemas)

    def _mcap_chunk(self, content: bytes, schemas: _Schemas) -> Iterator[Record]:
        """Yield the messages of an MCAP chunk; BreakError: wrong checksum or size."""
        _begin_time, _end_time, size, checksum = struct.unpack_from("<QQQI", content)
        compression, position = _text(content, struct.calcsize("<QQQI"))
        (packed_size,) = struct.unpack_from("<Q", content, position)
        start = position + 8
        data = _unpacked(content[start : start + packed_size], compression)
        if len(data) == size and checksum and crc32(data) != checksum:
            raise BreakError
        records = BytesIO(data)
        while head := records.read(9):
            operation, length = struct.unpack("<BQ", head)
            if length > _bytes_left(records):
                raise BreakError
            yield from self._mcap_record(operation, records.read(length), schemas)
        if len(data) != size:
            raise BreakError

    def _mcap_record(self, operation: int, content: bytes, schemas: _Schemas) -> Iterator[Record]:
        """Yield a record that is a message; store one that is a channel or a schema."""
        if operation == MCAP_MESSAGE:
            channel_id, _sequence, log_time, _ = struct.unpack_from("<HIQQ", content)
            if log_time >= LATEST:
                raise BreakError
            data = content[struct.calcsize("<HIQQ") :]
            yield Record(self.channels[channel_id], log_time, data)
        elif operation == MCAP_SCHEMA:
            (schema_id,) = struct.unpack_from("<H", content)
            name, position = _text(content, 2)
            encoding, position = _text(content, position)
            definition, _ = _text(content, position)
            form = DEFINITION_FORMATS.get(encoding)
            known = MessageDefinition(form, definition) if form else NO_DEFINITION
            schemas[schema_id] = ros2_type_name(name), known
        elif operation == MCAP_CHANNEL:
            channel_id, schema_id = struct.unpack_from("<HH", content)
            topic, position = _text(content, 4)
            encoding, _ = _text(content, position)
            msgtype, known = schemas.get(schema_id, ("", NO_DEFINITION))
            self.channels[channel_id] = Channel(topic, msgtype, known, encoding)
        elif operation == 0:  # not a record: a file system that lost the tail leaves zeros
            raise BreakError

    def _ros1(self, file: BinaryIO) -> Iterator[Record]:
        """Yield the messages of a ROS 1 bag, from the end of its magic bytes."""
        while _bytes_left(file):
            self.position = file.tell()
            fields = _ros1_fields(_sized_bytes(file))
            operation = fields[b"op"][0]
            (length,) = struct.unpack("<L", file.read(4))
            content = file.read(min(length, _bytes_left(file)))
            if operation == ROS1_CHUNK:
                compression = fields[b"compression"].decode()
                (size,) = struct.unpack("<L", fields[b"size"])
                records = self._ros1_chunk(content, compression, size)
                yield from self._until_damage(records, is_cut=len(content) < length)
            elif len(content) < length:
                raise BreakError
            else:
                yield from self._ros1_record(operation, fields, content)

    def _ros1_chunk(self, content: bytes, compression: str, size: int) -> Iterator[Record]:
        """Yield the messages of a ROS 1 chunk; BreakError: wrong size [bytes]."""
        data = _unpacked(content, compression)
        records = BytesIO(data)
        while _bytes_left(records):
            fields = _ros1_fields(_sized_bytes(records))
            yield from self._ros1_record(fields[b"op"][0], fields, _sized_bytes(records))
        if len(data) != size:
            raise BreakError

    def _ros1_record(self, operation: int, fields: _Fields, content: bytes) -> Iterator[Record]:
        """Yield a record that is a message; store the channel of one that is a connection."""
        if operation == ROS1_MESSAGE:
            (connection,) = struct.unpack("<L", fields[b"conn"])
            seconds, nanoseconds = struct.unpack("<LL", fields[b"time"])
            time = seconds * 1_000_000_000 + nanoseconds
            yield Record(self.channels[connection], time, content)
        elif operation == ROS1_CONNECTION:
            (connection,) = struct.unpack("<L", fields[b"conn"])
            type_fields = _ros1_fields(content)
            topic, msgtype = fields[b"topic"].decode(), type_fields[b"type"].decode()
            known = MessageDefinition(MSG, type_fields[b"message_definition"].decode())
            self.channels[connection] = Channel(topic, ros2_type_name(msgtype), known, "ros1")


def _unpacked(data: bytes, compression: str) -> bytes:
    """Decompress a chunk up to its damage; BreakError: unknown compression."""
    if compression in ("", "none"):
        return data
    if compression not in DECOMPRESSORS:
        raise BreakError
    return unpack(data, compression, up_to_damage=True)


def _text(content: bytes, position: int) -> tuple[str, int]:
    """Text of an MCAP record after its length (4 bytes), and its end's position."""
    (length,) = struct.unpack_from("<I", content, position)
    end = position + 4 + length
    return content[position + 4 : end].decode(), end


def _ros1_fields(header: bytes) -> _Fields:
    """Fields of a ROS 1 record's header by name: each is a length and `name=value`."""
    fields: _Fields = {}
    position = 0
    while position < len(header):
        (length,) = struct.unpack_from("<L", header, position)
        name, _, value = header[position + 4 : position + 4 + length].partition(b"=")
        fields[name] = value
        position += 4 + length
    return fields


def _sized_bytes(data: BinaryIO) -> bytes:
    """Read bytes after their number (4 bytes); BreakError if there are fewer."""
    (length,) = struct.unpack("<L", data.read(4))
    if length > _bytes_left(data):
        raise BreakError
    return data.read(length)


def _bytes_left(data: BinaryIO) -> int:
    """Number of bytes from the position of a file to its end."""
    here = data.tell()
    end = data.seek(0, 2)
    data.seek(here)
    return end - here
