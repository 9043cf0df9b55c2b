"""Arrays of track speeds and IMU samples against the same samples fed one by one."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from icreckon.estimator.batch.feed_arrays import feed_arrays
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import ImuSample, PositionFix, TrackSpeeds, ZeroVelocity
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import EncoderSpec
from icreckon.simulation.simulate import simulate

ROBOT = load_robot("auriga-alpha")
SCENARIO = Scenario(duration=30.0, seed=8, fix_rate=0.0, track_rate=40.0, imu_rate=100.0)
COUNTS = ("used", "rejected", "degrees", "judged_count", "reacquired", "late")


@cache
def drive(**changes: object) -> Log:
    return simulate(msgspec.structs.replace(SCENARIO, **changes), ROBOT)


def estimators(variant: str, settings: Settings | None = None) -> list[PoseEstimator]:
    start = {"start": (1.0, -2.0, 0.3), "start_sigma": (0.1, 0.1, 0.05)}
    return [PoseEstimator(ROBOT, variant, settings=settings, **start) for _ in range(2)]


def assert_same(one: PoseEstimator, other: PoseEstimator) -> None:
    assert one.stamp == other.stamp
    assert one.stands == other.stands
    sigmas = np.sqrt(np.diagonal(other.covariance))
    unit = np.where(sigmas > 0.0, sigmas, 1.0)
    assert np.abs((one.state - other.state) / unit).max() < 1e-9
    assert np.abs((one.covariance - other.covariance) / np.outer(unit, unit)).max() < 1e-9
    a, b = one.health, other.health
    assert a.standstill_updates == b.standstill_updates
    assert (a.track_gaps, a.times, a.findings) == (b.track_gaps, b.times, b.findings)
    assert a.sensors.keys() == b.sensors.keys()
    for name, sensor in a.sensors.items():
        for count in COUNTS:
            assert getattr(sensor, count) == getattr(b.sensors[name], count), (name, count)
        assert sensor.nis_sum == pytest.approx(b.sensors[name].nis_sum, rel=1e-9)
        if sensor.recent_nis is not None:
            assert sensor.recent_nis == pytest.approx(b.sensors[name].recent_nis, rel=1e-6)
    assert np.abs(one.twist - other.twist).max() < 1e-10
    assert one.indices == pytest.approx(other.indices, abs=1e-9)


def fed_both_ways(
    log: Log, variant: str, settings: Settings | None = None
) -> tuple[PoseEstimator, PoseEstimator]:
    by_arrays, one_by_one = estimators(variant, settings)
    assert log.imu is not None
    used = feed_arrays(by_arrays, log.tracks, log.imu)
    assert used == sum(map(one_by_one.feed, log.measurements()))
    assert_same(by_arrays, one_by_one)
    return by_arrays, one_by_one


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_arrays_come_to_what_single_samples_do(variant: str) -> None:
    log = drive()
    by_arrays, one_by_one = fed_both_ways(log, variant)
    assert by_arrays.health.standstill_updates > 0
    # Both go on: a fix that is late, one of now, and more samples.
    stamp = by_arrays.stamp
    assert stamp is not None
    x, y, _ = by_arrays.pose.tolist()
    for event in (
        PositionFix(stamp - 400_000_000, x + 0.05, y, 0.01),
        ZeroVelocity(stamp + 5_000_000),
        TrackSpeeds(stamp + 20_000_000, 0.2, 0.3),
        ImuSample(stamp + 20_000_000, (0.0, 0.0, 0.1), (0.0, 0.02, 9.81)),
        PositionFix(stamp + 20_000_000, x, y, 0.01),
    ):
        assert by_arrays.feed(event) == one_by_one.feed(event)
    assert_same(by_arrays, one_by_one)
    assert by_arrays.health.sensors["position"].late == 1


def test_arrays_may_follow_arrays_and_single_samples() -> None:
    log, (by_arrays, one_by_one) = drive(), estimators("inertia-online")
    assert log.imu is not None
    cuts = [log.start + int(1e9 * time) for time in (0.0, 9.0, 11.5, 30.1)]
    fix = PositionFix(log.start + 12_000_000_000, 1.0, -1.5, 0.04)
    for begin, end in pairwise(cuts):
        tracks = (log.tracks.stamps >= begin) & (log.tracks.stamps < end)
        imu = (log.imu.stamps >= begin) & (log.imu.stamps < end)
        force = log.imu.linear_acceleration
        assert force is not None
        feed_arrays(
            by_arrays,
            TrackSpeedSeries(log.tracks.stamps[tracks], log.tracks.speeds[tracks]),
            ImuSeries(log.imu.stamps[imu], log.imu.angular_velocity[imu], force[imu]),
        )
    for measurement in log.measurements():
        one_by_one.feed(measurement)
    assert_same(by_arrays, one_by_one)
    # Older than what was processed as arrays.
    assert not by_arrays.feed(fix)
    assert by_arrays.health.sensors["position"].too_late == 1


def without(log: Log, begin: float, end: float) -> Log:
    """A log whose track speeds have a gap [s]."""
    times = 1e-9 * (log.tracks.stamps - log.start)
    kept = (times < begin) | (times > end)
    return replace(log, tracks=TrackSpeedSeries(log.tracks.stamps[kept], log.tracks.speeds[kept]))


def with_readings(log: Log, change: Callable[[np.ndarray, np.ndarray], None]) -> Log:
    """A log with other IMU readings."""
    assert log.imu is not None
    assert log.imu.linear_acceleration is not None
    rates, forces = log.imu.angular_velocity.copy(), log.imu.linear_acceleration.copy()
    change(rates, forces)
    return replace(log, imu=ImuSeries(log.imu.stamps, rates, forces))


def spikes(rates: np.ndarray, _forces: np.ndarray) -> None:
    rates[700:704] = 5.0
    rates[1500:1530] += 3.0


def missing_forces(_rates: np.ndarray, forces: np.ndarray) -> None:
    forces[900:1000] = np.nan


@pytest.mark.parametrize(
    "log",
    [
        lambda: drive(encoders=EncoderSpec(resolution=2e-3)),
        lambda: without(drive(), 10.0, 13.0),
        lambda: with_readings(drive(), spikes),
        lambda: with_readings(drive(), missing_forces),
        lambda: drive(track_rate=100.0, imu_rate=25.0),
    ],
    ids=["encoders that count", "a gap", "spikes", "missing forces", "a slow IMU"],
)
def test_arrays_with_trouble_come_to_the_same(log: Callable[[], Log]) -> None:
    by_arrays, _ = fed_both_ways(log(), "inertia-online")
    assert by_arrays.health.sensors["gyro"].used > 100


def test_an_imu_without_accelerometers() -> None:
    log = drive()
    assert log.imu is not None
    without_forces = replace(log, imu=ImuSeries(log.imu.stamps, log.imu.angular_velocity))
    by_arrays, _ = fed_both_ways(without_forces, "inertia-online")
    assert "accelerometer" not in by_arrays.health.sensors


def test_marks_and_the_plain_engine_take_samples_one_by_one() -> None:
    fed_both_ways(drive(duration=1.0), "constant-online", Settings(engine="plain"))
    log = drive(duration=8.0)
    by_arrays, one_by_one = estimators("constant-online")
    assert log.imu is not None
    for one in (by_arrays, one_by_one):
        one.feed(TrackSpeeds(log.start - 10_000_000, 0.0, 0.0))
        one.mark()
    feed_arrays(by_arrays, log.tracks, log.imu)
    for measurement in log.measurements():
        one_by_one.feed(measurement)
    assert_same(by_arrays, one_by_one)
    assert len(by_arrays.marks) == 1
