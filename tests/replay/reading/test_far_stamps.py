"""Logs whose stamps span decades: memory follows the number of messages."""

from pathlib import Path

import numpy as np
import pytest

from bag_messages import robot_with
from icreckon.replay.reading.read_log import read_log

SECOND, NOW, YEARS = 10**9, 500_000_000 * 10**9, 50 * 365 * 86_400 * 10**9
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


def table(path: Path, kind: str) -> Path:
    rows = ["t,l,r,w,x,y,yaw"]
    for k, stamp in enumerate(stamps(kind)):
        speed = float(np.sin(0.05 * k) ** 2)
        rows.append(f"{stamp / SECOND:.3f},{speed},{1.2 * speed},{0.25 * speed},{0.05 * k},0.0,0.0")
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


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
