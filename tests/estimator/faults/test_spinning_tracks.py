"""A track that spins free is found, in time and only then, and costs no variant its place."""

import math
from pathlib import Path

import numpy as np
import pytest
from _logs import logs_without

import faulty_drives
from conftest import sample_log
from faulty_drives import BEGINS, SECOND, VARIANTS, motion_over, with_free_track, with_tracks
from icreckon import Log, PoseEstimator, Scenario, Settings, read_log, run, simulate
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.faults.spinning_tracks import (
    LEFT,
    RIGHT,
    UNKNOWN,
    SpinRecord,
    assumed_speeds,
    is_found,
    spin_density,
    unexplained,
    watch_spin,
    width_of_bends,
)
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.robot.robot_file import Robot, load_robot

STEP = 10_000_000


@pytest.fixture(scope="module")
def drive(robot: Robot) -> Log:
    return with_free_track(faulty_drives.drive(robot, 1, 36.0))


WIDTH, FASTEST = 1.2, 1.0
# No track reads zero; the width of the robot file then does not count.
NOT_ZERO = UNKNOWN, math.nan
LOGS = logs_without("jackal", "wetexplorer")


def after_bends(width: float = WIDTH, seconds: float = 20.0, spread: float = 0.2) -> SpinRecord:
    """Record after bends with tracks of a width, more or less, and then straight on at 0.4 m/s."""
    spin, k = SpinRecord(), 0
    for k in range(round(seconds / (STEP * NANOSECOND))):
        rate = 0.8 * np.sin(0.01 * k)
        turning = width * (1.0 + spread * (-1) ** k) * rate
        spin.left, spin.right = 0.4 - 0.5 * turning, 0.4 + 0.5 * turning
        watch_spin(spin, k * STEP, rate, math.nan, 0.0, 0.0, FASTEST, *NOT_ZERO)
        assert not is_found(spin)
    spin.left = spin.right = 0.4
    watch_spin(spin, (k + 1) * STEP, 0.0, math.nan, 0.0, 0.0, FASTEST, *NOT_ZERO)
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
        watch_spin(spin, k * STEP, rate, force, left - was[0], right - was[1], FASTEST, *NOT_ZERO)
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


def with_left_at_zero(spin: SpinRecord, right: float, rate: float, seconds: float) -> SpinRecord:
    """The record after a time in which the left track reads zero and the right one jumped."""
    begin = max(0, spin.stamp) // STEP + 1
    spin.left, spin.right = 0.0, right
    for k in range(begin, begin + round(seconds / (STEP * NANOSECOND))):
        watch_spin(spin, k * STEP, rate, math.nan, 0.0, right, FASTEST, LEFT, WIDTH)
    return spin


@pytest.mark.parametrize("before", [SpinRecord, after_bends])
def test_a_track_that_reads_zero_is_the_one_that_fails(before) -> None:
    """Also before bends, by the width of the robot file, and if the other one has just sped up."""
    found = with_left_at_zero(before(), 0.6, 0.1, 0.5)
    assert (is_found(found), found.side) == (True, LEFT)
    assert assumed_speeds(found, found.stamp, 0.0, 0.6) == pytest.approx((0.48, 0.6), rel=0.01)
    # A robot that turns about a track that it holds has no fault, whether it slips a little or not.
    for share in (1.0, 0.7):
        assert not is_found(with_left_at_zero(before(), 0.6, share * 0.6 / WIDTH, 0.5))


def test_a_track_that_reads_zero_is_no_bend() -> None:
    found = with_left_at_zero(after_bends(), 0.6, 0.4, 20.0)
    assert width_of_bends(found) == width_of_bends(after_bends())


@pytest.mark.parametrize(
    ("force", "side"), [(-0.3, RIGHT), (0.3, LEFT), (0.1, UNKNOWN), (math.nan, UNKNOWN)]
)
@pytest.mark.parametrize("speeds", [(0.3, 0.7), (0.7, 0.3)])
def test_a_track_that_did_not_jump_spins_if_it_has_less_load(force, side, speeds):
    """Its weight presses the robot on the lower track: it leans to where the force does not point."""
    found = watched(*speeds, 0.0, 0.5, force=force, was=speeds)
    assert (is_found(found), found.side) == (True, side)


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


