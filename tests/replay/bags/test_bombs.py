"""Small files that unpack to large ones."""

import bz2
import gzip
import shutil
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from bag_messages import JOINTS, SECOND, STORE, joints, robot_with
from command_line import fails
from icreckon import ReplayError, inspect, read_log
from icreckon.replay.bags import bag_files, unpacking
from icreckon.replay.bags.table_files import MOST_COLUMNS

SIZE = 6_000_000
"""Size of the message that does not fit [B]; it takes less than a thousandth of that in the file."""
LITTLE = 2_000_000
KIND = "std_msgs/msg/String"


def ros1_bag(path: Path, form: str) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = rosbag1.Writer(path)
    writer.set_compression(rosbag1.Writer.CompressionFormat[form.upper()])
    with writer:
        at = writer.add_connection("/text", KIND, typestore=store)
        data = store.serialize_ros1(store.types[KIND]("a" * SIZE), KIND)
        writer.write(at, SECOND, data)
    return path


def ros2_bag(
    path: Path, plugin: StoragePlugin, mode: CompressionMode, topic: str, *messages
) -> Path:
    """A bag of messages of one type, recorded at 50 Hz."""
    writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        kind = messages[0].__msgtype__
        at = writer.add_connection(topic, kind, typestore=STORE)
        for k, message in enumerate(messages, start=1):
            writer.write(at, k * SECOND // 50, STORE.serialize_cdr(message, kind))
    return path


def bomb(folder: Path, kind: str) -> Path:
    text = "/text", STORE.types[KIND]("a" * SIZE)
    match kind.split():
        case ["ros1", form]:
            return ros1_bag(folder / "bomb.bag", form)
        case ["mcap"]:
            return ros2_bag(folder / "bomb", StoragePlugin.MCAP, CompressionMode.STORAGE, *text)
        case _:
            return ros2_bag(folder / "bomb", StoragePlugin.SQLITE3, CompressionMode.MESSAGE, *text)


KINDS = ("ros1 bz2", "ros1 lz4", "mcap", "sqlite3 messages")


@pytest.mark.parametrize("kind", KINDS)
def test_a_bomb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setattr(unpacking, "MOST_IN_MEMORY", LITTLE)
    path = bomb(tmp_path, kind)
    with pytest.raises(
        ReplayError, match=r"a part of the bag unpacks to more than 0.002 GB"
    ) as caught:
        inspect(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("kind", KINDS)
def test_a_large_message_is_read(tmp_path: Path, kind: str) -> None:
    assert [one.topic for one in inspect(bomb(tmp_path, kind)).topics] == ["/text"]


def packed_table(path: Path, rows: int) -> Path:
    """A table of equal rows, which take next to no place in the file."""
    line = b"1.5,0.25,0.25,abc\n"
    if path.name.endswith(".csv.gz"):
        path.write_bytes(gzip.compress(b"t,l,r,text\n" + rows * line))
    elif path.name.endswith(".csv.bz2"):
        path.write_bytes(bz2.compress(b"t,l,r,text\n" + rows * line))
    else:
        numbers = np.ones(rows)
        columns = {"t": numbers, "l": numbers, "r": numbers, "text": ["abc"] * rows}
        parquet.write_table(pa.table(columns), path, compression="zstd")
    return path


@pytest.mark.parametrize("name", ["log.csv.gz", "log.csv.bz2", "log.parquet"])
def test_a_table_that_unpacks_to_more_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    path = packed_table(tmp_path / name, 130_000)
    assert path.stat().st_size < 100_000
    # With the usual limit it is read, and has one time alone.
    assert "All 130000 times are 1" in fails("inspect", path, cwd=tmp_path)
    monkeypatch.setattr(unpacking, "MOST_IN_MEMORY", LITTLE)
    with pytest.raises(ReplayError) as caught:
        inspect(path)
    assert str(caught.value) == f"{path}: the table unpacks to more than 0.002 GB"


def test_a_table_of_very_many_columns_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    names = ",".join(f"c{k}" for k in range(MOST_COLUMNS + 1))
    path.write_text(f"{names}\n{',' * MOST_COLUMNS}\n", encoding="utf-8")
    said = fails("inspect", path, cwd=tmp_path)
    assert f"{path}: it has 10001 columns, and at most 10000 are read" in said


ROBOT = robot_with(tracks=JOINTS)
COUNT = 400


def bag(folder: Path, plugin: StoragePlugin, mode: CompressionMode) -> Path:
    drive = [joints(k * SECOND // 50, (1.0, 1.0 + k)) for k in range(1, COUNT + 1)]
    return ros2_bag(folder, plugin, mode, "/js", *drive)


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


def test_the_files_of_a_bag_fit_in_half_of_the_free_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = bag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.FILE)
    file = next(folder.glob("*.zstd"))
    size = len(unpacking.zstd.decompress(file.read_bytes()))
    shutil.copy(file, folder / "bag_1.db3.zstd")
    free = SimpleNamespace(free=3 * size)
    monkeypatch.setattr(bag_files, "disk_usage", lambda _: free)
    with pytest.raises(ReplayError, match="half of what is free; TMPDIR names another") as caught:
        inspect(folder)
    assert str(caught.value).startswith(f"{folder / 'bag_1.db3.zstd'}: cannot be unpacked to ")
    free.free = 5 * size
    assert inspect(folder).topics[0].count == 2 * COUNT


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
