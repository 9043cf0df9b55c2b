"""A track that spins free is found, in time and only then, and costs no variant its place."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from _logs import logs_without
from hypothesis import given
from hypothesis import strategies as st
from jackal_spins import shares_of_force

import faulty_drives
from conftest import sample_log
from faulty_drives import (
    BEGINS,
    SECOND,
    VARIANTS,
    motion_over,
    upper_track_slides,
    with_free_track,
)
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.batch.feed_arrays import feed_arrays
from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.faults.spinning_tracks import (
    LEFT,
    RIGHT,
    UNKNOWN,
    SpinRecord,
    assumed_speeds,
    forget_mismatch,
    is_found,
    is_likely,
    side_that_changed,
    side_with_less_load,
    spin_density,
    spread_of_bends,
    unexplained,
    watch_spin,
    width_of_bends,
)
from icreckon.estimator.faults.stuck_tracks import may_stick
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.held_tracks import TrackRecord, take_motion, take_tracks
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

STEP = 10_000_000


@pytest.fixture(scope="module")
def drive(robot: Robot) -> Log:
    return with_free_track(faulty_drives.drive(robot, 1, 36.0))


WIDTH, FASTEST = 1.2, 1.0
LOGS = logs_without("jackal", "wetexplorer")


def after_bends(width: float = WIDTH, seconds: float = 20.0, spread: float = 0.2) -> SpinRecord:
    """Record after bends with tracks of a width, more or less, and then straight on at 0.4 m/s."""
    spin, k = SpinRecord(), 0
    for k in range(round(seconds / (STEP * NANOSECOND))):
        rate = 0.8 * np.sin(0.01 * k)
        turning = width * (1.0 + spread * (-1) ** k) * rate
        spin.left, spin.right = 0.4 - 0.5 * turning, 0.4 + 0.5 * turning
        watch_spin(spin, k * STEP, rate, math.nan, 0.0, 0.0, FASTEST)
        assert not is_found(spin)
    spin.left = spin.right = 0.4
    watch_spin(spin, (k + 1) * STEP, 0.0, math.nan, 0.0, 0.0, FASTEST)
    return spin


def test_bends_explain_a_share_of_the_turning() -> None:
    spin = after_bends()

    def mismatch(turning: float, rate: float) -> float:
        spin.rate = rate
        return unexplained(spin, 0.0, turning)

    assert mismatch(0.6, 0.5) == 0.0
    assert mismatch(1.0, 0.5) == 0.0
    assert mismatch(2.0, 0.5) == pytest.approx(2.0 - 1.7 * 0.6, abs=0.01)
    assert mismatch(-0.3, 0.5) == pytest.approx(-0.3 - 0.36, abs=0.01)
    assert mismatch(0.4, 0.0) == pytest.approx(0.4)
    for turning, rate in ((2.0, 0.5), (-0.3, 0.5), (0.4, 0.0)):
        assert mismatch(-turning, -rate) == pytest.approx(-mismatch(turning, rate))


@pytest.mark.parametrize(("spread", "above"), [(0.0, 0.15), (0.06, 0.3), (0.3, 0.7)])
def test_a_robot_whose_bends_are_alike_slips_less(spread: float, above: float) -> None:
    spin = after_bends(spread=spread)
    assert spread_of_bends(spin) == pytest.approx(spread, abs=0.005)
    spin.rate = 0.5
    assert unexplained(spin, 0.0, 2.0) == pytest.approx(2.0 - (1.0 + above) * 0.6, abs=0.02)


@pytest.mark.parametrize("width", [0.3, 1.0, 3.0])
def test_the_width_is_that_of_the_robots_own_bends(width: float) -> None:
    assert width_of_bends(after_bends(width)) == pytest.approx(width, rel=0.01)


def test_nothing_is_decided_before_bends_or_with_swapped_sides() -> None:
    assert width_of_bends(after_bends(seconds=3.0)) == 0.0
    swapped = after_bends(-1.0)
    assert width_of_bends(swapped) == 0.0
    assert unexplained(swapped, 2.0, 0.0) == 0.0


def watched(
    left: float,
    right: float,
    rate: float,
    seconds: float,
    *,
    force: float = math.nan,
    was: tuple[float, float] = (0.4, 0.4),
) -> SpinRecord:
    """Record after bends, a straight drive at 0.4 m/s, and then these speeds for some time."""
    spin = after_bends()
    begin = spin.stamp // STEP + 1
    spin.left, spin.right, spin.force = left, right, 0.0 if math.isnan(force) else force
    for k in range(begin, begin + round(seconds / (STEP * NANOSECOND))):
        watch_spin(spin, k * STEP, rate, force, left - was[0], right - was[1], FASTEST)
    return spin


def test_the_track_that_changed_spins() -> None:
    left, right = watched(1.2, 0.4, 0.0, 0.3), watched(0.4, 1.2, 0.0, 0.3)
    assert (is_found(left), left.side, left.times) == (True, LEFT, 1)
    assert (is_found(right), right.side) == (True, RIGHT)
    # A sensor that fails is the one that changed, too.
    failed = watched(0.0, 0.4, 0.0, 0.3)
    assert (is_found(failed), failed.side) == (True, LEFT)
    # The load does not matter where a track jumped.
    assert watched(1.2, 0.4, 0.0, 0.3, force=-2.0).side == LEFT


@pytest.mark.parametrize(
    ("force", "side"), [(-0.3, RIGHT), (0.3, LEFT), (0.1, UNKNOWN), (math.nan, UNKNOWN)]
)
@pytest.mark.parametrize("speeds", [(0.3, 0.7), (0.7, 0.3)])
def test_a_track_that_did_not_jump_spins_if_it_has_less_load(
    force: float, side: int, speeds: tuple[float, float]
) -> None:
    """Its weight presses the robot on the lower track: it leans to where the force does not point."""
    found = watched(*speeds, 0.0, 0.5, force=force, was=speeds)
    assert (is_found(found), found.side) == (True, side)


def test_the_side_may_be_found_later() -> None:
    spin = watched(0.3, 0.7, 0.0, 0.5, was=(0.3, 0.7))
    assert spin.side == UNKNOWN
    for k in range(spin.stamp // STEP + 1, spin.stamp // STEP + 100):
        watch_spin(spin, k * STEP, 0.0, -0.5, 0.0, 0.0, FASTEST)
    assert spin.side == RIGHT


@given(
    mismatch=st.floats(0.25, 2.0),
    left=st.floats(-2.0, 2.0),
    right=st.floats(-2.0, 2.0),
    force=st.floats(-3.0, 3.0),
)
def test_the_mirrored_robot_spins_on_the_other_side(
    mismatch: float, left: float, right: float, force: float
) -> None:
    found = side_that_changed(mismatch, left, right, 0.25)
    assert side_that_changed(-mismatch, right, left, 0.25) == -found
    assert side_with_less_load(-force) == -side_with_less_load(force)


def test_the_tracks_turn_as_the_gyro_does_while_one_spins() -> None:
    spin, rate = watched(1.2, 0.4, 0.1, 0.3), 0.1

    def assumed(later: int = STEP) -> tuple[float, float]:
        return assumed_speeds(spin, spin.stamp + later, 1.2, 0.4)

    assert assumed() == pytest.approx((0.4 - WIDTH * rate, 0.4), rel=0.01)
    # A gyro that is silent tells nothing of the present.
    assert assumed(20 * STEP) == (1.2, 0.4)
    spin.side = RIGHT
    assert assumed() == pytest.approx((1.2, 1.2 + WIDTH * rate), rel=0.01)
    spin.side = UNKNOWN
    half = 0.5 * WIDTH * rate
    assert assumed() == pytest.approx((0.8 - half, 0.8 + half), rel=0.01)


@given(force=st.floats(-3.0, 3.0))
def test_what_is_forgotten_has_not_jumped(force: float) -> None:
    spin = watched(1.2, 0.4, 0.0, 0.3, force=force)
    assert spin.jumped
    forget_mismatch(spin)
    assert not spin.jumped


def test_the_mean_of_both_stays_until_it_is_certain() -> None:
    spin = watched(1.2, 0.4, 0.0, 0.08)
    assert not is_found(spin)
    later = spin.stamp + STEP
    assert assumed_speeds(spin, later, 1.2, 0.4) == pytest.approx((0.8, 0.8), abs=0.01)
    assert spin_density(spin, LEFT) == spin_density(spin, RIGHT) > 0.15
    # A bend whose gyro comes a sample later than its tracks is none.
    bend = watched(0.7, 0.4, 0.0, 0.1)
    assert bend.since > 0
    assert assumed_speeds(bend, bend.stamp + STEP, 0.7, 0.4) == (0.7, 0.4)
    assert spin_density(bend, LEFT) == 0.0


def test_a_track_that_may_stick_is_no_track_that_may_spin(robot: Robot) -> None:
    """What was seen of a mismatch before is forgotten, and does not act on bends to come."""
    chosen = input_settings(robot, Settings())
    tracks = TrackRecord()
    for k in range(400):
        take_tracks(tracks, k * STEP, 0.4 + 1e-3 * (k % 7), 0.4 - 1e-3 * (k % 5), chosen)
    tracks.spin = watched(1.2, 0.4, 0.0, 0.08)
    assert is_likely(tracks.spin)
    k, begin = 400, tracks.spin.stamp // STEP
    while not may_stick(tracks.repeating_left):
        take_tracks(tracks, (begin + k) * STEP, 1.2, 0.4 - 1e-3 * (k % 5), chosen)
        k += 1
    take_motion(tracks, (begin + k) * STEP, 0.0, math.nan, math.nan, chosen)
    assert not is_likely(tracks.spin)
    assert spin_density(tracks.spin, LEFT) == 0.0


def test_a_gyro_that_jumps_is_no_track_that_spins() -> None:
    spin = after_bends()
    begin = spin.stamp // STEP + 1
    for k in range(begin, begin + 100):
        watch_spin(spin, k * STEP, 2.0, math.nan, 0.0, 0.0, FASTEST)
        assert (is_found(spin), spin.gyro_jumped) == (False, 1)
    assert assumed_speeds(spin, spin.stamp, 0.4, 0.4) == (0.4, 0.4)
    watch_spin(spin, (begin + 100) * STEP, 0.0, math.nan, 0.0, 0.0, FASTEST)
    assert not spin.gyro_jumped
    # Its readings are no bends of the robot.
    assert width_of_bends(spin) == width_of_bends(after_bends())


def test_the_error_is_that_of_the_track_that_spins() -> None:
    spin = watched(1.2, 0.4, 0.0, 0.3)
    assert spin_density(spin, LEFT) == pytest.approx(0.3 * 0.8**2, rel=0.05)
    assert spin_density(spin, RIGHT) == 0.0
    spin.side = UNKNOWN
    assert spin_density(spin, LEFT) == spin_density(spin, RIGHT) > 0.15
    assert spin_density(SpinRecord(), LEFT) == 0.0


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_free_track_costs_little(variant: str, robot: Robot, drive: Log) -> None:
    """1.2 m if the track were believed; 0.3 m at most are left, within three own sigma."""
    found = motion_over(
        drive, robot, variant, lambda health: health.finding("spinning") is not None
    )
    assert found.error < 0.3
    assert found.error < 3.0 * found.sigma
    assert found.delay < 0.5


def test_the_upper_track_that_slides_is_taken_out(robot: Robot) -> None:
    """On the demo's ground the tall robot stands on its lower track alone at times."""
    found = upper_track_slides(robot, 15)
    assert found.times >= 5
    of_tracks, of_filter = (np.sqrt(np.mean(one**2)) for one in found[1:])
    assert of_tracks > 0.15
    assert of_filter < 0.25 * of_tracks


