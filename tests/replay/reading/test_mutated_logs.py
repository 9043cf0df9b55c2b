"""Damaged copies of every kind of log: a log or one line, in bounded memory and time."""

import gzip
import resource
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from rosbags import rosbag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from bag_messages import JOINTS, SECOND, STORE, imu, joints, robot_with
from conftest import make_log
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.export.log_bag import write_log
from icreckon.replay.inspection.inspect import inspect
from icreckon.replay.reading.read_log import read_log
from mutations import mutated
from tum import read_tum

MEMORY = 2**30
"""Address space that a damaged file may take beside what the process has [B]."""
COPIES, LONGEST = 60, 20.0
ALPHA = load_robot("auriga-alpha")
TABLE = robot_with(
    columns={
        "time": "t",
        "tracks": {"left": ["l"], "right": ["r"]},
        "imu": {"angular_velocity": ["w"]},
        "fixes": {"x": "x", "y": "y", "position_sigma": 0.1},
    }
)


@pytest.fixture(autouse=True)
def bounded_memory() -> Iterator[None]:
    """Memory and time of each test are bounded."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))
    began = time.monotonic()
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    assert time.monotonic() - began < LONGEST


def packed_bag(folder: Path, plugin: StoragePlugin, mode: CompressionMode) -> Path:
    writer = Writer(folder / "bag", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        for topic, make in (("/js", lambda at: joints(at, (1.0, 2.0))), ("/imu", imu)):
            kind = make(1).__msgtype__
            at = writer.add_connection(topic, kind, typestore=STORE)
            for k in range(1, 40):
                writer.write(
                    at, k * SECOND // 50, STORE.serialize_cdr(make(k * SECOND // 50), kind)
                )
    return next(folder.glob("bag/bag.*"))


def packed_ros1(path: Path, form: str) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = rosbag1.Writer(path)
    writer.set_compression(rosbag1.Writer.CompressionFormat[form])
    kind = "std_msgs/msg/String"
    with writer:
        at = writer.add_connection("/js", kind, typestore=store)
        for k in range(1, 40):
            text = store.types[kind]("text" * k)
            writer.write(at, k * SECOND, store.serialize_ros1(text, kind))
    return path


def rows() -> dict[str, np.ndarray]:
    t = np.arange(60) * 0.05
    return {"t": t, "l": np.sin(t), "r": np.cos(t), "w": np.cos(t), "x": t, "y": np.ones(60)}


def csv() -> bytes:
    table = np.column_stack(list(rows().values()))
    lines = [",".join(f"{cell:.4f}" for cell in row) for row in table]
    return "\n".join([",".join(rows()), *lines]).encode()


def made(folder: Path, kind: str) -> tuple[Path, Robot]:
    """A small valid file, and the robot with which it is read."""
    of_bag = robot_with(tracks=JOINTS, imu={"topic": "/imu"})
    log = make_log(seconds=0.3)
    match kind.split():
        case ["mcap"]:
            return write_log(log, folder / "log.mcap", "mcap", ALPHA), ALPHA
        case ["ros1"]:
            return write_log(log, folder / "log.bag", "ros1", ALPHA), ALPHA
        case ["db3"]:
            return write_log(log, folder / "log.db3", "sqlite3", ALPHA), ALPHA
        case ["ros1", form]:
            return packed_ros1(folder / "log.bag", form), of_bag
        case ["mcap", "zstd"]:
            return packed_bag(folder, StoragePlugin.MCAP, CompressionMode.STORAGE), of_bag
        case ["db3", "messages"]:
            return packed_bag(folder, StoragePlugin.SQLITE3, CompressionMode.MESSAGE), of_bag
        case ["db3", "file"]:
            return packed_bag(folder, StoragePlugin.SQLITE3, CompressionMode.FILE), of_bag
        case ["metadata"]:
            packed_bag(folder, StoragePlugin.MCAP, CompressionMode.STORAGE)
            return folder / "bag" / "metadata.yaml", of_bag
        case ["parquet"]:
            table = pa.table({**rows(), "text": ["a", "b"] * 30, "list": [[1, 2]] * 60})
            parquet.write_table(table, folder / "log.parquet", compression="zstd")
            return folder / "log.parquet", TABLE
        case ["csv"]:
            (folder / "log.csv").write_bytes(csv())
            return folder / "log.csv", TABLE
        case _:
            (folder / "log.csv.gz").write_bytes(gzip.compress(csv()))
            return folder / "log.csv.gz", TABLE


KINDS = (
    "mcap", "mcap zstd", "ros1", "ros1 BZ2", "ros1 LZ4", "db3", "db3 messages", "db3 file",
    "metadata", "csv", "csv.gz", "parquet",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_logs_are_read_or_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    file, robot = made(tmp_path, kind)
    path = file.parent if file.parent.name == "bag" else file
    data, outcomes = file.read_bytes(), {True: 0, False: 0}
    for number, hurt in enumerate(mutated(data, seed=17, count=COPIES)):
        file.write_bytes(hurt)
        for read in (read_log, inspect) if number % 4 == 0 else (read_log,):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    read(path, robot) if read is read_log else read(path)
                outcomes[True] += 1
            except ReplayError as problem:
                assert "\n" not in str(problem)  # noqa: PT017 - any outcome will do
                assert len(str(problem)) < 2000  # noqa: PT017
                outcomes[False] += 1
    if kind in ("mcap", "ros1", "csv"):
        assert min(outcomes.values())


def test_damaged_trajectories(tmp_path: Path) -> None:
    lines = [f"{1.7e9 + 0.1 * k:.9f} {0.1 * k} 0 0 0 0 0 1" for k in range(50)]
    data = "\n".join(lines).encode()
    path = tmp_path / "run.tum"
    odd = [
        data.replace(b"1700000000.", word, 1) for word in (b"1e9999999", b"1e999999999", b"9" * 40)
    ]
    for hurt in [*odd, *mutated(data, seed=17, count=300)]:
        path.write_bytes(hurt)
        try:
            assert np.isfinite(read_tum(path).poses).all()
        except ReplayError as problem:
            assert "\n" not in str(problem)  # noqa: PT017 - any outcome will do
