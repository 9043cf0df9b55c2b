"""A fair rival: wheels and gyro with the bias that they had no chance to learn."""

import re
from dataclasses import replace

import numpy as np
import pytest

from icreckon import Comparison, Log, Scenario, compare, compare_many, summarise
from icreckon.estimator.robot.robot_file import Robot, changed_robot, load_robot
from icreckon.report.replay.page_text import headline
from icreckon.simulation.simulate import run_scenario

ROBOT = load_robot("auriga-alpha")
BIAS = 0.015
VARIANTS = ["gyro", "constant-online"]


@pytest.fixture(scope="module")
def drive() -> tuple[Log, float]:
    """Log that begins at standstill, and the bias of its gyro [rad/s]."""
    scenario = Scenario(duration=104.0, seed=3, fix_rate=0.0, truth="kinematic")
    made = run_scenario(scenario, ROBOT)
    imu = made.log.imu
    read = imu.angular_velocity + np.array([0.0, 0.0, BIAS])
    bias = BIAS + float(np.mean(made.gyro_bias[:, 2]))
    return replace(made.log, imu=replace(imu, angular_velocity=read)), bias


@pytest.fixture(scope="module")
def moving(drive: tuple[Log, float]) -> Log:
    """The log without the standstill at its start."""
    return drive[0].part(4.0, drive[0].duration)


@pytest.fixture(scope="module")
def found(moving: Log) -> Comparison:
    return compare(moving, ROBOT, VARIANTS)


def drift_of(found: Comparison, robot: Robot = ROBOT) -> float:
    percent = summarise(found, robot)["variants"]["gyro"]["drift_percent_30s_mean"]
    return float(percent)


def test_gyro_runs_with_the_bias_that_it_had_no_chance_to_learn(found, moving, drive):
    assert list(found.runs) == VARIANTS
    assert drift_of(found) < 0.5 * drift_of(compare(moving, ROBOT, "gyro"))
    bias = found.known_bias
    assert bias.used == pytest.approx(ROBOT.imu.gyro_bias, abs=1e-4)
    assert bias.shown == pytest.approx(drive[1], abs=4.0 * bias.sigma)
    assert 0.0 < bias.sigma < 0.05 * BIAS
    # The headline names the bias to set.
    written = re.search(r"Set gyro_bias = ([\d.]+) in", headline(summarise(found, ROBOT)))
    assert float(written[1]) == pytest.approx(bias.shown, abs=bias.sigma)


def test_the_bias_is_that_after_the_scale_of_the_file(moving: Log, found: Comparison) -> None:
    robot = changed_robot(ROBOT, {"imu.gyro_scale": 1.25})
    imu = replace(moving.imu, angular_velocity=1.25 * moving.imu.angular_velocity)
    scaled = compare(replace(moving, imu=imu), robot, VARIANTS)
    assert scaled.known_bias.shown == pytest.approx(found.known_bias.shown, rel=1e-6)


def test_a_gyro_in_degrees_is_no_matter_of_a_bias(moving: Log) -> None:
    """A bias that no robot file may have ends no comparison."""
    off = moving.imu.angular_velocity + np.array([0.0, 0.0, 1.5])
    found = compare(replace(moving, imu=replace(moving.imu, angular_velocity=off)), ROBOT, VARIANTS)
    assert found.known_bias is None
    assert "gyro" in found.runs


def test_a_gyro_that_stood_still_has_learnt_its_bias(drive: tuple[Log, float]) -> None:
    found = compare(drive[0], ROBOT, VARIANTS)
    assert found.known_bias is None
    assert list(found.runs) == VARIANTS
    results = summarise(found, ROBOT)
    assert results["gyro_bias"] is None
    assert "gyro bias" not in headline(results)


def test_several_logs_are_compared_with_a_gyro_whose_bias_is_known_in_each(drive, moving):
    found = compare_many([moving, replace(drive[0], name="from rest")], ROBOT, VARIANTS)
    assert found["baseline_variant"] == "gyro"
    # The log that begins at rest shows gyro its bias.
    assert [one["label"] for one in found["logs"] if one["gyro_bias"]] == [moving.name]
    pooled = found["pooled"][ROBOT.name]["variants"]
    assert pooled["gyro"]["logs"] == 2
    assert pooled["constant-online"]["drift_ratio_30s_95"] is not None
    alone = compare_many([moving, replace(drive[0], name="from rest")], ROBOT, ["gyro"])
    raw = alone["pooled"][ROBOT.name]["variants"]["gyro"]["drift_percent_30s_mean"]
    assert pooled["gyro"]["drift_percent_30s_mean"] < 0.5 * raw
