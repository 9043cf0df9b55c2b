"""A track that spins free is found, in time and only then."""

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
from icreckon.estimator.sensors.spinning_tracks import (
    LEFT,
    NEITHER,
    RIGHT,
    SpinRecord,
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


WIDTH, FASTEST = 1.2, 1.0


def after_bends(width: float = WIDTH, seconds: float = 20.0) -> SpinRecord:
    """Record after bends with tracks of a width, and then straight on at 0.4 m/s."""
    spin, k = SpinRecord(), 0
    for k in range(round(seconds / (STEP * NANOSECOND))):
        rate = 0.8 * np.sin(0.01 * k)
        spin.left, spin.right = 0.4 - 0.5 * width * rate, 0.4 + 0.5 * width * rate
        watch_spin(spin, k * STEP, rate, 0.0, 0.0, FASTEST)
        assert not spin.found
    spin.left = spin.right = 0.4
    watch_spin(spin, (k + 1) * STEP, 0.0, 0.0, 0.0, FASTEST)
    return spin


def test_bends_explain_a_share_of_the_turning() -> None:
    spin = after_bends()

    def mismatch(turning: float, rate: float) -> float:
        spin.left, spin.right = 0.0, turning
        return unexplained(spin, rate)

    assert mismatch(0.6, 0.5) == 0.0
    assert mismatch(1.0, 0.5) == 0.0
    assert mismatch(2.0, 0.5) == pytest.approx(2.0 - 1.7 * 0.6, abs=0.01)
    assert mismatch(-0.3, 0.5) == pytest.approx(-0.3 - 0.36, abs=0.01)
    assert mismatch(0.4, 0.0) == pytest.approx(0.4)
    for turning, rate in ((2.0, 0.5), (-0.3, 0.5), (0.4, 0.0)):
        assert mismatch(-turning, -rate) == pytest.approx(-mismatch(turning, rate))


@pytest.mark.parametrize("width", [0.3, 1.0, 3.0])
def test_the_width_is_that_of_the_robots_own_bends(width: float) -> None:
    assert width_of_bends(after_bends(width)) == pytest.approx(width, rel=0.01)


def test_nothing_is_decided_before_bends_or_with_swapped_sides() -> None:
    assert width_of_bends(after_bends(seconds=3.0)) == 0.0
    swapped = after_bends(-1.0)
    assert width_of_bends(swapped) == 0.0
    swapped.left = 2.0
    assert unexplained(swapped, 0.0) == 0.0


def watched(left: float, right: float, rate: float, seconds: float) -> SpinRecord:
    """Record after bends, a straight drive at 0.4 m/s, and then these speeds for some time."""
    spin = after_bends()
    begin = spin.stamp // STEP + 1
    spin.left, spin.right = left, right
    for k in range(begin, begin + round(seconds / (STEP * NANOSECOND))):
        watch_spin(spin, k * STEP, rate, left - 0.4, right - 0.4, FASTEST)
    return spin


def test_the_track_that_changed_spins() -> None:
    left, right = watched(1.2, 0.4, 0.0, 0.3), watched(0.4, 1.2, 0.0, 0.3)
    assert (left.found, left.side, left.times) == (1, LEFT, 1)
    assert (right.found, right.side) == (1, RIGHT)
    # A sensor that fails is the one that changed, too.
    failed = watched(0.0, 0.4, 0.0, 0.3)
    assert (failed.found, failed.side) == (1, LEFT)


def test_short_or_small_mismatch_is_none() -> None:
    assert not watched(1.2, 0.4, 0.0, 0.15).found
    assert not watched(0.6, 0.4, 0.0, 3.0).found
    assert not watched(1.2, 0.4, -0.8 / WIDTH, 3.0).found


def test_a_robot_that_is_pushed_does_not_spin() -> None:
    pushed = watched(0.0, 0.0, 1.5, 3.0)
    assert not pushed.found
    assert pushed.side == NEITHER


def test_it_is_over_when_the_track_grips_again() -> None:
    spin = watched(1.2, 0.4, 0.0, 1.0)
    assert spin.found
    begin = spin.stamp // STEP + 1
    spin.left = 0.4
    for k in range(begin, begin + 18):
        watch_spin(spin, k * STEP, 0.0, 0.0, 0.0, FASTEST)
    assert spin.found
    for k in range(begin + 18, begin + 40):
        watch_spin(spin, k * STEP, 0.0, 0.0, 0.0, FASTEST)
    assert not spin.found
    assert spin.times == 1


def test_a_free_track_is_noticed_in_time(robot: Robot, drive: Log) -> None:
    assert benchmark.motion_over_fault(drive, robot, "constant-online").delay < 0.5


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
