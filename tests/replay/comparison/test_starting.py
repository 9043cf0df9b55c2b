"""Where a run starts whose log has fixes but no truth."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from icreckon import FixSpec, HeadingFix, Log, Scenario, compare, simulate
from icreckon.estimator.base.frames import rotate, wrap_angle
from icreckon.estimator.log.series import FixSeries, ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.base.start import ANY_HEADING, EXACT_ORIGIN
from icreckon.replay.comparison.initial_pose import start_from_fixes

VARIANT = "constant-online"


@pytest.fixture(scope="module")
def log(robot: Robot) -> Log:
    """A drive with position fixes, in `odom`, and what was true."""
    fixes = FixSpec(sigma=0.1)
    return simulate(Scenario(duration=60.0, seed=4, trajectory="slalom", fixes=fixes), robot)


def moved(log: Log, x: float, y: float, yaw: float) -> Log:
    """The log with its fixes in another frame, and without its truth."""
    c, s = np.cos(yaw), np.sin(yaw)
    poses = log.fixes.poses.copy()
    poses[:, :2] = poses[:, :2] @ [[c, s], [-s, c]] + [x, y]
    return replace(log, fixes=FixSeries(log.fixes.stamps, poses, log.fixes.variances), truth=None)


def start(log: Log, robot: Robot):
    return start_from_fixes(log, robot, VARIANT, None)


def test_fixes_in_odom_start_at_the_origin(log: Log, robot: Robot) -> None:
    assert start(replace(log, truth=None), robot) == EXACT_ORIGIN
    assert start(replace(log, fixes=None), robot) == EXACT_ORIGIN


def test_a_start_at_fixes_that_wander_counts_for_little(log: Log, robot: Robot) -> None:
    """The filter uses the same fixes once more."""
    fixes = {"topic": "/fix", "wander_sigma": 1.2, "wander_time": 60.0}
    wandering = structs.replace(robot, log=robot.log | {"fixes": fixes})
    assert start(moved(log, 500.0, -80.0, 2.0), wandering).sigma[0] > 3.0 * 1.2


@pytest.mark.parametrize(
    ("place", "yaw"), [((0.0, 0.0), 2.0), ((500.0, -80.0), 0.0), ((500.0, -80.0), -3.0)]
)
def test_fixes_in_another_frame(log, robot, place, yaw):
    begin = log.truth.poses.poses[0]
    found = start(moved(log, *place, yaw), robot)
    expected = np.array([*place, yaw]) + np.array([0.0, 0.0, begin[2]])
    off = np.array(found.pose) - expected
    off[2] = wrap_angle(off[2])
    assert (np.abs(off) < 3.0 * np.array(found.sigma)).all()
    assert found.sigma[2] < 0.3


def test_fixes_of_an_antenna_in_another_frame(log: Log, robot: Robot) -> None:
    """The start is that of base_link, not of the antenna."""
    antenna = np.array([1.5, 0.5])
    truth = log.truth.poses
    yaw = np.interp(log.fixes.stamps, truth.stamps, np.unwrap(truth.poses[:, 2]))
    poses = log.fixes.poses.copy()
    poses[:, :2] += rotate(np.tile(antenna, (len(yaw), 1)), yaw)
    elsewhere = moved(replace(log, fixes=replace(log.fixes, poses=poses)), 20.0, -8.0, 2.0)
    known = np.tile([*antenna, 0.6], (len(yaw), 1))
    found = start(replace(elsewhere, fixes=replace(elsewhere.fixes, antennas=known)), robot)
    off = np.array(found.pose) - [20.0, -8.0, 2.0 + log.truth.poses.poses[0, 2]]
    assert (np.abs(off) < 3.0 * np.array(found.sigma)).all()
    assert np.hypot(*off[:2]) < 0.5
    ignored = np.array(start(elsewhere, robot).pose) - [20.0, -8.0, 2.0]
    assert np.hypot(*ignored[:2]) > 1.0


def test_a_heading_tells_the_start_of_a_robot_that_stands(log: Log, robot: Robot) -> None:
    elsewhere = moved(log, 100.0, 50.0, 2.0)
    fixes = elsewhere.fixes
    first = FixSeries(fixes.stamps[:1], fixes.poses[:1], fixes.variances[:1])
    one = replace(elsewhere, fixes=first)
    assert start(one, robot).sigma[2] == ANY_HEADING
    heading = HeadingFix(log.start, 2.02, 0.01)
    found = start(replace(one, others=(heading,)), robot)
    assert found.pose[2] == pytest.approx(2.02)
    assert found.sigma[2] == pytest.approx(0.1)


def test_a_robot_that_stands_for_long_at_first(log: Log, robot: Robot) -> None:
    wait = 300 * 10**9
    elsewhere = moved(log, 0.0, 0.0, 2.0)
    tracks, imu, fixes = elsewhere.tracks, elsewhere.imu, elsewhere.fixes
    before = np.arange(0, wait, 10**8) + log.start
    still = np.zeros((len(before), 3))
    # Standing still, its gyro shows the bias that it has later.
    turning = np.interp(imu.stamps, log.truth.twists.stamps, log.truth.twists.twists[:, 2])
    bias = float((imu.angular_velocity[:, 2] - turning).mean())
    waited = replace(
        elsewhere,
        tracks=TrackSpeedSeries(
            np.r_[before, tracks.stamps + wait], np.r_[still[:, :2], tracks.speeds]
        ),
        imu=ImuSeries(
            np.r_[before, imu.stamps + wait],
            np.r_[still + np.array([0.0, 0.0, bias]), imu.angular_velocity],
            np.r_[still + np.array([0.0, 0.0, 9.81]), imu.linear_acceleration],
        ),
        fixes=FixSeries(
            np.r_[before[::10], fixes.stamps + wait],
            np.r_[still[::10] + fixes.poses[0], fixes.poses],
            np.r_[still[::10, :2] + fixes.variances[0], fixes.variances],
        ),
    )
    found = start(waited, robot)
    assert found.pose[2] == pytest.approx(2.0 + log.truth.poses.poses[0, 2], abs=0.15)


def test_a_comparison_starts_there(log: Log, robot: Robot) -> None:
    elsewhere = moved(log, 500.0, -80.0, 2.0)
    comparison = compare(elsewhere, robot, [VARIANT])
    found = comparison.runs[VARIANT].trajectory
    at = np.searchsorted(found.stamps, elsewhere.fixes.stamps[2:])
    at = np.minimum(at, len(found.stamps) - 1)
    off = np.hypot(*(found.poses[at, :2] - elsewhere.fixes.poses[2:, :2]).T)
    assert off.max() < 1.0
    assert not comparison.runs[VARIANT].health.sensors["position"].rejected
