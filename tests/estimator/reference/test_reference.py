"""The filter that runs on robots is the textbook's where nothing watches for faults acts."""

from dataclasses import replace
from pathlib import Path

import pytest

from conftest import sample, thorough
from icreckon import EstimatorError, FixSpec, Log, PoseEstimator, Scenario, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.log.measurements import HeadingFix, PositionFix
from icreckon.estimator.reference.filter import ReferenceFilter
from icreckon.estimator.robot.robot_file import Robot, load_robot
from same_runs import apart

ALPHA = load_robot("auriga-alpha")
START = {"start": (0.05, -0.02, 0.04), "start_sigma": (0.1, 0.1, 0.1)}


def both(log: Log, variant: str, robot: Robot = ALPHA) -> PoseEstimator:
    """Feed both filters; the product is within 1e-9 of a standard deviation of the textbook."""
    product, textbook = (one(robot, variant, **START) for one in (PoseEstimator, ReferenceFilter))
    for k, m in enumerate(log.measurements()):
        product.feed(m)
        textbook.take(m)
        if k % 50 == 0:
            assert apart(product, textbook.ekf.x, textbook.ekf.P) < 1e-9
    return product


VARIANTS = [
    "constant-online",
    "inertia-online",
    "gyro",
    *map(thorough, ("inertia-fixed", "full-linear")),
]


@pytest.mark.parametrize("variant", VARIANTS)
def test_simulated_drive_with_fixes(variant: str) -> None:
    """Fixes at IMU samples and between them; their slip factor stays 1, which the textbook lacks."""
    scenario = Scenario(
        duration=8.0,
        seed=12,
        truth="kinematic",
        truth_spread=0.0,
        fix_rate=0.7,
        fixes=FixSpec(sigma=0.05),
    )
    health = both(simulate(scenario, ALPHA), variant).health
    assert health.slip_factor == 1.0
    assert health.sensors["position"].used > 5
    assert sum(health.rejections().values()) == 0


def test_standstill_and_turns() -> None:
    scenario = Scenario(duration=20.0, seed=9, trajectory="aggressive", fix_rate=0.0)
    assert both(simulate(scenario, ALPHA), "inertia-online").health.sensors["gyro"].used > 900


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_real_drive(data_dir: Path, variant: str) -> None:
    """Half a minute of a Warthog on grass, without a found fault."""
    robot = load_robot("warthog")
    log = sample(data_dir, "warthog_grass_2024_8_8_16h11s19", "warthog")
    begin = log.start + 40 * 10**9
    driving = replace(log.between(begin, begin + 30 * 10**9), fixes=None)
    health = both(driving, variant, robot).health
    assert health.sensors["gyro"].used > 400
    assert health.times == {}


def test_textbook_takes_no_outliers_and_no_other_sensors() -> None:
    textbook = ReferenceFilter(ALPHA, "inertia-online")
    log = simulate(Scenario(duration=1.0, seed=1, fix_rate=0.0), ALPHA)
    for m in log.measurements():
        textbook.take(m)
    x = textbook.ekf.x[s.POSE].copy()
    with pytest.raises(EstimatorError, match="is an outlier"):
        textbook.take(PositionFix(log.end, 100.0, 0.0, 1e-4))
    with pytest.raises(EstimatorError, match="takes no HeadingFix"):
        textbook.take(HeadingFix(log.end, 0.0, 1.0))
    assert (textbook.ekf.x[s.POSE] == x).all()
