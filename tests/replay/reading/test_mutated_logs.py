"""Damaged copies of every kind of log: a log or one line."""

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from bag_messages import robot_with
from conftest import make_log
from icreckon import ReplayError, Robot, inspect, load_robot, read_log, write_log

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


def rows() -> dict[str, np.ndarray]:
    t = np.arange(60) * 0.05
    return {"t": t, "l": np.sin(t), "r": np.cos(t), "w": np.cos(t), "x": t, "y": np.ones(60)}


def csv() -> bytes:
    table = np.column_stack(list(rows().values()))
    lines = [",".join(f"{cell:.4f}" for cell in row) for row in table]
    return "\n".join([",".join(rows()), *lines]).encode()


BAGS = {"mcap": "log.mcap", "ros1": "log.bag", "sqlite3": "log.db3"}
KINDS = (*BAGS, "csv", "parquet")


def made(folder: Path, kind: str) -> tuple[Path, Robot]:
    """A small valid file, and the robot with which it is read."""
    if kind in BAGS:
        return write_log(make_log(seconds=0.3), folder / BAGS[kind], kind, ALPHA), ALPHA
    if kind == "parquet":
        table = pa.table({**rows(), "text": ["a", "b"] * 30, "list": [[1, 2]] * 60})
        parquet.write_table(table, folder / "log.parquet", compression="zstd")
        return folder / "log.parquet", TABLE
    (folder / "log.csv").write_bytes(csv())
    return folder / "log.csv", TABLE


def mutated(data: bytes) -> Iterator[bytes]:
    """Yield damaged copies: bits flipped, bytes cut off, doubled, taken out, put in, overwritten."""
    rng = np.random.default_rng(17)
    for _ in range(COPIES):
        hurt = data
        for _ in range(rng.integers(1, 4)):
            hurt = _once(hurt, rng)
        yield hurt


def _once(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(0, len(data) + 1))
    length = int(rng.integers(1, 40))
    match rng.integers(0, 7):
        case 0:
            changed = bytearray(data)
            for place in rng.integers(0, len(data), rng.integers(1, 6)) if data else ():
                changed[place] ^= 1 << rng.integers(0, 8)
            return bytes(changed)
        case 1:
            return data[:at]
        case 2:
            return data[:at] + data[at : at + length] + data[at:]
        case 3:
            return data[:at] + data[at + length :]
        case 4:
            return data[:at] + rng.bytes(length) + data[at:]
        case 5:
            return data[:at] + bytes([rng.choice([0, 0x7F, 0x80, 0xFF])] * 8) + data[at + 8 :]
        case _:
            # Digits and signs, for texts.
            return data[:at] + rng.choice([b"-", b"9", b"e", b"nan", b'"', b"\n", b","]) + data[at:]


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_logs_are_read_or_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    file, robot = made(tmp_path, kind)
    data, outcomes = file.read_bytes(), {True: 0, False: 0}
    for number, hurt in enumerate(mutated(data)):
        file.write_bytes(hurt)
        for read in (read_log, inspect) if number % 4 == 0 else (read_log,):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    read(file, robot) if read is read_log else read(file)
                outcomes[True] += 1
            except ReplayError as problem:
                assert "\n" not in str(problem)  # noqa: PT017 - any outcome will do
                assert len(str(problem)) < 2000  # noqa: PT017
                outcomes[False] += 1
    if kind in ("mcap", "ros1", "csv"):
        assert min(outcomes.values())