def test_a_gyro_that_jumps_is_no_track_that_spins() -> None:
    spin = after_bends()
    begin = spin.stamp // STEP + 1
    for k in range(begin, begin + 100):
        watch_spin(spin, k * STEP, 2.0, math.nan, 0.0, 0.0, FASTEST, *NOT_ZERO)
        assert (is_found(spin), spin.gyro_jumped) == (False, 1)
    assert assumed_speeds(spin, spin.stamp, 0.4, 0.4) == (0.4, 0.4)
    watch_spin(spin, (begin + 100) * STEP, 0.0, math.nan, 0.0, 0.0, FASTEST, *NOT_ZERO)
    assert not spin.gyro_jumped
    # Its readings are no bends of the robot.
    assert width_of_bends(spin) == width_of_bends(after_bends())


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_free_track_costs_little(variant: str, robot: Robot, drive: Log) -> None:
    """1.2 m if the track were believed; 0.3 m at most are left, within three own sigma."""
    found = motion_over(
        drive, robot, variant, lambda health: health.finding("spinning") is not None
    )
    assert found.error < 0.3
    assert found.error < 3.0 * found.sigma
    assert found.delay < 0.5


@pytest.mark.parametrize(("variant", "side"), list(zip(VARIANTS, (0, 1, 0), strict=True)))
def test_a_robot_with_an_encoder_that_never_worked_is_on_its_path(side, variant, robot):
    """5 to 7 m off if zero is used. The gyro is used nearly all the time."""
    log = faulty_drives.drive(robot, 0, 36.0)
    dead = with_tracks(log, 36.0, lambda speeds: speeds * [side, 1 - side], begins=0.0)
    estimator = PoseEstimator(robot, variant, start=(0.0, 0.0, 0.0), settings=Settings(history=0.0))
    texts = set()
    for k, measurement in enumerate(dead.measurements()):
        estimator.feed(measurement)
        if k % 20 == 0 and (finding := estimator.health.finding("spinning")):
            texts.add(finding.text)
    error = estimator.pose - interpolate_poses(log.truth.poses, np.array([estimator.stamp]))[0]
    assert np.hypot(*error[:2]) < 1.5
    assert abs(wrap_angle(error[2])) < 0.05
    assert any(f"the {('left', 'right')[side]} track reads zero" in text for text in texts)
    rejected = estimator.health.sensors["gyro"].rejected
    assert sum(rejected.values()) < 0.05 * len(log.imu.stamps)


@pytest.mark.parametrize("trajectory", ["aggressive", "spin", "stop-and-go"])
def test_no_false_alarm_in_ordinary_drives(trajectory: str, robot: Robot) -> None:
    log = simulate(Scenario(duration=60.0, seed=3, trajectory=trajectory, fix_rate=0.0), robot)
    gyro = run(log, robot, "gyro")
    assert not {"spinning", "sliding"} & gyro.health.times.keys()


@pytest.mark.parametrize("name", LOGS)
def test_no_false_alarm_on_real_logs(name: str, data_dir: Path) -> None:
    robot = load_robot(LOGS[name])
    log = read_log(sample_log(data_dir, name), robot)
    gyro = run(log, robot, "gyro")
    assert not {"spinning", "sliding"} & gyro.health.times.keys()


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_a_track_that_spins_for_long_teaches_no_parameter(variant, robot):
    """Of 2.6, 0.1 at most; believed, the track would teach 7.6."""
    log = faulty_drives.drive(robot, 0)
    estimator = PoseEstimator(robot, variant)
    begin, found = log.start + round(BEGINS * SECOND), []
    for measurement in with_free_track(log, 10.0).measurements():
        if measurement.stamp in (begin, begin + 11_000_000_000):
            found.append(estimator.parameters["eta0"])
        estimator.feed(measurement)
    assert abs(found[-1] - found[0]) < 0.1
