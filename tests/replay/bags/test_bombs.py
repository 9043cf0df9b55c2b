"""Small files that unpack to large ones."""

from __future__ import annotations

import bz2
import struct
import tracemalloc
from pathlib import Path

import lz4.frame
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from bag_messages import JOINTS, SECOND, robot_with
from command_line import fails, icreckon
from icreckon.replay.bags import unpacking
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.inspection.inspect import inspect
from icreckon.replay.reading.read_log import read_log

SIZE = 6_000_000
"""Size of the message that does not fit [B]; it takes less than a thousandth of that in the file."""
LIMIT_GB = 0.002
KIND = "std_msgs/msg/String"
COMPRESSORS = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": unpacking.zstd.compress}


def ros1_bag(path: Path, form: str) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = rosbag1.Writer(path)
    writer.set_compression(rosbag1.Writer.CompressionFormat[form.upper()])
    with writer:
        at = writer.add_connection("/text", KIND, typestore=store)
        data = store.serialize_ros1(store.types[KIND]("a" * SIZE), KIND)
        writer.write(at, SECOND, data)
    return path


def ros2_bag(path: Path, plugin: StoragePlugin, mode: CompressionMode) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        at = writer.add_connection("/text", KIND, typestore=store)
        writer.write(at, SECOND, store.serialize_cdr(store.types[KIND]("a" * SIZE), KIND))
    return path


def bomb(folder: Path, kind: str) -> Path:
    match kind.split():
        case ["ros1", form]:
            return ros1_bag(folder / "bomb.bag", form)
        case ["mcap"]:
            return ros2_bag(folder / "bomb", StoragePlugin.MCAP, CompressionMode.STORAGE)
        case _:
            return ros2_bag(folder / "bomb", StoragePlugin.SQLITE3, CompressionMode.MESSAGE)


KINDS = ("ros1 bz2", "ros1 lz4", "mcap", "sqlite3 messages")


@pytest.mark.parametrize("kind", KINDS)
def test_a_bomb_is_refused_and_the_limit_can_be_raised(tmp_path: Path, kind: str) -> None:
    path = bomb(tmp_path, kind)
    said = fails("inspect", path, "--unpacked-limit", LIMIT_GB, cwd=tmp_path)
    assert "unpacks to 0.006 GB, and the limit is 0.002 GB" in said
    assert "--unpacked-limit raises it" in said
    assert str(path) in said
    done = icreckon("inspect", path, cwd=tmp_path)
    assert done.returncode == 0
    assert "/text" in done.stdout


def _pretending(path: Path, size: int, declared: int) -> None:
    """Change the size that the chunks of a file declare."""
    data = path.read_bytes()
    for form in ("<Q", "<L"):
        data = data.replace(struct.pack(form, size), struct.pack(form, declared))
    path.write_bytes(data)


def _declared(path: Path) -> int:
    """Size that the first chunk of a file declares [B]."""
    data = path.read_bytes()
    if path.suffix == ".bag":
        return int(struct.unpack_from("<L", data, data.index(b"size=") + 5)[0])
    at = 8
    while data[at] != 0x06:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return int(struct.unpack_from("<Q", data, at + 9 + 16)[0])


@pytest.mark.parametrize("kind", KINDS[:3])
def test_a_size_that_lies_is_the_limit(tmp_path: Path, kind: str) -> None:
    path = bomb(tmp_path, kind)
    file = path if path.is_file() else next(path.glob("*.mcap"))
    _pretending(file, _declared(file), 100_000)
    tracemalloc.start()
    try:
        with pytest.raises(ReplayError, match=r"no message can be read|'/js' for tracks is not"):
            read_log(file, robot_with(tracks=JOINTS))
        assert tracemalloc.get_traced_memory()[1] < 0.5 * SIZE
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("form", COMPRESSORS)
def test_unpacking_ends_at_the_declared_size(form: str) -> None:
    data = bytes(range(256)) * 4000
    packed = COMPRESSORS[form](data)
    assert unpacking.inflate(packed, form, len(data)) == data
    assert unpacking.inflate(packed, form, 1000) == data[:1001]
    assert unpacking.inflate(packed + packed, form, 2 * len(data)) == data + data
    cut = unpacking.inflate(packed[: len(packed) // 2], form, len(data))
    assert data.startswith(cut)
    with pytest.raises(ReplayError, match="unpacks to 1e\\+03 GB"):
        unpacking.inflate(packed, form, 10**12)


def test_a_bag_that_was_unpacked_beside_is_not_unpacked_again(tmp_path: Path) -> None:
    path = ros2_bag(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.FILE)
    packed = next(path.glob("*.zstd"))
    with pytest.raises(ReplayError, match="unpack it first"):
        inspect(path)
    packed.with_suffix("").write_bytes(unpacking.zstd.decompress(packed.read_bytes()))
    packed.write_bytes(b"never read")
    assert [one.topic for one in inspect(path).topics] == ["/text"]
