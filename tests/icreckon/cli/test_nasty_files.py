"""Small nasty files through the commands that read logs: one line each, and no traceback.

Others are in `tests/replay/bags` (bombs, many chunks, definitions, values of SQLite), in
`tests/replay/reading` (mutated logs, far stamps) and in `test_hostile_names.py`.
"""

import bz2
import gzip
import io
import os
import sqlite3
from contextlib import closing
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet

from command_line import fails
from icreckon.replay.bags.unpacking import zstd
from small_robot import drive, write_robot

NOISE = bytes(range(256)) * 40
HEADER = b"t,l,r,w,x,y,yaw\n"


def some_parquet(**columns: object) -> bytes:
    target = io.BytesIO()
    parquet.write_table(pa.table(columns), target)
    return target.getvalue()


CONTENTS = {
    "empty.bag": b"",
    "empty.csv": b"",
    "noise.bag": NOISE,
    "noise.mcap": NOISE,
    "noise.db3": NOISE,
    "noise.csv": NOISE,
    "noise.csv.gz": NOISE,
    "noise.parquet": b"PAR1" + NOISE + b"PAR1",
    "noise.mcap.zstd": NOISE,
    "packed-noise.db3.zstd": zstd.compress(NOISE),
    "magic.bag": b"#ROSBAG V2.0\n",
    "old.bag": b"#ROSBAG V1.2\n" + NOISE,
    "magic.mcap": b"\x89MCAP0\r\n",
    "magic.db3": b"SQLite format 3\0",
    "magic.parquet": b"PAR1",
    "two-magics.mcap": b"\x89MCAP0\r\n" * 2,
    "zeros.mcap": b"\x89MCAP0\r\n" + bytes(5000),
    "zeros.bag": b"#ROSBAG V2.0\n" + bytes(5000),
    "names-only.csv": HEADER,
    "empty-cells.csv": HEADER + b",,,,,,\n" * 50,
    "texts.csv": HEADER + b"a,b,c,d,e,f,g\n" * 50,
    "formulas.csv": HEADER + b"=1+1,@x,+1-1,-1+1,=cmd,|a,%b\n" * 50,
    "infinite.csv": HEADER + b"inf,inf,nan,-inf,1e999,nan,nan\n" * 50,
    "nul.csv": HEADER + b"1,2\0,3,4,5,6,7\n" * 50,
    "short-rows.csv": HEADER + b"1,2\n3\n",
    "open-quote.csv": HEADER + b'"1,2,3,4,5,6,7\n' * 3,
    "one-long-line.csv": b"x" * 3_000_000,
    "twice.csv": b"t,l,l,r\n1,2,3,4\n",
    "utf-16.csv": HEADER.decode().encode("utf-16"),
    "cut.csv.gz": gzip.compress(HEADER + b"1,2,3,4,5,6,7\n" * 50)[:-20],
    "cut.csv.bz2": bz2.compress(HEADER + b"1,2,3,4,5,6,7\n" * 50)[:-20],
    "no-rows.parquet": some_parquet(t=pa.array([], pa.float64())),
    "lists.parquet": some_parquet(t=[[1.0]] * 3, l=[{"a": 1}] * 3, r=["x"] * 3),
}


PLACES = (
    "an empty folder",
    "a link to itself",
    "a pipe",
    "metadata alone",
    "other tables",
    "a bag without messages",
)


def make(name: str, path: Path) -> None:
    """Make a nasty file or folder."""
    if name in CONTENTS:
        path.write_bytes(CONTENTS[name])
    elif name == "a link to itself":
        path.symlink_to(path)
    elif name == "a pipe":
        os.mkfifo(path)
    elif name == "a bag without messages":
        drive(path, [])
    else:
        path.mkdir()
    if name == "metadata alone":
        (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n", encoding="utf-8")
    if name == "other tables":
        with closing(sqlite3.connect(path / "bag.db3")) as database:
            database.execute("CREATE TABLE apples(id INTEGER)")


# Files in which there is something to list.
LISTED = {"lists.parquet", "a bag without messages"} | {
    f"{one}.csv" for one in ("empty-cells", "texts", "formulas", "infinite", "nul")
}


@pytest.mark.parametrize("name", [*CONTENTS, *PLACES])
def test_a_nasty_file_is_one_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    make(name, path)
    write_robot(tmp_path / "robot.toml")
    said = [fails("replay", "--robot", "robot.toml", path, cwd=tmp_path)]
    # What is readable is listed, though it holds nothing.
    if name not in LISTED:
        said.append(fails("inspect", path, cwd=tmp_path))
    assert max(map(len, said)) < 2000 + 200
    assert {one.name for one in tmp_path.iterdir()} == {path.name, "robot.toml"}
