"""Logs whose stamps span decades: memory follows the number of messages."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bag_messages import robot_with
from conftest import thorough
from icreckon.estimator.log.scores import even_grid
from icreckon.replay.reading.read_log import read_log
from small_robot import drive, write_robot

SECOND, NOW, YEARS = 10**9, 500_000_000 * 10**9, 50 * 365 * 86_400 * 10**9
LIMIT = 3 * 2**30
"""Address space of a command [B], most of it libraries."""
COUNT, PERIOD = 400, SECOND // 20


def stamps(kind: str) -> list[int]:
    """Stamps of a drive [ns]: by a clock that is set, with a damaged one, or rows hours apart."""
    regular = [NOW + k * PERIOD for k in range(COUNT)]
    match kind:
        case "set after the start":
            return [one - NOW for one in regular[:40]] + regular[40:]
        case "last is damaged":
            return [*regular[:-1], NOW + YEARS]
        case _:
            return [NOW + k * 20 * 3600 * SECOND for k in range(COUNT)]


def bag(path: Path, kind: str) -> Path:
    return drive(path, stamps(kind))


def table(path: Path, kind: str) -> Path:
    rows = ["t,l,r,w,x,y,yaw"]
    for k, stamp in enumerate(stamps(kind)):
        speed = float(np.sin(0.05 * k) ** 2)
        rows.append(f"{stamp / SECOND:.3f},{speed},{1.2 * speed},{0.25 * speed},{0.05 * k},0.0,0.0")
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


def limited(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run a command with `LIMIT` of memory and a minute of time."""
    start = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({LIMIT}, {LIMIT}));"
        "from icreckon.cli.main import main; main()"
    )
    return subprocess.run(
        [sys.executable, "-c", start, *map(str, words)],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize(
    ("form", "kind"),
    [
        (bag, "set after the start"),
        thorough(table, "last is damaged"),
        thorough(table, "hours apart"),
    ],
)
def test_commands_stay_small(tmp_path: Path, form, kind: str) -> None:
    log = form(tmp_path / ("log.csv" if form is table else "log"), kind)
    write_robot(tmp_path / "robot.toml")
    done = limited(tmp_path, "inspect", log)
    assert done.returncode == 0, done.stderr
    done = limited(tmp_path, "replay", log, "--robot", "robot.toml", "--variants", "differential")
    assert done.returncode == 0, done.stderr
    if form is table:
        done = limited(tmp_path, "calibrate", log, "--robot", "robot.toml")
        assert done.returncode == 1
        assert "drive" in done.stderr.splitlines()[-1], done.stderr


@pytest.mark.parametrize(
    ("kind", "lost"), [("set after the start", 40), ("last is damaged", 1), ("hours apart", 0)]
)
def test_the_larger_part_is_read(tmp_path: Path, kind: str, lost: int) -> None:
    robot = robot_with(
        columns={
            "time": "t",
            "tracks": {"left": ["l"], "right": ["r"]},
            "truth": {"x": "x", "y": "y", "yaw": "yaw"},
        }
    )
    log = read_log(table(tmp_path / "log.csv", kind), robot)
    assert len(log.tracks.stamps) == COUNT - lost
    reason = "stamp is days from most others"
    expected = {f"tracks: {reason}": lost, f"truth: {reason}": lost} if lost else {}
    assert log.dropped == expected


def test_a_cell_that_is_no_time_is_dropped(tmp_path: Path) -> None:
    columns = {"time": "t", "tracks": {"left": ["l"], "right": ["r"]}}
    path = tmp_path / "log.csv"
    for cell in ("1e300", "-7e9", "1e10"):
        path.write_text(f"t,l,r\n1,1,1\n{cell},1,1\n3,1,1\n", encoding="utf-8")
        log = read_log(path, robot_with(columns=columns))
        assert log.tracks.stamps.tolist() == [SECOND, 3 * SECOND]
        assert log.dropped == {"tracks: no time": 1}


def test_even_grid() -> None:
    known = np.array([0, 7, 15, 31]) * SECOND
    np.testing.assert_array_equal(
        even_grid(0, known[-1], 2 * SECOND, known), np.array([*range(0, 17, 2), 30]) * SECOND
    )
    seconds = known / SECOND
    np.testing.assert_allclose(even_grid(0.0, 31.0, 2.0, seconds), [*range(0, 17, 2), 30.0])
    np.testing.assert_array_equal(even_grid(0.5, 9.0, 1.0, seconds), np.arange(0.5, 9.0))
    assert not len(even_grid(5, 3, 1, known))
    far = np.array([0, SECOND, 2**61])
    assert len(even_grid(far[0], far[-1], SECOND // 50, far)) < 600
