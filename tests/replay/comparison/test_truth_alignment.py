"""Lag of a truth: found by its standard error, however little the robot turned."""

from dataclasses import replace

import numpy as np
import pytest

from icreckon import Robot, Scenario, Trajectory, compare, simulate, summarise
from icreckon.estimator.log.series import ImuSeries, PoseSeries, Truth
from icreckon.estimator.robot.robot_file import changed_robot
from icreckon.replay.comparison.fixes import parse_part, with_fixes_within
from icreckon.replay.comparison.truth_alignment import align_truth

SECONDS, RATE = 200.0, 20.0


def weaving(turning: float) -> tuple[Trajectory, PoseSeries]:
    """Reckoned trajectory that weaves by a yaw rate of such a size [rad/s], and its poses."""
    times = np.arange(0.0, SECONDS, 1.0 / RATE)
    rng = np.random.default_rng(3)
    knots = np.arange(0.0, SECONDS + 4.0, 2.0)
    rate = turning * np.interp(times, knots, rng.standard_normal(len(knots)))
    yaw = np.cumsum(rate) / RATE
    steps = np.column_stack([np.cos(yaw), np.sin(yaw)]) / RATE
    poses = np.column_stack([np.cumsum(steps, axis=0), yaw])
    stamps = (times * 1e9).astype(np.int64)
    nothing = np.zeros((len(stamps), 3, 3))
    reckoned = Trajectory(stamps, poses, nothing, np.zeros((len(stamps), 3)), nothing)
    return reckoned, PoseSeries(stamps, poses)


def late(poses: PoseSeries, seconds: float, noise: float) -> Truth:
    """Truth that is late, with noise of its yaw [rad]."""
    moved = poses.poses.copy()
    moved[:, 2] += np.random.default_rng(5).normal(0.0, noise, len(moved))
    return Truth(PoseSeries(poses.stamps + round(seconds * 1e9), moved))


@pytest.mark.parametrize("turning", [0.05, 0.12, 0.6])
def test_the_lag_is_found_however_little_it_turns(turning: float) -> None:
    reckoned, poses = weaving(turning)
    found = align_truth(late(poses, 0.3, 0.003), reckoned)
    assert found.lag == pytest.approx(0.3, abs=max(0.02, 4.0 * found.lag_sigma))
    assert found.lag_sigma < 0.04
    assert found.notes == ()


def test_a_filter_is_half_an_interval_ahead_of_the_gyro() -> None:
    """This is no lag of the truth, though it is removed for the scores."""
    reckoned, poses = weaving(0.3)
    imu = ImuSeries(reckoned.stamps, np.zeros((len(reckoned.stamps), 3)), None)
    truth = late(poses, 0.3, 0.0)
    plain, found = align_truth(truth, reckoned), align_truth(truth, reckoned, imu=imu)
    assert found.lag == pytest.approx(plain.lag - 0.5 / RATE)
    np.testing.assert_array_equal(found.truth.poses.stamps, plain.truth.poses.stamps)


def test_fixes_from_a_truth_without_headings_have_none(robot: Robot) -> None:
    log = simulate(Scenario(duration=20.0, fix_rate=0.0), robot)
    bare = replace(log, truth=replace(log.truth, headings=False))
    for one, headed in ((log, True), (bare, False)):
        fixes = with_fixes_within(one, parse_part("0:50%")).fixes
        assert np.isfinite(fixes.poses[:, 2]).all() == headed
    assert np.isfinite(log.truth.poses.poses).all()


def test_runs_start_at_the_truth_by_their_own_lever_arm(robot: Robot) -> None:
    """A variant without zeta0 has its base_link elsewhere: neither its NEES nor its end is off."""
    log = simulate(Scenario(duration=60.0, trajectory="aggressive", truth="kinematic"), robot)
    log = replace(log, fixes=None, truth=replace(log.truth, twists=None, tracks=None))
    ahead = changed_robot(robot, {"constant_icr": None, "indices.zeta0": 0.5})
    found = summarise(compare(log, ahead, ("gyro", "constant-fixed")), ahead)
    scores, series = found["variants"], found["series"]["variants"]
    arms = [scores[name]["lever_arm_m"] for name in scores]
    assert arms[1][0] - arms[0][0] == pytest.approx(0.55, abs=0.15)
    assert found["truth"]["lever_arm_m"] == scores[found["verdict"]["best"]]["lever_arm_m"]
    for name, one in scores.items():
        assert one["nees_pose_mean"] < 10.0, name
        errors = series[name]["position_error_m"]
        assert errors[0] == pytest.approx(0.0, abs=0.02)
        assert errors[-1] == pytest.approx(one["final_position_error_m"], abs=0.01)
        assert series[name]["x_m"][0] == pytest.approx(found["series"]["truth"]["x_m"][0], abs=0.02)
