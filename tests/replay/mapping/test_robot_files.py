"""The shipped robot files: they load, and their IMU mounting agrees with the sample logs."""

import re
from pathlib import Path

import numpy as np
import pytest

from conftest import REPOSITORY, sample
from icreckon.estimator.robot.robot_file import load_robot, robot_names
from icreckon.replay.estimates.imu_mounting import YawRates, forward_yaw, turning_correlation
from icreckon.replay.mapping.columns import ColumnMap, ImuColumns, PoseColumns, TrackColumns
from icreckon.replay.mapping.topics import (
    FixTopic,
    HeadingTopic,
    ImuTopic,
    TopicMap,
    TrackTopic,
    TruthTopic,
    VelocityTopic,
    topic_map,
)

# name of the log: robot, least correlation of the turning, largest tilt that is left [m/s²], numbers of
# track speeds, IMU samples and true poses; the mounting of Marmotte and Warthog goes by the truth, which
# is up to 2.4 deg from what gravity alone would say
LOGS = {
    "husky_deflated_part1": ("husky-deflated", 0.95, 0.1, (12919, 12919, 6518)),
    "husky_test1.bag": ("husky", 0.8, 0.1, (3952, 11865, 0)),
    "jackal_test2.bag": ("jackal", 0.5, 0.1, (3060, 3061, 0)),
    "marmotte_part1": ("marmotte", 0.95, 0.45, (13520, 13520, 6790)),
    "warthog_asphalt_2024_9_25_12h8s57": ("warthog", 0.95, 0.45, (3287, 3287, 1644)),
    "warthog_grass_2024_7_29_14h46s15": ("warthog", 0.95, 0.2, (3900, 3900, 1565)),
    "warthog_grass_2024_8_8_15h56s39": ("warthog", 0.95, 0.2, (6053, 6048, 2827)),
    "warthog_grass_2024_8_8_16h11s19": ("warthog", 0.95, 0.2, (3354, 3354, 1549)),
    "wetexplorer_2024-07-05-13-33-58.bag": ("wetexplorer", None, 0.2, (0, 8901, 0)),
    "wetexplorer_2024-07-05-13-36-28.bag": ("wetexplorer", None, 0.2, (0, 6948, 0)),
}


@pytest.mark.parametrize("name", robot_names())
def test_every_robot_file_loads(name: str) -> None:
    robot = load_robot(name)
    assert robot.name == name
    topics = topic_map(robot)
    assert topics.imu is not None


@pytest.mark.parametrize("name", LOGS)
def test_a_sample_log_is_read_and_agrees_with_the_mounting(data_dir: Path, name: str) -> None:
    robot_name, least_correlation, largest_tilt, counts = LOGS[name]
    robot = load_robot(robot_name)
    log = sample(data_dir, name, robot_name)
    # (nearly) every message that the README of the logs speaks of; what is lost is counted
    lost = sum(count for reason, count in log.dropped.items() if reason.startswith("tracks"))
    poses = len(log.truth.poses.stamps) if log.truth else 0
    assert (len(log.tracks.stamps) + lost, len(log.imu.stamps), poses) == counts
    assert (np.diff(log.imu.stamps) > 0).all()
    rotation = robot.imu_rotation
    force = log.imu.linear_acceleration @ rotation.T
    assert np.abs(force.mean(axis=0)[:2]).max() < largest_tilt
    assert force.mean(axis=0)[2] == pytest.approx(9.8, abs=0.1)
    rates = log.imu.angular_velocity
    if robot.imu.gyro_axes == "z":
        assert not rates[:, :2].any()
        vertical = rates[:, 2] / rotation[2, 2]
    else:
        assert rates[:, :2].any()
        vertical = rates @ rotation[2]
    yaw_rates = YawRates(log.imu.stamps, vertical)
    correlation = turning_correlation(log.tracks, yaw_rates)
    if least_correlation is None:
        assert correlation is None
        return
    assert correlation > least_correlation
    # The x axis that the file gives points forward: what is left to turn is nothing.
    assert forward_yaw(log.tracks, yaw_rates, force[:, :2]) == 0.0


def test_the_docs_show_every_key_of_the_topics_and_columns() -> None:
    page = (REPOSITORY / "docs" / "reference" / "robot-file.md").read_text(encoding="utf-8")
    block = page.split("```toml")[1].split("```")[0]
    shown = block[block.index("[log.tracks]") :]
    kinds = (TrackTopic, ImuTopic, FixTopic, HeadingTopic, VelocityTopic, TruthTopic)
    kinds += (ColumnMap, TrackColumns, ImuColumns, PoseColumns)
    tables = ("tracks", "imu", "fixes", "truth", "heading", "velocity", "columns")
    assert TopicMap.__struct_fields__ == tables
    for table in tables:
        assert f"\n[log.{table}]" in block
    for kind in kinds:
        for name in kind.__struct_fields__:
            assert re.search(rf"\b{name}\b", shown), f"{kind.__name__}.{name}"
