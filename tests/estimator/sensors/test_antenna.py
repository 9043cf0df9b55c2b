"""Fixes of an antenna that is not at base_link: its lever arm is taken out."""

from dataclasses import replace

import numpy as np
import pytest

from icreckon import FixSeries, FixSpec, Log, PositionFix, Robot, Scenario, run, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.sensors.measurement_models import Position
from icreckon.estimator.sensors.predictions import Prediction

ANTENNA = (0.5, -0.2)


@pytest.fixture(scope="module")
def log(robot: Robot) -> Log:
    """A drive with fixes of 2 cm, of base_link."""
    return simulate(Scenario(duration=60.0, seed=6, fix_rate=5.0, fixes=FixSpec(sigma=0.02)), robot)


def of_antenna(log: Log, known: bool = True) -> Log:
    """The log with the fixes that an antenna would have had, and the same noise."""
    fixes, truth = log.fixes, log.truth
    yaw = np.interp(fixes.stamps, truth.poses.stamps, np.unwrap(truth.poses.poses[:, 2]))
    poses = fixes.poses.copy()
    poses[:, :2] += rotate(np.tile(ANTENNA, (len(yaw), 1)), yaw)
    antennas = np.tile(ANTENNA, (len(yaw), 1)) if known else None
    return replace(log, fixes=FixSeries(fixes.stamps, poses, fixes.variances, antennas))


def position_error(log: Log, robot: Robot) -> float:
    """RMSE of the position under fixes, after 20 s [m]."""
    found, true = run(log, robot, "inertia-online").trajectory.pose_series, log.truth.poses
    at = true.stamps > log.start + 20_000_000_000
    apart = [
        np.interp(true.stamps[at], found.stamps, found.poses[:, axis]) - true.poses[at, axis]
        for axis in (0, 1)
    ]
    return float(np.sqrt(np.mean(np.square(apart).sum(axis=0))))


def test_a_known_lever_arm_costs_nothing_and_an_unknown_one_half_a_metre(log, robot):
    without = position_error(log, robot)
    assert without < 0.04
    assert position_error(of_antenna(log), robot) < 1.2 * without
    assert position_error(of_antenna(log, known=False), robot) > 10.0 * without


def test_jacobian_and_noise_of_the_antenna() -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        pose, H = rng.normal(size=3), rng.normal(size=(3, s.SIZE))
        root = rng.normal(size=(3, 3))
        forward, left = rng.normal(size=2)

        def position(pose: np.ndarray, forward: float = forward, left: float = left) -> np.ndarray:
            cos, sin = np.cos(pose[2]), np.sin(pose[2])
            return pose[:2] + np.array([cos * forward - sin * left, sin * forward + cos * left])

        fix = PositionFix(0, 1.0, 2.0, 0.3, forward, left)
        z, found, R = Position().linearise(fix, Prediction(pose, H, root @ root.T))
        by_pose = np.stack(
            [(position(pose + 1e-6 * e) - position(pose - 1e-6 * e)) / 2e-6 for e in np.eye(3)],
            axis=1,
        )
        assert z == pytest.approx([1.0, 2.0] - position(pose))
        assert found == pytest.approx(by_pose @ H, rel=1e-6, abs=1e-8)
        expected = by_pose @ root @ root.T @ by_pose.T + 0.3 * np.eye(2)
        assert pytest.approx(expected, rel=1e-6, abs=1e-8) == R


def test_a_log_keeps_the_antenna(log: Log) -> None:
    moved = of_antenna(log)
    again = Log.from_measurements(moved.measurements())
    np.testing.assert_array_equal(again.fixes.lever_arms, moved.fixes.lever_arms)
    half = moved.between(log.start, (log.start + log.end) // 2)
    assert half.fixes.lever_arms.shape == (len(half.fixes.stamps), 2)
    with pytest.raises(EstimatorError, match="antennas must have shape"):
        FixSeries(np.zeros(2, np.int64), np.zeros((2, 3)), np.ones((2, 2)), np.zeros((1, 2)))
