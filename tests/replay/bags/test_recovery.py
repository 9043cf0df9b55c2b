from pathlib import Path

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from conftest import make_log
from icreckon import Log, Robot, read_log, write_log
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
    found = {"mcap": plain, "mcap-zstd": _compressed_mcap(plain, folder / "zstd"), "ros1": ros1}
    for name in ("BZ2", "LZ4"):
        found[f"ros1-{name.lower()}"] = _compressed_ros1(ros1, folder / f"{name}.bag", name)
    return found


def _compressed_mcap(source: Path, folder: Path) -> Path:
    writer = rosbag2.Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with rosbag2.Reader(source) as reader, writer:
        copies = {
            connection.id: writer.add_connection(
                connection.topic, connection.msgtype, msgdef=connection.msgdef.data, rihs01="none"
            )
            for connection in reader.connections
        }
        for connection, time, data in reader.messages():
            writer.write(copies[connection.id], time, data)
    return folder / "zstd.mcap"


def _compressed_ros1(source: Path, target: Path, form: str) -> Path:
    writer = rosbag1.Writer(target)
    writer.set_compression(rosbag1.Writer.CompressionFormat[form])
    with rosbag1.Reader(source) as reader, writer:
        copies = {
            connection.id: writer.add_connection(
                connection.topic,
                connection.msgtype,
                msgdef=connection.msgdef.data,
                md5sum=connection.digest,
            )
            for connection in reader.connections
        }
        for connection, time, data in reader.messages():
            writer.write(copies[connection.id], time, data)
    return target


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
    assert len(read_log(folder, robot).tracks.stamps) == len(log.tracks.stamps)
