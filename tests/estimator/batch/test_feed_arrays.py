"""Arrays of track speeds and IMU samples against the same samples fed one by one."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from fed_estimators import feed_all
from icreckon import (
    Log,
    PoseEstimator,
    Scenario,
    Settings,
    changed_robot,
    feed_arrays,
    load_robot,
    run,
    run_many,
    simulate,
)
from icreckon.estimator.filter.samples import samples_of
from icreckon.estimator.log.input_checks import key_of
from icreckon.estimator.log.measurements import ImuSample, PositionFix, TrackSpeeds, ZeroVelocity
from same_runs import assert_same_estimate

ROBOT = load_robot("auriga-alpha")
SCENARIO = Scenario(duration=30.0, seed=8, fix_rate=0.0, track_rate=40.0, imu_rate=100.0)


@cache
def drive(**changes: object) -> Log:
    return simulate(msgspec.structs.replace(SCENARIO, **changes), ROBOT)


def estimators(variant: str, settings: Settings | None = None) -> list[PoseEstimator]:
    start = {"start": (1.0, -2.0, 0.3), "start_sigma": (0.1, 0.1, 0.05)}
    return [PoseEstimator(ROBOT, variant, settings=settings, **start) for _ in range(2)]


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_after_arrays_both_go_on_alike(variant: str) -> None:
    """With a fix that is late, one of now, and more samples."""
    log, (by_arrays, one_by_one) = drive(), estimators(variant)
    feed_arrays(by_arrays, log.tracks, log.imu)
    feed_all(one_by_one, log)
    stamp = by_arrays.stamp
    x, y, _ = by_arrays.pose.tolist()
    for event in (
        PositionFix(stamp - 400_000_000, x + 0.05, y, 0.01),
        ZeroVelocity(stamp + 5_000_000),
        TrackSpeeds(stamp + 20_000_000, 0.2, 0.3),
        ImuSample(stamp + 20_000_000, (0.0, 0.0, 0.1), (0.0, 0.02, 9.81)),
        PositionFix(stamp + 20_000_000, x, y, 0.01),
    ):
        assert by_arrays.feed(event) == one_by_one.feed(event)
    assert_same_estimate(by_arrays, one_by_one)
    assert by_arrays.health.sensors["position"].late == 1


def test_arrays_may_follow_arrays_and_single_samples() -> None:
    log, (by_arrays, one_by_one) = drive(), estimators("inertia-online")
    cuts = [log.start + int(1e9 * time) for time in (0.0, 9.0, 11.5, 30.1)]
    fix = PositionFix(log.start + 12_000_000_000, 1.0, -1.5, 0.04)
    for begin, end in pairwise(cuts):
        part = log.between(begin, end - 1)
        feed_arrays(by_arrays, part.tracks, part.imu)
    feed_all(one_by_one, log)
    assert_same_estimate(by_arrays, one_by_one)
    # Older than what was processed as arrays.
    assert not by_arrays.feed(fix)
    assert by_arrays.health.sensors["position"].too_late == 1


def test_readings_that_the_filter_does_not_use_may_be_nan() -> None:
    """Missing accelerometers, and gyro axes that the robot file excludes; fed in every way."""
    robot, whole = changed_robot(ROBOT, {"imu.gyro_axes": "z"}), drive()
    rates, forces = whole.imu.angular_velocity.copy(), whole.imu.linear_acceleration.copy()
    rates[:, :2], forces[300:600], forces[900:1500, 1] = np.nan, np.nan, np.nan
    imu = replace(whole.imu, angular_velocity=rates, linear_acceleration=forces)
    samples = zip(imu.stamps.tolist(), rates.tolist(), forces.tolist(), strict=True)
    fed = [ImuSample(stamp, tuple(w), tuple(f)) for stamp, w, f in samples]
    absent = [
        ImuSample(m.stamp, (0.0, 0.0, m.angular_velocity[2]), m.linear_acceleration)
        if np.isfinite(m.linear_acceleration).all()
        else ImuSample(m.stamp, (0.0, 0.0, m.angular_velocity[2]))
        for m in fed
    ]
    tracks = list(replace(whole, imu=None).measurements())
    by_arrays, streamed, expected = (PoseEstimator(robot) for _ in range(3))
    for estimator, imu_samples in ((streamed, fed), (expected, absent)):
        for measurement in sorted([*tracks, *imu_samples], key=key_of):
            assert estimator.feed(measurement)
    feed_arrays(by_arrays, whole.tracks, imu)
    assert_same_estimate(streamed, expected)
    assert_same_estimate(by_arrays, expected)
    log = Log.from_measurements([*fed, *tracks], gyro_axes="z")
    assert not log.dropped
    pose = run(log, robot, "inertia-online").trajectory.poses[-1]
    (lane,) = run_many([log], robot, "inertia-online", every=0.01)
    assert pose.tolist() == expected.pose.tolist()
    assert np.allclose(lane.poses[-1], pose, rtol=0.0, atol=1e-9)


def test_samples_that_are_fed_again_are_duplicates() -> None:
    log, (by_arrays, whole) = drive(), estimators("inertia-online")
    used = 0
    for begin, end in ((0.0, 15.0), (14.5, 30.1)):
        part = log.part(begin, end)
        used += feed_arrays(by_arrays, part.tracks, part.imu)
    assert used == feed_arrays(whole, log.tracks, log.imu)
    assert by_arrays.health.sensors["tracks"].rejected["duplicate stamp"] == 21
    np.testing.assert_array_equal(by_arrays.state, whole.state)


def test_marks_and_the_plain_engine_take_samples_one_by_one() -> None:
    log, plain = drive(duration=0.3), Settings(engine="plain")
    by_arrays, one_by_one = estimators("constant-online", plain)
    used = feed_arrays(by_arrays, log.tracks, log.imu)
    assert used == sum(map(one_by_one.feed, log.measurements()))
    assert_same_estimate(by_arrays, one_by_one)
    log = drive(duration=4.0)
    by_arrays, one_by_one = estimators("constant-online")
    for one in (by_arrays, one_by_one):
        one.feed(TrackSpeeds(log.start - 10_000_000, 0.0, 0.0))
        one.mark()
    feed_arrays(by_arrays, log.tracks, log.imu)
    feed_all(one_by_one, log)
    assert_same_estimate(by_arrays, one_by_one)
    assert len(by_arrays.marks) == 1


def test_columns_of_a_table_are_arrays_of_the_usual_kind() -> None:
    """Strided and read-only arrays would be compiled for once more."""
    log = drive()
    table = np.column_stack([log.imu.angular_velocity, log.imu.linear_acceleration])
    table.flags.writeable = False
    imu = replace(log.imu, angular_velocity=table[:, :3], linear_acceleration=table[:, 3:])
    speeds = np.asfortranarray(log.tracks.speeds)
    found = samples_of(replace(log, tracks=replace(log.tracks, speeds=speeds), imu=imu))
    assert all(one.flags.c_contiguous and one.flags.writeable for one in found)
    np.testing.assert_array_equal(found.forces, log.imu.linear_acceleration)
