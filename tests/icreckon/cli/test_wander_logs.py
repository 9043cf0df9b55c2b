"""Plain GPS from end to end: a bag, a robot file that says how its fixes wander, and the commands."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from icreckon import FixSpec, Log, Scenario, Settings, compare, read_log, simulate, write_log
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, load_robot
from icreckon.replay.comparison.initial_pose import start_from_fixes

ALPHA = load_robot("auriga-alpha")
GPS = FixSpec(sigma=0.3, wander_sigma=1.2, wander_time=60.0)
TOPIC = 'topic = "/fix/pose"\n'
WANDER = "wander_sigma = 1.2\nwander_time = 60.0\n"


@pytest.fixture(scope="module")
def log() -> Log:
    scenario = Scenario(duration=120.0, seed=3, fix_rate=1.0, fixes=GPS, truth="kinematic")
    return simulate(scenario, ALPHA)


@pytest.fixture(scope="module")
def bag(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(log, tmp_path_factory.mktemp("wander") / "bag", "mcap", ALPHA)


def robot_file(folder: Path, keys: str) -> Path:
    text = (ROBOTS_FOLDER / "auriga-alpha.toml").read_text(encoding="utf-8")
    path = folder / "robot.toml"
    assert text.count(TOPIC) == 1
    path.write_text(text.replace(TOPIC, TOPIC + keys), encoding="utf-8")
    return path


def test_white_part_of_messages_with_a_covariance(log: Log, tmp_path: Path) -> None:
    log = log.part(0.0, 20.0)
    rough = replace(log.fixes, variances=np.full_like(log.fixes.variances, 1.5))
    claimed = replace(log, fixes=rough)
    bag = write_log(claimed, tmp_path / "bag", "mcap", ALPHA)
    white = "position_sigma = 0.3\n"
    for keys, sigma in (
        ("", 1.5**0.5),
        (white, 1.5**0.5),
        (WANDER, 1.5**0.5),
        (WANDER + white, 0.3),
    ):
        read = read_log(bag, load_robot(robot_file(tmp_path, keys)))
        assert read.fixes.variances[:, 0] == pytest.approx(sigma**2)


def test_a_start_at_fixes_that_wander_counts_for_little(log: Log) -> None:
    """Without a truth the run starts at the fixes, and the filter uses them once more."""
    robot = msgspec.structs.replace(
        ALPHA, log={"fixes": {"topic": "/fix/pose", "wander_sigma": 1.2, "wander_time": 60.0}}
    )
    unknown = replace(log, truth=None)
    start = start_from_fixes(unknown, robot, "constant-online", None)
    assert start.sigma[0] > 3.0 * 1.2
    assert abs(start.pose[2] - log.truth.poses.poses[0, 2]) < 3.0 * start.sigma[2]
    compared = compare(unknown, robot, ["constant-online"], settings=Settings())
    found = compared.runs["constant-online"]
    error = found.trajectory.poses[-1, :2] - log.truth.poses.poses[-1, :2]
    covariance = found.trajectory.pose_covariances[-1, :2, :2]
    assert error @ np.linalg.solve(covariance, error) < 12.0
