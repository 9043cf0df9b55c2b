"""A track that spins free is found, in time and only then, and costs no variant its place."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
import spinning_track as benchmark

from conftest import sample_log
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.batch.feed_arrays import feed_arrays
from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.spinning_tracks import (
    LEFT,
    NEITHER,
    RIGHT,
    SpinRecord,
    assumed_left,
    assumed_right,
    spin_density,
    unexplained,
    watch_spin,
    width_of_bends,
)
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

STEP = 10_000_000


@pytest.fixture(scope="module")
def drive(robot: Robot) -> Log:
    return benchmark.with_free_track(benchmark.drive(robot, 1))


def test_bends_explain_a_share_of_the_turning(robot: Robot) -> None:
    settings = input_settings(robot, Settings())._replace(turning_width=1.2)

    def mismatch(turning: float, rate: float) -> float:
        return unexplained(SpinRecord(right=turning), rate, settings)

    assert mismatch(0.6, 0.5) == 0.0
    assert mismatch(1.4, 0.5) == 0.0
    assert mismatch(2.0, 0.5) == pytest.approx(0.5)
    assert mismatch(-0.3, 0.5) == pytest.approx(-0.54)
    assert mismatch(0.4, 0.0) == pytest.approx(0.4)
    for turning, rate in ((2.0, 0.5), (-0.3, 0.5), (0.4, 0.0)):
        assert mismatch(-turning, -rate) == pytest.approx(-mismatch(turning, rate))


@pytest.mark.parametrize("share", [0.5, 1.0, 2.2])
def test_the_width_is_that_of_the_robots_own_bends(share: float, robot: Robot) -> None:
    """A maker's width that is wrong by two either way is no spin, and is learnt."""
    settings, spin = input_settings(robot, Settings()), SpinRecord()
    width = share * settings.turning_width
    for k in range(2000):
        rate = 0.8 * np.sin(0.01 * k)
        spin.left, spin.right = 0.3 - 0.5 * width * rate, 0.3 + 0.5 * width * rate
        watch_spin(spin, k * STEP, rate, 0.0, 0.0, settings)
        assert not spin.found
    assert width_of_bends(spin, settings) == pytest.approx(width, rel=0.02)
    # What bends explain is narrower now.
    spin.left, spin.right = 0.0, 2.0 * width
    assert unexplained(spin, 1.0, settings) == pytest.approx(0.3 * width, rel=0.1)


def watched(robot: Robot, left: float, right: float, rate: float, seconds: float) -> SpinRecord:
    """Record after a straight drive at 0.4 m/s and then these speeds for some time."""
    settings, spin = input_settings(robot, Settings()), SpinRecord(left=0.4, right=0.4)
    for k in range(50):
        watch_spin(spin, k * STEP, 0.0, 0.0, 0.0, settings)
    spin.left, spin.right = left, right
    for k in range(50, 50 + round(seconds / (STEP * NANOSECOND))):
        watch_spin(spin, k * STEP, rate, left - 0.4, right - 0.4, settings)
    return spin


def test_the_track_that_changed_spins(robot: Robot) -> None:
    settings = input_settings(robot, Settings())
    left, right = watched(robot, 1.2, 0.4, 0.0, 0.3), watched(robot, 0.4, 1.2, 0.0, 0.3)
    assert (left.found, left.side, left.times) == (1, LEFT, 1)
    assert (right.found, right.side) == (1, RIGHT)
    assert assumed_left(left, 1.2, 0.4, settings) == pytest.approx(0.4)
    assert assumed_right(left, 1.2, 0.4, settings) == 0.4
    assert assumed_right(right, 0.4, 1.2, settings) == pytest.approx(0.4)
    assert spin_density(left, LEFT) > 0.1
    assert 0.0 < spin_density(left, RIGHT) < 0.2 * spin_density(left, LEFT)
    assert spin_density(SpinRecord(), LEFT) == 0.0
    # A sensor that fails is the one that changed, too.
    failed = watched(robot, 0.0, 0.4, 0.0, 0.3)
    assert (failed.found, failed.side) == (1, LEFT)


def test_short_or_small_mismatch_is_none(robot: Robot) -> None:
    assert not watched(robot, 1.2, 0.4, 0.0, 0.15).found
    assert not watched(robot, 0.6, 0.4, 0.0, 3.0).found
    turns = -0.8 / input_settings(robot, Settings()).turning_width
    assert not watched(robot, 1.2, 0.4, turns, 3.0).found