def test_health_names_the_track_while_it_spins(robot: Robot, drive: Log) -> None:
    estimator = PoseEstimator(robot, "constant-online")
    seen = set()
    for measurement in drive.measurements():
        estimator.feed(measurement)
        health = estimator.health
        spin = health.finding("spinning")
        if spin is not None:
            assert spin.since is not None
            assert spin.size is not None
            after = (spin.since - drive.start) * NANOSECOND - BEGINS
            assert 0.0 <= after < 0.1
            assert spin.size > 0.25
        seen.add((spin and spin.part, health.times.get("spinning", 0)))
    assert seen == {(None, 0), ("left track", 1), (None, 1)}


def test_arrays_agree_on_a_free_track(robot: Robot, drive: Log) -> None:
    one_by_one, at_once = (PoseEstimator(robot, "constant-online") for _ in range(2))
    for measurement in drive.measurements():
        one_by_one.feed(measurement)
    assert drive.imu is not None
    feed_arrays(at_once, drive.tracks, drive.imu)
    assert at_once.state == pytest.approx(one_by_one.state, abs=1e-9)
    assert at_once.health.findings == one_by_one.health.findings


def test_a_restored_estimator_goes_on_in_the_middle(
    robot: Robot, drive: Log, tmp_path: Path
) -> None:
    estimator, middle = PoseEstimator(robot, "constant-online"), drive.start + 31 * SECOND
    measurements = list(drive.measurements())
    for measurement in measurements:
        if measurement.stamp <= middle:
            estimator.feed(measurement)
    assert estimator.health.finding("spinning").part == "left track"
    estimator.save(tmp_path / "state.json")
    restored = PoseEstimator.restore(tmp_path / "state.json", robot)
    for measurement in measurements:
        if measurement.stamp > middle:
            estimator.feed(measurement)
            restored.feed(measurement)
    assert np.array_equal(restored.state, estimator.state)
    assert restored.health.findings == estimator.health.findings


