"""Track speeds that are unknown: what the filter reports while they are stale or stuck."""

from __future__ import annotations

import numpy as np
import pytest

from icreckon.estimator.filter.process_noise import share_of_sigma, twist_covariance
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import Measurement, TrackSpeeds
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

SECOND = 1_000_000_000
ROBOT = load_robot("auriga-alpha")
FASTEST = ROBOT.vehicle.max_track_speed
# Track speeds are unknown from here to the end [s].
FROM, UNTIL = 8.0, 14.0
VARIANTS = ("constant-online", "inertia-online")


@pytest.fixture(scope="module")
def log() -> Log:
    scenario = Scenario(duration=UNTIL, seed=3, trajectory="slalom", fix_rate=0.0)
    return simulate(scenario, ROBOT)


def stale(log: Log) -> list[Measurement]:
    """Measurements of a driver that stops sending."""
    since = log.start + round(FROM * SECOND)
    return [m for m in log.measurements() if m.stamp < since or not isinstance(m, TrackSpeeds)]


def stuck(log: Log) -> list[Measurement]:
    """Measurements of a left track whose sensor repeats itself."""
    since, found, last = log.start + round(FROM * SECOND), [], None
    for m in log.measurements():
        if isinstance(m, TrackSpeeds):
            last = m if last is None or m.stamp < since else last
            found.append(TrackSpeeds(m.stamp, last.left, m.right))
        else:
            found.append(m)
    return found


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_stale_speed_dies_away_and_no_accelerometer_moves_it(log: Log, variant: str) -> None:
    """A yaw rate times a speed is a force; an unknown speed may not follow from it."""
    estimator = PoseEstimator(ROBOT, variant)
    found = []
    for m in stale(log):
        estimator.feed(m)
        if m.stamp > log.start + round(FROM * SECOND):
            sigma = np.sqrt(np.diagonal(estimator.twist_covariance))
            found.append((estimator.twist[0], *sigma[:2]))
    speeds, *sigmas = np.abs(found).T
    assert speeds.max() < 1.1 * speeds[0]
    assert speeds[-1] < 0.25 * speeds[0]
    assert np.max(sigmas) < 1.001 * FASTEST
    assert sigmas[0][-1] > 0.9 * FASTEST


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_stuck_speed_is_not_moved_by_the_accelerometer(log: Log, variant: str) -> None:
    estimator = PoseEstimator(ROBOT, variant)
    for m in stuck(log):
        estimator.feed(m)
        assert abs(estimator.twist[0]) < 1.2 * FASTEST
        assert np.sqrt(estimator.twist_covariance[0, 0]) < 1.001 * FASTEST
    assert estimator.health.times["stuck"] == 1


def test_a_covariance_that_is_bounded_keeps_its_correlations() -> None:
    rng = np.random.default_rng(1)
    jacobian = rng.standard_normal((3, 5))
    P = np.diag([4.0, 9.0, 1.0, 0.1, 0.2])
    free = jacobian @ P @ jacobian.T
    fastest = 0.5 * float(np.sqrt(free[0, 0]))
    bounded = twist_covariance(jacobian, P, fastest)

    def correlation(covariance: np.ndarray) -> np.ndarray:
        sigma = np.sqrt(np.diagonal(covariance))
        return covariance / np.outer(sigma, sigma)

    assert bounded[0, 0] == pytest.approx(fastest**2)
    assert bounded[2, 2] == free[2, 2]
    np.testing.assert_allclose(correlation(bounded), correlation(free))
    np.testing.assert_array_equal(twist_covariance(jacobian, P, 1e3), free)


@pytest.mark.parametrize("variance", [0.0, 0.24, 0.25, 0.26, 1e6])
def test_the_share_of_a_sigma(variance: float) -> None:
    assert share_of_sigma(variance, 0.5) * np.sqrt(variance) == pytest.approx(
        min(0.5, np.sqrt(variance))
    )
