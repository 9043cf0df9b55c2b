"""Bags of many chunks, messages or index entries: memory stays that of a few chunks."""

import sqlite3
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from bag_messages import JOINTS, SECOND, SPEEDS, STORE, joints, robot_with, write_bag
from icreckon.replay.bags.unpacking import unpacked_limit
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.inspection.inspect import inspect
from icreckon.replay.reading.read_log import read_log

ROBOT = robot_with(tracks=JOINTS)
LIMIT_GB, LIMIT = 0.002, 2_000_000


@contextmanager
def at_most(size: float) -> Iterator[None]:
    """Fail if Python holds more than `size` bytes more at any time in the block."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < size
    finally:
        tracemalloc.stop()


def mcap(
    path: Path, messages: list[tuple[int, bytes]], index: IndexType = IndexType.ALL, size: int = 1
) -> Path:
    """A bag of JointState messages, (time of recording, bytes); a new chunk after `size` bytes."""
    with path.open("wb") as file:
        writer = McapWriter(
            file, chunk_size=size, compression=CompressionType.ZSTD, index_types=index
        )
        writer.start(profile="ros2")
        text, _ = STORE.generate_msgdef("sensor_msgs/msg/JointState")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", text.encode())
        at = writer.register_channel("/js", "cdr", schema)
        for time, data in messages:
            writer.add_message(at, time, data, time)
        writer.finish()
    return path


def speeds(count: int, padding: int) -> list[tuple[int, bytes]]:
    """Messages of track speeds with a long name of their frame."""
    found = []
    for k in range(1, count + 1):
        message = joints(k * SECOND // 50, (1.0, 2.0))
        message.header.frame_id = "a" * padding
        data = STORE.serialize_cdr(message, "sensor_msgs/msg/JointState")
        found.append((k * SECOND // 50, bytes(data)))
    return found


def test_chunks_just_below_the_limit_are_read_one_after_the_other(tmp_path: Path) -> None:
    path = mcap(tmp_path / "log.mcap", speeds(300, LIMIT - 1000))
    assert path.stat().st_size < 0.001 * 300 * LIMIT
    for read in (inspect, lambda path: read_log(path, ROBOT)):
        with unpacked_limit(LIMIT_GB), at_most(12 * LIMIT):
            read(path)


def test_chunks_of_the_same_time_are_not_all_held(tmp_path: Path) -> None:
    messages = speeds(100, LIMIT // 4)
    # Each chunk of two messages goes from the beginning to the end.
    spread = [
        (time, data)
        for (_, data), (late, other) in zip(messages, reversed(messages), strict=True)
        for time, data in ((1, data), (10 * SECOND + late, other))
    ]
    path = mcap(tmp_path / "log.mcap", spread, size=LIMIT // 2)
    with unpacked_limit(LIMIT_GB), at_most(6 * LIMIT):
        log = read_log(path, ROBOT)
    assert "its chunks overlap in time and unpack to" in log.notes[0]
    assert "all its 200 messages were read without the index" in log.notes[0]
    assert "overlap" not in " ".join(read_log(path, ROBOT).notes)


def test_more_messages_than_bytes_are_refused(tmp_path: Path) -> None:
    path = mcap(tmp_path / "log.mcap", [(1, b"")] * 60_000, IndexType.NONE, size=LIMIT)
    assert path.stat().st_size < 10_000
    for read in (inspect, lambda path: read_log(path, ROBOT)):
        with at_most(6 * LIMIT), pytest.raises(ReplayError, match="more messages than its") as e:
            read(path)
        assert str(path) in str(e.value)


def ros1_bag(path: Path, count: int) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    new, kind = store.types, "sensor_msgs/msg/JointState"
    with rosbag1.Writer(path) as writer:
        at = writer.add_connection("/js", kind, typestore=store)
        for k in range(1, count + 1):
            stamp = new["builtin_interfaces/msg/Time"](k, 0)
            made = joints(k * SECOND, (1.0, 2.0))
            message = new[kind](
                new["std_msgs/msg/Header"](k, stamp, ""),
                made.name,
                made.position,
                made.velocity,
                made.effort,
            )
            writer.write(at, k * SECOND, store.serialize_ros1(message, kind))
    return path


def test_chunks_that_share_an_index_do_not_multiply_it(tmp_path: Path) -> None:
    path, count = ros1_bag(tmp_path / "log.bag", 2000), 2000
    data = path.read_bytes()
    place = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)[0]
    while place < len(data):
        # The last record of the file lists its chunk.
        last = place
        place += 4 + struct.unpack_from("<L", data, place)[0]
        place += 4 + struct.unpack_from("<L", data, place)[0]
    hostile = bytearray(data + data[last:] * 1000)
    struct.pack_into("<L", hostile, hostile.index(b"chunk_count=") + 12, 1001)
    path.write_bytes(hostile)
    with at_most(100 * len(data)):
        log = read_log(path, ROBOT)
    assert len(log.tracks.stamps) == count
    assert "the indexes of its chunks overlap" in log.notes[0]


def test_values_that_sqlite_computes_are_limited(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        kind = "sensor_msgs/msg/JointState"
        at = writer.add_connection("/js", kind, typestore=STORE)
        writer.write(at, SECOND, STORE.serialize_cdr(SPEEDS[0][1], kind))
    file = tmp_path / "bag" / "bag.db3"
    database = sqlite3.connect(file)
    database.executescript(
        "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
        "timestamp INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(300000000)) VIRTUAL);"
        "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1);"
    )
    database.close()
    with unpacked_limit(LIMIT_GB), at_most(6 * LIMIT), pytest.raises(ReplayError) as caught:
        read_log(tmp_path / "bag", ROBOT)
    assert "a message of the bag unpacks to" in str(caught.value)
    assert "--unpacked-limit raises it" in str(caught.value)


def test_metadata_that_refers_to_itself_is_left_aside(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", SPEEDS)
    metadata = folder / "metadata.yaml"
    text = metadata.read_text(encoding="utf-8")
    laughs = "".join(
        f"  x{k}: &x{k} [{', '.join([f'*x{k - 1}'] * 10) if k else 'ha'}]\n" for k in range(9)
    )
    changed = text.replace("compression_format: ''", "compression_format: *x8")
    changed = changed.replace("compression_mode: ''", "compression_mode: file")
    assert changed.count("*x8") == 1
    metadata.write_text(changed.replace(":\n", f":\n{laughs}", 1), encoding="utf-8")
    with at_most(LIMIT):
        log = read_log(folder, ROBOT)
    assert len(log.tracks.stamps) == len(SPEEDS)
    assert "metadata.yaml refers to itself" in log.notes[0]
    for odd in ("[" * 2000, "a: " * 2000, "\t", "x" * 600_000):
        metadata.write_text(odd, encoding="utf-8")
        assert len(read_log(folder, ROBOT).tracks.stamps) == len(SPEEDS)


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
    [(declare_much, 0), (declare_little, 1), (spoil_checksum, 1), (spoil_compression, 1)],
)
def test_a_damaged_chunk_costs_no_other(tmp_path: Path, change, lost: int) -> None:
    count = 20
    path = mcap(tmp_path / "log.mcap", speeds(count, 100))
    damage(path, change)
    log = read_log(path, ROBOT)
    assert len(log.tracks.stamps) == count - lost
    assert "1 of its chunks is damaged" in log.notes[0]
    assert f"{count - lost} messages beside that were read" in log.notes[0]
    assert inspect(path).topics[0].count == count - lost