@pytest.mark.parametrize("trajectory", ["random", "aggressive", "spin", "stop-and-go", "slalom"])
def test_no_false_alarm_in_ordinary_drives(trajectory: str, robot: Robot) -> None:
    log = simulate(Scenario(duration=60.0, seed=3, trajectory=trajectory, fix_rate=0.0), robot)
    (gyro,) = run_side_by_side(log, robot, ["gyro"]).values()
    assert not {"spinning", "sliding"} & gyro.health.times.keys()


@pytest.mark.parametrize("name", LOGS)
def test_no_false_alarm_on_real_logs(name: str, data_dir: Path) -> None:
    robot = load_robot(LOGS[name])
    log = read_log(sample_log(data_dir, name), robot)
    (gyro,) = run_side_by_side(log, robot, ["gyro"]).values()
    assert not {"spinning", "sliding"} & gyro.health.times.keys()


def test_the_jackals_tracks_spin_by_its_accelerometer(data_dir: Path) -> None:
    """The force to the left is that of the turning by the gyro, and none of that by the tracks."""
    robot = load_robot("jackal")
    log = read_log(sample_log(data_dir, "jackal_test2.bag"), robot)
    share, ((by_gyro, by_tracks), lows, highs) = shares_of_force(log, robot)
    assert 0.3 < share < 0.45
    assert lows[0] > 0.2
    assert highs[0] > 1.0
    assert highs[1] < 0.3
    assert by_gyro > 0.5
    assert abs(by_tracks) < 0.1


@pytest.mark.parametrize(
    ("variant", "name"), [("constant-online", "eta0"), ("inertia-online", "eta0")]
)
def test_a_track_that_spins_for_long_teaches_no_parameter(
    variant: str, name: str, robot: Robot
) -> None:
    """Of 2.6, 0.1 at most; believed, the track would teach 7.6."""
    log = faulty_drives.drive(robot, 0)
    estimator = PoseEstimator(robot, variant)
    begin, found = log.start + round(BEGINS * SECOND), []
    for measurement in with_free_track(log, 10.0).measurements():
        if measurement.stamp in (begin, begin + 11_000_000_000):
            found.append(estimator.parameters[name])
        estimator.feed(measurement)
    assert abs(found[-1] - found[0]) < 0.1
