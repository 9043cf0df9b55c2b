import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from bag_messages import JOINTS, SECOND, STORE, joints, robot_with
from conftest import make_log
from icreckon import Log, Robot, inspect, read_log, write_log
from icreckon.replay.bags.recovery import RecordWalk

SHARES = [0.05, 0.5, 0.97]


@pytest.fixture(scope="module")
def made() -> Log:
    """Long enough for several chunks of a megabyte."""
    return make_log(seconds=60.0)


@pytest.fixture(scope="module")
def bags(made: Log, robot: Robot, tmp_path_factory) -> dict[str, Path]:
    """The log in every format and compression, as single files."""
    folder = tmp_path_factory.mktemp("bags")
    plain = write_log(made, folder / "plain.mcap", "mcap", robot)
    ros1 = write_log(made, folder / "plain.bag", "ros1", robot)
    packed = rosbag2.Writer(folder / "zstd", version=9, storage_plugin=StoragePlugin.MCAP)
    packed.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    _copy(rosbag2.Reader(plain), packed)
    found = {"mcap": plain, "mcap-zstd": folder / "zstd" / "zstd.mcap", "ros1": ros1}
    for form in (rosbag1.Writer.CompressionFormat.BZ2, rosbag1.Writer.CompressionFormat.LZ4):
        found[f"ros1-{form.name.lower()}"] = folder / f"{form.name}.bag"
        writer = rosbag1.Writer(folder / f"{form.name}.bag")
        writer.set_compression(form)
        _copy(rosbag1.Reader(ros1), writer)
    return found


def _copy(reader: rosbag1.Reader | rosbag2.Reader, writer: Any) -> None:
    """Write the messages of a bag to another one."""
    with reader, writer:
        copies = {}
        for one in reader.connections:
            is_ros1 = isinstance(reader, rosbag1.Reader)
            version = {"md5sum": one.digest} if is_ros1 else {"rihs01": "none"}
            copies[one.id] = writer.add_connection(
                one.topic, one.msgtype, msgdef=one.msgdef.data, **version
            )
        for one, time, data in reader.messages():
            writer.write(copies[one.id], time, data)


KINDS = ["mcap", "mcap-zstd", "ros1", "ros1-bz2", "ros1-lz4"]


def _cut(path: Path, share: float, folder: Path) -> Path:
    short = folder / f"cut{path.suffix}"
    data = path.read_bytes()
    short.write_bytes(data[: int(len(data) * share)])
    return short


@pytest.mark.parametrize("kind", KINDS)
def test_walking_an_intact_file_finds_what_its_index_finds(bags, kind: str) -> None:
    walk = RecordWalk(bags[kind])
    found = [(r.channel.topic, r.channel.msgtype, r.time, bytes(r.data)) for r in walk.records()]
    assert walk.complete
    reader_class = rosbag1.Reader if kind.startswith("ros1") else rosbag2.Reader
    with reader_class(bags[kind]) as reader:
        expected = [(c.topic, c.msgtype, t, bytes(data)) for c, t, data in reader.messages()]
    assert sorted(found) == sorted(expected)


# bz2 packs 900 kB at a time, and nothing of a block can be read before its end.
CUTS = [(kind, share) for kind in KINDS for share in SHARES if kind != "ros1-bz2" or share > 0.4]


@pytest.mark.parametrize(("kind", "share"), CUTS)
def test_a_cut_file_is_read_up_to_the_break(bags, made, robot, tmp_path, kind, share):
    short = _cut(bags[kind], share, tmp_path)
    log = read_log(short, robot)
    count = len(log.tracks.stamps)
    speeds = made.tracks.speeds[:count] / robot.vehicle.sprocket_radius
    assert 0 < count <= len(made.tracks.stamps)
    np.testing.assert_array_equal(log.tracks.stamps, made.tracks.stamps[:count])
    np.testing.assert_array_equal(log.tracks.speeds, speeds * robot.vehicle.sprocket_radius)
    np.testing.assert_array_equal(log.imu.stamps, made.imu.stamps[: len(log.imu.stamps)])
    assert log.dropped == {}
    (note,) = (note for note in log.notes if "messages" in note)
    assert short.name in note
    # An uncompressed file gives up to the last whole message; a compressed one loses a block.
    if kind in ("mcap", "ros1"):
        assert count / len(made.tracks.stamps) > share - 0.1
        assert "cut short" in note or "without the index" in note


def test_a_cut_file_inside_a_ros2_folder(robot: Robot, made: Log, tmp_path: Path) -> None:
    folder = write_log(made, tmp_path / "bag", "mcap", robot)
    file = folder / "bag.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    log = read_log(folder, robot)
    assert len(made.tracks.stamps) * 0.4 < len(log.tracks.stamps) < len(made.tracks.stamps) * 0.6
    assert "bag.mcap" in log.notes[0]
    (folder / "metadata.yaml").unlink()
    without = read_log(folder, robot)
    assert len(without.tracks.stamps) == len(log.tracks.stamps)
    assert any("metadata" in note for note in without.notes)


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
    assert f"{count - lost} other messages were read" in log.notes[0]
    found = inspect(path)
    assert found.topics[0].count == count - lost
    assert "1 of its chunks is damaged" in found.notes[0]
