"""Check and inspect agree on an odometry that turns too far."""

from __future__ import annotations

from pathlib import Path

from conftest import inspected, sample_log
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.replay.checking.robot_check import check_robot
from icreckon.replay.reading.read_log import read_log


def test_both_report_the_jackal(data_dir: Path) -> None:
    path, robot = sample_log(data_dir, "jackal_test2.bag"), load_robot("jackal")
    (found,) = (one for one in inspected(path).findings if "odometry's yaw rate" in one)
    (one,) = (
        one for one in check_robot(read_log(path, robot), robot) if one.name == "sense of turning"
    )
    times = found.partition(" times")[0].rpartition(" ")[2]
    assert f"the odometry's yaw rate is {times} times the gyro's" in one.problem
    assert "gauge in [log.tracks]" in one.remedy