def test_a_robot_that_is_pushed_does_not_spin(robot: Robot) -> None:
    pushed = watched(robot, 0.0, 0.0, 1.5, 3.0)
    assert not pushed.found
    assert pushed.side == NEITHER


def test_it_is_over_when_the_track_grips_again(robot: Robot) -> None:
    settings, spin = input_settings(robot, Settings()), watched(robot, 1.2, 0.4, 0.0, 1.0)
    assert spin.found
    spin.left = 0.4
    for k in range(150, 168):
        watch_spin(spin, k * STEP, 0.0, 0.0, 0.0, settings)
    assert spin.found
    for k in range(168, 200):
        watch_spin(spin, k * STEP, 0.0, 0.0, 0.0, settings)
    assert not spin.found
    assert spin.times == 1


@pytest.mark.parametrize("variant", benchmark.VARIANTS)
def test_a_free_track_costs_little(variant: str, robot: Robot, drive: Log) -> None:
    """1.2 m if the track were believed; wanted are less than 0.3 m, within three own sigma."""
    found = benchmark.motion_over_fault(drive, robot, variant)
    assert found.error < 0.3
    assert found.error < 3.0 * found.sigma
    assert found.delay < 0.5


def test_health_names_the_track_while_it_spins(robot: Robot, drive: Log) -> None:
    estimator = PoseEstimator(robot, "constant-online")
    seen = set()
    for measurement in drive.measurements():
        estimator.feed(measurement)
        slip = estimator.health.slip
        if slip.track is not None:
            assert slip.since is not None
            after = (slip.since - drive.start - benchmark.BEGINS) * NANOSECOND
            assert 0.0 <= after < 0.1
            assert slip.mismatch > 0.25
        seen.add((slip.track, slip.times))
    assert seen == {(None, 0), ("left", 1), (None, 1)}


@pytest.mark.parametrize("variant", ["constant-online", "friction-online"])
def test_engines_agree_on_a_free_track(variant: str, robot: Robot, drive: Log) -> None:
    compiled = run(drive, robot, variant)
    plain = run(drive, robot, variant, settings=Settings(engine="plain"))
    (side,) = run_side_by_side(drive, robot, [variant]).values()
    for other in (plain, side):
        assert other.states == pytest.approx(compiled.states, rel=1e-8, abs=1e-9)
        assert other.health.slip == compiled.health.slip
    assert compiled.health.slip.times == 1


def test_arrays_agree_on_a_free_track(robot: Robot, drive: Log) -> None:
    one_by_one, at_once = (PoseEstimator(robot, "constant-online") for _ in range(2))
    for measurement in drive.measurements():
        one_by_one.feed(measurement)
    assert drive.imu is not None
    feed_arrays(at_once, drive.tracks, drive.imu)
    assert at_once.state == pytest.approx(one_by_one.state, abs=1e-9)
    assert at_once.health.slip == one_by_one.health.slip


def test_a_restored_estimator_goes_on_in_the_middle(
    robot: Robot, drive: Log, tmp_path: Path
) -> None:
    estimator, middle = PoseEstimator(robot, "constant-online"), drive.start + 31 * benchmark.SECOND
    measurements = list(drive.measurements())
    for measurement in measurements:
        if measurement.stamp <= middle:
            estimator.feed(measurement)
    assert estimator.health.slip.track == "left"
    estimator.save(tmp_path / "state.json")
    restored = PoseEstimator.restore(tmp_path / "state.json", robot)
    for measurement in measurements:
        if measurement.stamp > middle:
            estimator.feed(measurement)
            restored.feed(measurement)
    assert np.array_equal(restored.state, estimator.state)
    assert restored.health.slip == estimator.health.slip


@pytest.mark.parametrize("trajectory", ["random", "aggressive", "spin", "stop-and-go", "slalom"])
def test_no_false_alarm_in_ordinary_drives(trajectory: str, robot: Robot) -> None:
    log = simulate(Scenario(duration=60.0, seed=3, trajectory=trajectory, fix_rate=0.0), robot)
    (gyro,) = run_side_by_side(log, robot, ["gyro"]).values()
    assert gyro.health.slip.times == 0


@pytest.mark.parametrize("name", sorted(benchmark.LOGS))
def test_no_false_alarm_on_real_logs(name: str, data_dir: Path) -> None:
    robot = load_robot(benchmark.LOGS[name])
    log = read_log(sample_log(data_dir, name), robot)
    settings = msgspec.structs.replace(Settings(), use_accelerometer=False)
    (gyro,) = run_side_by_side(log, robot, ["gyro"], settings=settings).values()
    assert gyro.health.slip.times == 0
