"""Small files that unpack to large ones."""

import bz2
import gzip
import struct
import time
import tracemalloc
from pathlib import Path

import lz4.frame
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from bag_messages import JOINTS, SECOND, robot_with
from command_line import fails, icreckon
from icreckon.replay.bags import unpacking
from icreckon.replay.bags.table_files import MOST_COLUMNS
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.reading.read_log import read_log
from icreckon.replay.reading.tables import Table

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
    # A size beyond the limit is damage if there is less.
    assert unpacking.inflate(packed, form, 10**12) == data
    with unpacking.unpacked_limit(0.001), pytest.raises(ReplayError, match="unpacks to 1e\\+03 GB"):
        unpacking.inflate(packed, form, 10**12)


def test_frames_without_content_end_soon() -> None:
    empty = unpacking.zstd.compress(b"")
    began = time.process_time()
    assert unpacking.inflate(empty * 500_000, "zstd", 1000) == b""
    assert time.process_time() - began < 60.0


@pytest.mark.parametrize("given", ["-1", "nan", "inf", "1e300"])
def test_a_limit_that_is_none_is_refused(tmp_path: Path, given: str) -> None:
    said = fails("inspect", tmp_path, "--unpacked-limit", given, cwd=tmp_path)
    assert "must be from 0 to 1e+06 GB" in said


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
def test_a_table_that_unpacks_to_more_is_refused(tmp_path: Path, name: str) -> None:
    path = packed_table(tmp_path / name, 130_000)
    assert path.stat().st_size < 100_000
    said = fails("inspect", path, "--unpacked-limit", LIMIT_GB, cwd=tmp_path)
    assert f"{path}: the table unpacks to 0.00" in said
    assert "the limit is 0.002 GB" in said
    assert "--unpacked-limit raises it" in said
    done = icreckon("inspect", path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_table_of_large_texts_takes_the_place_of_one(tmp_path: Path) -> None:
    rows, text = 2_000, "x" * 100_000
    columns = {
        "t": np.arange(rows) * 0.02,
        "l": np.ones(rows),
        "r": np.ones(rows),
        "text": pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), [text]),
        "list": pa.array([[1.0, 2.0]] * rows),
    }
    path = tmp_path / "log.parquet"
    parquet.write_table(pa.table(columns), path, store_schema=False)
    before = pa.total_allocated_bytes()
    found = Table(path)
    assert pa.total_allocated_bytes() - before < 10_000_000
    kinds = {column.name: column.kind for column in found.columns}
    assert kinds["text"] == "string"
    assert kinds["list"].startswith("list")
    with pytest.raises(
        ReplayError, match=r"column 'text' holds string, not numbers \(such as 'xxx"
    ):
        found.numbers(["t", "text"])
    with pytest.raises(ReplayError, match="column 'list' holds list<element: double>, not numbers"):
        found.numbers(["list"])


def test_a_table_of_very_many_columns_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    names = ",".join(f"c{k}" for k in range(MOST_COLUMNS + 1))
    path.write_text(f"{names}\n{',' * MOST_COLUMNS}\n", encoding="utf-8")
    said = fails("inspect", path, cwd=tmp_path)
    assert f"{path}: it has 10001 columns, and at most 10000 are read" in said
