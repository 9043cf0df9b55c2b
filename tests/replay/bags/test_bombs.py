"""Small files that unpack to large ones."""

import bz2
import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from bag_messages import SECOND
from command_line import fails, succeeds
from icreckon.replay.bags.table_files import MOST_COLUMNS

SIZE = 6_000_000
"""Size of the message that does not fit [B]; it takes less than a thousandth of that in the file."""
LIMIT_GB = 0.002
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
    assert "unpacks to more than the limit of 0.002 GB; --unpacked-limit raises it" in said
    assert str(path) in said
    done = succeeds("inspect", path, cwd=tmp_path)
    assert "/text" in done.stdout


@pytest.mark.parametrize("given", ["-1", "nan"])
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
    assert f"{path}: the table unpacks to more than the limit of 0.002 GB" in said
    # With the usual limit it is read, and has one time alone.
    assert "All 130000 times are 1" in fails("inspect", path, cwd=tmp_path)


def test_a_table_of_very_many_columns_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    names = ",".join(f"c{k}" for k in range(MOST_COLUMNS + 1))
    path.write_text(f"{names}\n{',' * MOST_COLUMNS}\n", encoding="utf-8")
    said = fails("inspect", path, cwd=tmp_path)
    assert f"{path}: it has 10001 columns, and at most 10000 are read" in said
