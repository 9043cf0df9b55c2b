"""A fair rival: wheels and gyro with the bias that they had no chance to learn."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import sample_log
from icreckon import Comparison, Log, Scenario, compare, compare_many, read_log
from icreckon.estimator.robot.robot_file import changed_robot, load_robot
from icreckon.replay.comparison.bootstrap import paired_drift
from icreckon.replay.comparison.drift_table import horizon_labels, verdict
from icreckon.replay.comparison.known_bias import KNOWN_BIAS
from icreckon.replay.comparison.results import comparison_drifts, summarise
from icreckon.report.replay.page_text import headline, verdict_text
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


def test_gyro_runs_with_the_bias_that_it_had_no_chance_to_learn(found, drive):
    assert list(found.runs) == ["gyro", KNOWN_BIAS, "constant-online"]
    bias = found.known_bias
    assert bias.used == pytest.approx(ROBOT.imu.gyro_bias, abs=1e-4)
    assert bias.shown == pytest.approx(drive[1], abs=4.0 * bias.sigma)
    assert 0.0 < bias.sigma < 0.05 * BIAS


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


def test_what_is_taken_from_the_truth_is_never_called_the_best(found: Comparison) -> None:
    drifts = comparison_drifts(found)["30s"]
    known = drifts[KNOWN_BIAS]
    exact = replace(known, position_errors=np.full_like(known.position_errors, 1e-6))
    paired = {label: paired_drift(drifts | {KNOWN_BIAS: exact}) for label in horizon_labels()}
    verdict_ = verdict(paired, KNOWN_BIAS)
    assert verdict_["best"] != KNOWN_BIAS
    assert verdict_["ratio"] > 1.0
    said = verdict_text(verdict_)
    assert said.startswith(
        f"Nothing drifts less than {KNOWN_BIAS}, whose gyro bias is from the truth."
    )
    assert f"{verdict_['best']} drifts least" in said


def test_the_headline_compares_with_that(found: Comparison) -> None:
    results = summarise(found, ROBOT)
    assert results["baseline_variant"] == results["verdict"]["baseline"] == KNOWN_BIAS
    drifts = {name: one["drift_percent_30s_mean"] for name, one in results["variants"].items()}
    assert drifts[KNOWN_BIAS] < 0.5 * drifts["gyro"]
    said = headline(results)
    written = re.search(r"Set gyro_bias = ([\d.]+) in \[imu\]", said)
    assert float(written[1]) == pytest.approx(found.known_bias.shown, abs=found.known_bias.sigma)
    assert KNOWN_BIAS in said.partition("Where neither")[0]


def test_a_gyro_that_stood_still_has_learnt_its_bias(drive: tuple[Log, float]) -> None:
    found = compare(drive[0], ROBOT, VARIANTS)
    assert found.known_bias is None
    assert list(found.runs) == VARIANTS
    results = summarise(found, ROBOT)
    assert results["gyro_bias"] is None
    assert "gyro bias" not in headline(results)


def test_the_husky_wins_nothing_by_a_bias(data_dir: Path) -> None:
    """Its log has no standstill; with the bias wheels and gyro are as good as the best."""
    robot = changed_robot(load_robot("husky-deflated"), {"imu.gyro_bias": 0.0})
    log = read_log(sample_log(data_dir, "husky_deflated_part1"), robot).part(0.0, 200.0)
    found = compare(log, robot, VARIANTS)
    # The README beside the logs.
    assert found.known_bias.shown == pytest.approx(-0.0156, abs=0.002)
    results = summarise(found, robot)
    drifts = {name: one["drift_percent_30s_mean"] for name, one in results["variants"].items()}
    assert drifts["gyro"] > 2.0 * drifts[KNOWN_BIAS]
    assert results["variants"]["constant-online"]["drift_ratio_30s"] > 0.8


def test_several_logs_are_compared_with_a_gyro_whose_bias_is_known_in_each(drive, moving):
    found = compare_many([moving, replace(drive[0], name="from rest")], ROBOT, VARIANTS)
    assert found["baseline_variant"] == KNOWN_BIAS
    pooled = found["pooled"][ROBOT.name]["variants"]
    # The log that begins at rest shows gyro its bias.
    assert [one["label"] for one in found["logs"] if KNOWN_BIAS in one["variants"]] == [moving.name]
    assert pooled[KNOWN_BIAS]["logs"] == pooled["gyro"]["logs"] == 2
    fair, raw = (pooled[name]["drift_percent_30s_mean"] for name in (KNOWN_BIAS, "gyro"))
    assert fair < 0.5 * raw
    assert pooled["constant-online"]["drift_ratio_30s_95"] is not None
