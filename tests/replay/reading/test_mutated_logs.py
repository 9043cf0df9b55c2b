"""Damaged copies of every kind of log: a log or one line."""

import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from bag_messages import JOINTS, SECOND, STORE, imu, joints, robot_with
from conftest import make_log
from icreckon import ReplayError, Robot, inspect, load_robot, read_log, write_log
from mutations import mutated

COPIES = 60
ALPHA = load_robot("auriga-alpha")
TABLE = robot_with(
    columns={
        "time": "t",
        "tracks": {"left": ["l"], "right": ["r"]},
        "imu": {"angular_velocity": ["w"]},
        "fixes": {"x": "x", "y": "y", "position_sigma": 0.1},
    }
)


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


def rows() -> dict[str, np.ndarray]:
    t = np.arange(60) * 0.05
    return {"t": t, "l": np.sin(t), "r": np.cos(t), "w": np.cos(t), "x": t, "y": np.ones(60)}


def csv() -> bytes:
    table = np.column_stack(list(rows().values()))
    lines = [",".join(f"{cell:.4f}" for cell in row) for row in table]
    return "\n".join([",".join(rows()), *lines]).encode()


BAGS = {"mcap": "log.mcap", "ros1": "log.bag", "sqlite3": "log.db3"}
KINDS = (*BAGS, "compressed", "csv", "parquet")


def made(folder: Path, kind: str) -> tuple[Path, Robot]:
    """A small valid file, and the robot with which it is read."""
    if kind in BAGS:
        return write_log(make_log(seconds=0.3), folder / BAGS[kind], kind, ALPHA), ALPHA
    if kind == "compressed":
        robot = robot_with(tracks=JOINTS, imu={"topic": "/imu"})
        return packed_bag(folder, StoragePlugin.MCAP, CompressionMode.STORAGE), robot
    if kind == "parquet":
        table = pa.table({**rows(), "text": ["a", "b"] * 30, "list": [[1, 2]] * 60})
        parquet.write_table(table, folder / "log.parquet", compression="zstd")
        return folder / "log.parquet", TABLE
    (folder / "log.csv").write_bytes(csv())
    return folder / "log.csv", TABLE


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
