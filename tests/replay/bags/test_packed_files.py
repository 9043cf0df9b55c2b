"""Bags whose files are compressed as a whole."""

import shutil
import tempfile
from pathlib import Path

import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from bag_messages import JOINTS, SECOND, STORE, joints, robot_with
from command_line import fails
from icreckon import ReplayError, inspect, read_log
from icreckon.replay.bags import unpacking

ROBOT = robot_with(tracks=JOINTS)
COUNT = 2000


def bag(folder: Path, plugin: StoragePlugin, mode: CompressionMode) -> Path:
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        kind = "sensor_msgs/msg/JointState"
        at = writer.add_connection("/js", kind, typestore=STORE)
        for k in range(1, COUNT + 1):
            stamp = k * SECOND // 50
            writer.write(at, stamp, STORE.serialize_cdr(joints(stamp, (1.0, 1.0 + k)), kind))
    return folder


PLUGINS = (StoragePlugin.MCAP, StoragePlugin.SQLITE3)


@pytest.mark.parametrize("plugin", PLUGINS)
def test_all_ways_to_give_it_read_the_same(tmp_path, plugin, monkeypatch):
    plain = read_log(bag(tmp_path / "plain", plugin, CompressionMode.NONE), ROBOT)
    folder = bag(tmp_path / "bag", plugin, CompressionMode.FILE)
    with Reader(folder) as reader:
        assert reader.compression_mode == "file"
    file = next(folder.glob("*.zstd"))
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    for path in (folder, file):
        log = read_log(path, ROBOT)
        assert (log.tracks.stamps == plain.tracks.stamps).all()
        assert (log.tracks.speeds == plain.tracks.speeds).all()
        assert log.notes == plain.notes
        assert not list(scratch.iterdir())
    (folder / "metadata.yaml").unlink()
    assert len(read_log(folder, ROBOT).tracks.stamps) == COUNT


def test_the_files_of_a_bag_share_the_limit(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.FILE)
    file = next(folder.glob("*.zstd"))
    size = len(unpacking.zstd.decompress(file.read_bytes()))
    shutil.copy(file, folder / "bag_1.db3.zstd")
    with unpacking.unpacked_limit(1.5 * size / 1e9), pytest.raises(ReplayError) as caught:
        inspect(folder)
    assert str(caught.value).startswith(f"{folder / 'bag_1.db3.zstd'}: the bag unpacks to ")
    with unpacking.unpacked_limit(2.5 * size / 1e9):
        assert inspect(folder).topics[0].count == 2 * COUNT
    said = fails("inspect", folder, "--unpacked-limit", "1e-5", cwd=tmp_path)
    assert "--unpacked-limit raises it" in said


def test_a_cut_file_is_read_up_to_the_break(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", StoragePlugin.MCAP, CompressionMode.FILE)
    file = next(folder.glob("*.zstd"))
    whole = unpacking.zstd.decompress(file.read_bytes())
    middle = len(whole) // 2
    packed = unpacking.zstd.compress(whole[:middle]) + unpacking.zstd.compress(whole[middle:])
    file.write_bytes(packed[:-100])
    log = read_log(folder, ROBOT)
    assert COUNT * 0.4 < len(log.tracks.stamps) < COUNT
    assert log.notes[0] == f"{file.name}: cut short or damaged; what could be unpacked was read"
    assert "cut short" in log.notes[1]
    file.write_bytes(b"no zstd at all")
    with pytest.raises(ReplayError, match="the file is empty") as caught:
        read_log(folder, ROBOT)
    assert str(caught.value).startswith(str(folder / file.stem))


def test_a_bag_that_was_unpacked_beside_is_not_unpacked_again(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.FILE)
    packed = next(folder.glob("*.zstd"))
    packed.with_suffix("").write_bytes(unpacking.zstd.decompress(packed.read_bytes()))
    packed.write_bytes(b"never read")
    assert [one.topic for one in inspect(folder).topics] == ["/js"]
