"""Fast readers of IMU and joint messages, directly from their bytes.

They are several times as fast as decoding, and these two types are nearly all of a log. A fast reader
supports one type definition and returns the same rows as decoding. It raises `NotQuickError` for
messages that must be decoded.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from struct import Struct
from typing import NamedTuple

from icreckon.replay.bags.decoding import NANOSECONDS, message_types, standard_types
from icreckon.replay.bags.message_types import IMU, JOINT_STATE
from icreckon.replay.bags.records import Channel
from icreckon.replay.reading.message_rows import JointReader, imu_row
from icreckon.replay.reading.stream import ABSENT, NAN, Row, RowReader

PARTS = {IMU: ("geometry_msgs/msg/Quaternion", "geometry_msgs/msg/Vector3"), JOINT_STATE: ()}
HEADER_PARTS = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
LITTLE_ENDIAN_CDR = b"\0\1"
CDR_ORIGIN = 4
"""Origin of alignment: the end of the encapsulation header."""
MOST_PADDING = 3

ROS1_HEADER, ROS2_HEADER = Struct("<4I"), Struct("<iII")
COUNT = Struct("<I")
IMU_NUMBERS = Struct("<37d")


class Quick(NamedTuple):
    """Header stamp [ns] and row of a message; the row is None if it is of no interest."""

    stamp: int
    row: Row | None


class NotQuickError(Exception):
    """The bytes must be decoded in the ordinary way."""


QuickReader = Callable[[bytes], Quick]


def quick_reader(channel: Channel, reader: RowReader) -> QuickReader | None:
    """Build a fast equivalent of decoding and a row reader; None if there is none.

    The reader raises `NotQuickError` or struct.error on bytes that it cannot read.

    Args:
        channel: the channel.
        reader: the row reader for decoded messages.
    """
    if not _is_standard(channel):
        return None
    ros1 = channel.encoding == "ros1"
    if channel.msgtype == IMU and reader is imu_row:
        return _imu_ros1 if ros1 else _imu_cdr
    if channel.msgtype == JOINT_STATE and isinstance(reader, JointReader):
        return _QuickJoints(reader, ros1)
    return None


@cache
def _is_standard(channel: Channel) -> bool:
    """Test that a channel's type is supported here and has the standard definition."""
    if channel.msgtype not in PARTS or channel.encoding not in ("ros1", "cdr"):
        return False
    standard = standard_types(ros1=channel.encoding == "ros1")
    try:
        found = message_types(channel)
    except Exception:
        return False
    names = (channel.msgtype, *PARTS[channel.msgtype], *HEADER_PARTS)
    return all(
        name in found and name in standard and found[name][1] == standard[name][1] for name in names
    )


def _ros1_header(data: bytes) -> tuple[int, int]:
    """Stamp [ns] and offset of the end of the header."""
    _, seconds, nanoseconds, length = ROS1_HEADER.unpack_from(data)
    return seconds * NANOSECONDS + nanoseconds, 16 + length


def _cdr_header(data: bytes) -> tuple[int, int]:
    if data[:2] != LITTLE_ENDIAN_CDR:
        raise NotQuickError
    seconds, nanoseconds, length = ROS2_HEADER.unpack_from(data, CDR_ORIGIN)
    return seconds * NANOSECONDS + nanoseconds, CDR_ORIGIN + 12 + length


def _aligned(place: int, size: int) -> int:
    return CDR_ORIGIN + -(-(place - CDR_ORIGIN) // size) * size


def _imu_ros1(data: bytes) -> Quick:
    stamp, place = _ros1_header(data)
    if place + IMU_NUMBERS.size != len(data):
        raise NotQuickError
    return Quick(stamp, _imu_numbers(IMU_NUMBERS.unpack_from(data, place)))


def _imu_cdr(data: bytes) -> Quick:
    stamp, place = _cdr_header(data)
    place = _aligned(place, 8)
    if not 0 <= len(data) - place - IMU_NUMBERS.size <= MOST_PADDING:
        raise NotQuickError
    return Quick(stamp, _imu_numbers(IMU_NUMBERS.unpack_from(data, place)))


def _imu_numbers(numbers: tuple[float, ...]) -> Row:
    """Row of an IMU message.

    Args:
        numbers: orientation (4), its covariance (9), rates (3), covariance (9), specific forces (3),
            covariance (9).
    """
    rates, forces = numbers[13:16], numbers[25:28]
    if numbers[16] == ABSENT:
        rates = (NAN, NAN, NAN)
    if numbers[28] == ABSENT:
        forces = (NAN, NAN, NAN)
    return rates + forces


class _QuickJoints:
    """Fast reader of JointState that caches the layout of the previous names."""

    def __init__(self, reader: JointReader, ros1: bool) -> None:
        self._reader, self._ros1 = reader, ros1
        self._block, self._places = b"", dict[str, int]()

    def __call__(self, data: bytes) -> Quick:
        stamp, place = _ros1_header(data) if self._ros1 else _cdr_header(data)
        if not self._ros1:
            place = _aligned(place, 4)
        if not (self._block and data.startswith(self._block, place)):
            self._learn(data, place)
        place += len(self._block)
        sequences = []
        for _ in range(3):
            if not self._ros1:
                place = _aligned(place, 4)
            (count,) = COUNT.unpack_from(data, place)
            place += 4
            if count and not self._ros1:
                place = _aligned(place, 8)
            sequences.append((place, count))
            place += 8 * count
        if not 0 <= len(data) - place <= (0 if self._ros1 else MOST_PADDING):
            raise NotQuickError
        if not self._places:
            return Quick(stamp, None)
        start, count = sequences[0 if self._reader.positions else 1]
        values = _doubles(count).unpack_from(data, start)
        return Quick(stamp, self._reader.row(stamp, values, self._places))

    def _learn(self, data: bytes, place: int) -> None:
        start = place
        (count,) = COUNT.unpack_from(data, place)
        place += 4
        names = []
        for _ in range(count):
            if not self._ros1:
                place = _aligned(place, 4)
            (length,) = COUNT.unpack_from(data, place)
            place += 4 + length
            if place > len(data):
                raise NotQuickError
            names.append(data[place - length : place].rstrip(b"\0").decode())
        self._block, self._places = data[start:place], self._reader.places(tuple(names))


@cache
def _doubles(count: int) -> Struct:
    return Struct(f"<{count}d")
