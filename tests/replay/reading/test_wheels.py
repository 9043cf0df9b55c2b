"""Wheels of a side: their mean, and a note and their speeds if they disagree."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bag_messages import SECOND, imu, joints, live_inputs, robot_with, write_bag
from icreckon import Log, Robot, read_log

LEFT, RIGHT = ["front_left", "rear_left"], ["front_right", "rear_right"]
RADIUS = 0.5
STAMPS = [k * SECOND // 20 for k in range(20, 220)]


def robot_of(left: list[str] = LEFT, right: list[str] = RIGHT, **tracks: Any) -> Robot:
    mapped = {"topic": "/js", "left": left, "right": right, **tracks}
    return robot_with(tracks=mapped, imu={"topic": "/imu"})


def rates(count: int, odd: float, seconds: float) -> np.ndarray[Any, Any]:
    """Rates [rad/s] of the wheels, the first of the left side off for some time."""
    found = np.full((len(STAMPS), 2 * count), 2.0)
    found[:, -1] += 0.1
    found[100 : 100 + round(20 * seconds), 0] += odd / RADIUS
    return found


def bag_of(path: Path, values: np.ndarray[Any, Any], names: list[str]) -> Path:
    messages = [
        ("/js", joints(stamp, row, names)) for stamp, row in zip(STAMPS, values, strict=True)
    ]
    return write_bag(path, [*messages, *(("/imu", imu(stamp)) for stamp in STAMPS)])


def notes_of(log: Log) -> list[str]:
    return [note for note in log.notes if "wheels" in note]


def test_wheels_that_agree_are_a_mean(tmp_path: Path) -> None:
    log = read_log(bag_of(tmp_path / "bag", rates(2, 0.1, 3.0), [*LEFT, *RIGHT]), robot_of())
    assert log.tracks.left_wheels is None
    assert log.tracks.speeds[0] == pytest.approx([1.0, 1.025])
    assert log.tracks.speeds[110] == pytest.approx([1.05, 1.025])
    assert not notes_of(log)


def test_two_that_disagree_are_named(tmp_path: Path) -> None:
    log = read_log(bag_of(tmp_path / "bag", rates(2, 0.8, 3.0), [*LEFT, *RIGHT]), robot_of())
    assert log.tracks.left_wheels[110] == pytest.approx([1.8, 1.0])
    assert log.tracks.speeds[110] == pytest.approx([1.4, 1.025])
    assert notes_of(log) == [
        "wheels of the left side disagree for 3.0 s: front_left and rear_left are up to 0.80 m/s apart"
    ]


def test_of_three_the_odd_one_is_named(tmp_path: Path) -> None:
    left, right = [*LEFT, "middle_left"], [*RIGHT, "middle_right"]
    path = bag_of(tmp_path / "bag", rates(3, -0.8, 2.0), [*left, *right])
    assert notes_of(read_log(path, robot_of(left, right))) == [
        "wheels of the left side disagree for 2.0 s: front_left is up to 0.80 m/s off"
    ]


def test_columns_of_wheels_too(tmp_path: Path) -> None:
    names = [*LEFT, *RIGHT]
    lines = [",".join(("t", *names))]
    for stamp, row in zip(STAMPS, rates(2, 0.8, 3.0) * RADIUS, strict=True):
        lines.append(",".join(map(repr, (stamp / SECOND, *row.tolist()))))
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    columns = {"time": "t", "tracks": {"left": LEFT, "right": RIGHT}}
    log = read_log(tmp_path / "log.csv", robot_with(columns=columns))
    assert log.tracks.left_wheels[110] == pytest.approx([1.8, 1.0])
    assert len(notes_of(log)) == 1


def test_live_messages_have_the_wheels_always() -> None:
    inputs, topics = live_inputs(**robot_of().log)
    found = []
    for k in range(10):
        message = joints(STAMPS[k], [2.0, 2.2, 2.0, 2.0], [*LEFT, *RIGHT])
        found += inputs.take(topics["/js"], "sensor_msgs/msg/JointState", message, STAMPS[k])
        found += inputs.take(topics["/imu"], "sensor_msgs/msg/Imu", imu(STAMPS[k]), STAMPS[k])
    tracks = [one for one in found if hasattr(one, "left_wheels")]
    assert len(tracks) == 10
    assert tracks[0].left == pytest.approx(1.05)
    assert tracks[0].left_wheels == pytest.approx((1.0, 1.1))
    assert tracks[0].right_wheels == pytest.approx((1.0, 1.0))
