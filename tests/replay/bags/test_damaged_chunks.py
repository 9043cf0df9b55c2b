"""MCAP files with a damaged chunk: the others are read."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from bag_messages import JOINTS, SECOND, STORE, joints, robot_with
from icreckon import inspect, read_log

ROBOT = robot_with(tracks=JOINTS)


def mcap(path: Path, messages: list[tuple[int, bytes]]) -> Path:
    """A bag of JointState messages, (time of recording, bytes), each in a chunk of its own."""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=1, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        text, _ = STORE.generate_msgdef("sensor_msgs/msg/JointState")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", text.encode())
        at = writer.register_channel("/js", "cdr", schema)
        for time, data in messages:
            writer.add_message(at, time, data, time)
        writer.finish()
    return path


def speeds(count: int) -> list[tuple[int, bytes]]:
    """Messages of track speeds."""
    found = []
    for k in range(1, count + 1):
        message = joints(k * SECOND // 50, (1.0, 2.0))
        data = STORE.serialize_cdr(message, "sensor_msgs/msg/JointState")
        found.append((k * SECOND // 50, bytes(data)))
    return found


def damage(path: Path, change: Callable[[bytearray, int], None]) -> None:
    """Change the third chunk of an MCAP file, and cut off the end behind the index."""
    data = bytearray(path.read_bytes())
    at, number = 8, 0
    while True:
        number += data[at] == 0x06
        if number == 3:
            break
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    change(data, at + 9)
    path.write_bytes(data[:-8])


def declare_much(data: bytearray, at: int) -> None:
    struct.pack_into("<Q", data, at + 16, 10**15)


def declare_little(data: bytearray, at: int) -> None:
    struct.pack_into("<Q", data, at + 16, 3)


def spoil_checksum(data: bytearray, at: int) -> None:
    data[at + 24] ^= 0xFF


def spoil_compression(data: bytearray, at: int) -> None:
    data[at + 32 : at + 36] = b"none"


@pytest.mark.parametrize(
    ("change", "lost"),
    [(declare_much, 0), (declare_little, 0), (spoil_checksum, 1), (spoil_compression, 1)],
)
def test_a_damaged_chunk_costs_no_other(tmp_path: Path, change, lost: int) -> None:
    count = 20
    path = mcap(tmp_path / "log.mcap", speeds(count))
    damage(path, change)
    log = read_log(path, ROBOT)
    assert len(log.tracks.stamps) == count - lost
    assert "1 of its chunks is damaged" in log.notes[0]
    assert f"{count - lost} messages beside that were read" in log.notes[0]
    assert inspect(path).topics[0].count == count - lost
