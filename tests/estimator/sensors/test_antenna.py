"""Fixes of an antenna that is not at base_link: its lever arm is taken out."""

from dataclasses import replace

import numpy as np
import pytest

from icreckon import FixSeries, FixSpec, Log, Robot, Scenario, run, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import rotate, wrap_angle
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.sensors.predictions import Prediction, point_on_robot
from icreckon.simulation.simulate import run_scenario
from icreckon.simulation.truth.terrain import Terrain

ANTENNA = (0.5, -0.2, 0.0)
MAST = 0.7  # height of an antenna [m]


@pytest.fixture(scope="module")
def log(robot: Robot) -> Log:
    """A drive with fixes of 2 cm, of base_link."""
    return simulate(Scenario(duration=60.0, seed=6, fix_rate=5.0, fixes=FixSpec(sigma=0.02)), robot)


def of_antenna(log: Log, known: bool = True) -> Log:
    """The log with the fixes that an antenna would have had, and the same noise."""
    fixes, truth = log.fixes, log.truth
    yaw = np.interp(fixes.stamps, truth.poses.stamps, np.unwrap(truth.poses.poses[:, 2]))
    poses = fixes.poses.copy()
    poses[:, :2] += rotate(np.tile(ANTENNA[:2], (len(yaw), 1)), yaw)
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


@pytest.mark.parametrize("off", [-0.9, 0.9])
def test_a_lever_arm_at_a_wrong_heading_makes_no_yaw_sure(
    off: float, log: Log, robot: Robot
) -> None:
    short = of_antenna(log.between(log.start, log.start + 15_000_000_000))
    start = {"start": (1.0, -1.0, off), "start_sigma": (2.0, 2.0, 1.0)}
    found, true = run(short, robot, "inertia-online", **start), log.truth.poses
    yaw = np.interp(found.stamps, true.stamps, np.unwrap(true.poses[:, 2]))
    apart = np.abs(wrap_angle(found.states[:, s.YAW] - yaw))
    assert (apart < 3.5 * found.state_sigmas[:, s.YAW]).all()
    assert apart[found.stamps > log.start + 10_000_000_000].max() < 0.1
    assert sum(found.health.rejections().values()) == 0


def test_an_antenna_on_a_mast_leans_over_on_a_slope(robot: Robot) -> None:
    scenario = Scenario(
        duration=60.0,
        seed=6,
        trajectory="random",
        truth="friction",
        fix_rate=5.0,
        fixes=FixSpec(sigma=0.015),
        terrain=Terrain(rolling_deg=7.0),
    )
    simulated = run_scenario(scenario, robot)
    log, fixes = simulated.log, simulated.log.fixes
    roll, pitch, yaw = simulated.motion.attitudes_at((fixes.stamps - log.start) * 1e-9).T
    lean = MAST * np.column_stack([np.sin(pitch) * np.cos(roll), -np.sin(roll)])
    poses = fixes.poses.copy()
    poses[:, :2] += rotate(lean, yaw)
    errors = [
        position_error(replace(log, fixes=replace(fixes, poses=places, antennas=antennas)), robot)
        for places, antennas in (
            (fixes.poses, None),
            (poses, np.tile((0.0, 0.0, MAST), (len(yaw), 1))),
            (poses, None),
        )
    ]
    of_base, known, unknown = errors
    assert known < 1.3 * of_base
    assert unknown > 3.0 * known


def test_jacobian_and_noise_of_the_antenna() -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        pose, H, gravity = rng.normal(size=3), rng.normal(size=(3, s.SIZE)), rng.normal(size=2)
        root, place = rng.normal(size=(3, 3)), rng.normal(size=3)

        def position(values: np.ndarray, place: np.ndarray = place) -> np.ndarray:
            cos, sin = np.cos(values[2]), np.sin(values[2])
            forward, left = place[:2] + place[2] * values[3:] / GRAVITY
            return values[:2] + np.array([cos * forward - sin * left, sin * forward + cos * left])

        found = point_on_robot(Prediction(pose, H, root @ root.T), gravity, tuple(place))
        at = np.append(pose, gravity)
        steps = 1e-6 * np.eye(5)
        by = np.stack([(position(at + e) - position(at - e)) / 2e-6 for e in steps], axis=1)
        by_state = by[:, :3] @ H
        by_state[:, s.GRAVITY] += by[:, 3:]
        assert found.values[:2] == pytest.approx(position(at))
        assert found.H[:2] == pytest.approx(by_state, rel=1e-6, abs=1e-8)
        expected = by[:, :3] @ root @ root.T @ by[:, :3].T
        assert found.R[:2, :2] == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_a_log_keeps_the_antenna(log: Log) -> None:
    moved = of_antenna(log)
    again = Log.from_measurements(moved.measurements())
    np.testing.assert_array_equal(again.fixes.lever_arms, moved.fixes.lever_arms)
    half = moved.between(log.start, (log.start + log.end) // 2)
    assert half.fixes.lever_arms.shape == (len(half.fixes.stamps), 3)
    with pytest.raises(EstimatorError, match="antennas must have shape"):
        FixSeries(np.zeros(2, np.int64), np.zeros((2, 3)), np.ones((2, 2)), np.zeros((2, 2)))
