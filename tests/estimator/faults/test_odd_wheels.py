"""A wheel that disagrees with the others of its side is found, left out, and costs little."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from _logs import WITH_TRUTH

import faulty_drives
from conftest import sample_log, thorough
from faulty_drives import VARIANTS, motion_over, with_free_wheel, with_wheels
from fed_estimators import feed_all
from icreckon import EstimatorError, Log, PoseEstimator, TrackSpeeds, read_log, run, run_many
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.faults.odd_wheels import (
    NO_WHEEL,
    SideSpeeds,
    WheelsRecord,
    are_found,
    side_speeds,
    take_wheels,
    wheel_density,
)
from icreckon.estimator.faults.spinning_tracks import SpinRecord
from icreckon.estimator.robot.robot_file import Robot, load_robot

STEP, LIMIT, FASTEST = 20_000_000, 0.15, 1.0
AGREE = (0.5, 0.5)


@pytest.fixture(scope="module")
def drive(robot: Robot) -> Log:
    return with_free_wheel(with_wheels(faulty_drives.drive(robot, 1, 36.0), 2, 1))


@pytest.mark.parametrize(
    ("wheels", "middle"),
    [
        ((0.7,), SideSpeeds(0.4, 0.4, True)),
        ((0.5, 0.6), SideSpeeds(0.4, 0.4, True)),
        ((0.5, 1.3), SideSpeeds(0.5, 1.3, False)),
        ((1.3, 0.5, 0.6), SideSpeeds(0.6, 0.6, False)),
        ((0.5, -0.3, 0.6, 0.6), SideSpeeds(0.55, 0.55, False)),
        ((0.5, 0.6, 1.3, 1.4), SideSpeeds(0.6, 1.3, False)),
    ],
)
def test_most_wheels_decide(wheels: tuple[float, ...], middle: SideSpeeds) -> None:
    assert side_speeds(0.4, wheels, LIMIT) == pytest.approx(middle)


class Sides:
    """Both sides of a robot that drives straight on, as far as its gyro says."""

    def __init__(self) -> None:
        self.left, self.right, self.spin = WheelsRecord(), WheelsRecord(), SpinRecord()
        self.stamp = 0

    def take(
        self,
        left: tuple[float, ...],
        right: tuple[float, ...] = AGREE,
        *,
        rate: float | None = 0.0,
        times: int = 1,
    ) -> tuple[float, float]:
        for _ in range(times):
            self.stamp += STEP
            if rate is not None:
                self.spin.stamp, self.spin.rate = self.stamp, rate
            means = tuple(sum(one) / len(one) for one in (left, right))
            sides = self.left, self.right, self.spin, self.stamp
            speeds = take_wheels(*sides, means, left, right, FASTEST)
        return speeds

    def density(self) -> float:
        return wheel_density(self.left, self.stamp, self.stamp, self.stamp + STEP)


@pytest.mark.parametrize(("left", "odd"), [((1.3, 0.5), 0), ((0.5, 0.0), 1)])
def test_the_gyro_decides_between_two(left: tuple[float, float], odd: int) -> None:
    sides = Sides()
    assert sides.take(left) == (0.5, 0.5)
    assert (sides.left.odd, sides.density()) == (odd, 0.0)
    assert not are_found(sides.left)
    sides.take(left, times=12)
    assert are_found(sides.left)
    assert not are_found(sides.right)
    assert (sides.left.samples, sides.left.times, sides.left.since) == (13, 1, STEP)
    assert sides.left.apart == pytest.approx(abs(left[0] - left[1]))


def test_a_wheel_of_the_other_side_may_be_odd_too() -> None:
    """Nothing decides then, and both are in doubt."""
    sides = Sides()
    assert sides.take((1.3, 0.5), (0.5, 1.3)) == (0.9, 0.9)
    assert sides.left.odd == sides.right.odd == NO_WHEEL
    assert sides.left.doubt == sides.right.doubt == pytest.approx(0.4)


def test_three_need_no_gyro() -> None:
    sides = Sides()
    assert sides.take((0.5, 1.3, 0.52), rate=None, times=10) == (0.52, 0.5)
    assert (sides.left.odd, sides.density(), are_found(sides.left)) == (1, 0.0, True)


def test_doubt_grows_with_its_time_until_the_gyro_comes() -> None:
    """The distance is off by the doubt times its duration, at one standard deviation."""
    sides, variance = Sides(), 0.0
    for _ in range(100):
        assert sides.take((1.3, 0.5), rate=None) == (0.9, 0.5)
        variance += sides.density() * STEP * NANOSECOND
    assert sides.left.odd == NO_WHEEL
    assert math.sqrt(variance) == pytest.approx(0.4 * 100 * STEP * NANOSECOND, rel=0.01)
    assert sides.take((1.3, 0.5)) == (0.5, 0.5)
    assert sides.density() == 0.0
    # Without it, what was certain goes on, and is doubted more and more.
    sides.stamp += 10 * STEP
    assert sides.take((1.3, 0.5), rate=None) == (0.5, 0.5)
    before = sides.density()
    sides.take((1.3, 0.5), rate=None, times=5)
    assert 0.0 < before < sides.density()


def test_a_gyro_that_fits_neither_does_not_decide() -> None:
    sides = Sides()
    assert sides.take((1.3, 0.5), (0.9, 0.9)) == (0.9, 0.9)
    # Before bends, a turn says little of the speeds.
    assert sides.take((1.3, 0.5), rate=0.5)[0] == 0.9
    sides.spin.way = 1.0
    assert sides.take((1.3, 0.5))[0] == 0.9


def test_agreement_ends_it_and_a_moment_is_not_reported() -> None:
    sides = Sides()
    sides.take((1.3, 0.5), times=2)
    assert not are_found(sides.left)
    sides.take((1.3, 0.5), times=10)
    assert sides.take((0.5, 0.6)) == (0.55, 0.5)
    assert are_found(sides.left)
    assert sides.density() == 0.0
    sides.take((0.5, 0.6), times=15)
    assert sides.left == WheelsRecord(times=1)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_free_wheel_costs_little(variant: str, robot: Robot, drive: Log) -> None:
    """1.2 m if the mean were believed."""
    found = motion_over(
        drive, robot, variant, lambda health: health.finding("wheel off") is not None
    )
    assert found.error < 0.2
    assert found.error < 3.0 * found.sigma
    assert found.delay < 0.25


def test_in_doubt_without_a_gyro_the_error_grows(robot: Robot) -> None:
    drive = with_wheels(faulty_drives.drive(robot, 1, 10.0), 2, 1)
    odd = replace(with_free_wheel(drive, 2.0), imu=None)
    doubt, certain = run(odd, robot, "inertia-online"), run(drive, robot, "inertia-online")
    assert doubt.state_sigmas[-1, 0] > 0.3 + certain.state_sigmas[-1, 0]


@pytest.mark.parametrize("begins", [0.0, 10.0])
def test_many_logs_are_run_as_one_is(begins: float, robot: Robot) -> None:
    log = with_free_wheel(with_wheels(faulty_drives.drive(robot, 1, 20.0), 3, 1), begins)
    expected, (of_many,) = run(log, robot, "gyro"), run_many([log], robot, "gyro")
    both, here, there = np.intersect1d(of_many.stamps, expected.stamps, return_indices=True)
    assert len(both) > 100
    np.testing.assert_allclose(of_many.poses[here], expected.trajectory.poses[there], atol=1e-9)
    np.testing.assert_allclose(
        of_many.pose_covariances[here], expected.trajectory.pose_covariances[there], atol=1e-9
    )


def test_a_log_keeps_the_wheels(drive: Log) -> None:
    again = Log.from_measurements(drive.measurements())
    part = again.between(drive.start, drive.start + 10**9).tracks
    assert np.array_equal(part.left_wheels, drive.tracks.left_wheels[: len(part.stamps)])
    assert part.right_wheels.shape == (len(part.stamps), 2)
    mixed = [TrackSpeeds(0, 0.1, 0.1), TrackSpeeds(1, 0.1, 0.1, (0.1, 0.1), (0.1, 0.1))]
    with pytest.raises(EstimatorError, match=r"as many wheels in each sample; found .*\(0, 0\)"):
        Log.from_measurements(mixed)


def test_wheels_that_are_no_numbers_are_refused(robot: Robot) -> None:
    estimator = PoseEstimator(robot, "gyro")
    with pytest.raises(EstimatorError, match="tracks: left_wheels must be numbers, found"):
        estimator.feed(TrackSpeeds(0, 0.1, 0.1, ("a", 0.1), (0.1, 0.1)))  # type: ignore[arg-type]
    assert not estimator.feed(TrackSpeeds(0, 0.1, 0.1, (math.nan, 0.1), (0.1, 0.1)))
    assert estimator.health.sensors["tracks"].rejected == {"left_wheels is not finite": 1}
    lists = TrackSpeeds(0, 0.1, 0.1, [0.1, 0.1], np.array([0.1, 0.1]))  # type: ignore[arg-type]
    assert estimator.feed(lists)


def false_alarms(log: Log, robot: Robot) -> int:
    estimator = feed_all(PoseEstimator(robot, "gyro"), log)
    return estimator.health.times.get("wheel off", 0)


@pytest.mark.parametrize("count", [2, 3])
def test_no_false_alarm_in_ordinary_drives(count: int, robot: Robot) -> None:
    assert false_alarms(with_wheels(faulty_drives.drive(robot, 3, 36.0), count), robot) == 0


@pytest.mark.parametrize("name", [thorough("husky_deflated_part1"), "marmotte_part1"])
def test_no_false_alarm_on_real_logs(name: str, data_dir: Path) -> None:
    robot = load_robot(WITH_TRUTH[name])
    log = with_wheels(read_log(sample_log(data_dir, name), robot), 2)
    assert false_alarms(log, robot) == 0
