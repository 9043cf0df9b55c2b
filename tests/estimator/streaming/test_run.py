"""Running a filter over a log is feeding it by hand and writing down what it says."""

import numpy as np
import pytest

from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import FixSeries, ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

ALPHA = load_robot("auriga-alpha")


@pytest.fixture(scope="module")
def log():
    return simulate(Scenario(duration=10.0, seed=3, trajectory="aggressive"), ALPHA)


@pytest.fixture(scope="module")
def result(log):
    return run(log, ALPHA, "inertia-online", start=(1.0, 2.0, 0.5), start_sigma=(0.1, 0.1, 0.05))


def test_there_is_a_row_for_each_pair_of_track_speeds(log, result):
    n = len(log.tracks.stamps)
    # The first of them may wait for the IMU, or not.
    assert n - 1 <= len(result.stamps) <= n
    assert (np.diff(result.stamps) > 0).all()
    # Each row is the estimate at track speeds, or at the IMU sample next to them.
    nearest = np.abs(result.stamps[:, None] - log.tracks.stamps[None, :]).min(axis=1)
    assert nearest.max() <= 10_000_000


def test_all_arrays_have_a_row_for_each_stamp(result):
    n = len(result.stamps)
    assert result.trajectory.poses.shape == (n, 3)
    assert result.trajectory.pose_covariances.shape == (n, 3, 3)
    assert result.trajectory.twists.shape == (n, 3)
    assert result.trajectory.twist_covariances.shape == (n, 3, 3)
    assert result.indices.shape == (n, 3)
    assert result.states.shape == result.state_sigmas.shape == (n, s.SIZE)
    assert result.trajectory.pose_series.poses is result.trajectory.poses


def test_innovations_are_the_newest_of_each_sensor_since_the_row_before(log, result):
    assert result.innovations.shape == (len(result.stamps), len(result.innovation_names))
    assert result.innovations.dtype == np.float32
    columns = dict(zip(result.innovation_names, result.innovations.T, strict=True))
    assert list(columns) == [
        "gyro",
        "accelerometer_x",
        "accelerometer_y",
        "position_x",
        "position_y",
    ]
    estimator = PoseEstimator(
        ALPHA, "inertia-online", start=(1.0, 2.0, 0.5), start_sigma=(0.1, 0.1, 0.05)
    )
    newest = {}
    for measurement in log.measurements():
        estimator.feed(measurement)
        seen = estimator.health.sensors
        for name in ("gyro", "position"):
            if name in seen and seen[name].newest is not None:
                one = seen[name].newest
                newest[name, one.stamp] = one
    fixes = [one for (name, _), one in newest.items() if name == "position"]
    expected = [one.residual[1] / np.sqrt(one.covariance[1][1]) for one in fixes]
    told = columns["position_y"][np.isfinite(columns["position_y"])]
    np.testing.assert_allclose(told, expected, rtol=1e-6)
    gyro = [
        one.residual[0] / one.covariance[0][0] ** 0.5
        for (n, _), one in newest.items()
        if n == "gyro"
    ]
    told = columns["gyro"][np.isfinite(columns["gyro"])]
    assert np.isin(told, np.array(gyro, np.float32)).all()
    assert len(told) > 0.9 * len(result.stamps)
    assert 0.3 < told.std() < 3.0


def test_a_rejected_fix_shows_as_far_off(log):
    poses = log.fixes.poses.copy()
    poses[5, :2] += 50.0
    wrong = Log(
        log.name, log.tracks, log.imu, FixSeries(log.fixes.stamps, poses, log.fixes.variances)
    )
    found = run(wrong, ALPHA, "inertia-online")
    x = found.innovations[:, found.innovation_names.index("position_x")]
    assert np.nanmax(np.abs(x)) > 100.0
    row = int(np.nanargmax(np.abs(x)))
    assert abs(found.stamps[row] - log.fixes.stamps[5]) < 30_000_000


@pytest.mark.parametrize("variant", VARIANTS)
def test_run_is_feeding_by_hand(log, variant):
    found = run(log, ALPHA, variant)
    estimator = PoseEstimator(ALPHA, variant)
    expected = {}
    for measurement in log.measurements():
        estimator.feed(measurement)
        # The newest word at each stamp is what counts.
        snapshot = estimator.snapshot()
        expected[estimator.stamp] = (snapshot.state, snapshot.twist, snapshot.indices)
    assert found.variant == variant
    assert found.stamps[-1] == estimator.stamp
    for row, stamp in enumerate(found.stamps.tolist()):
        state, twist, indices = expected[stamp]
        assert (found.states[row] == state).all()
        assert (found.trajectory.twists[row] == twist).all()
        assert (found.indices[row] == indices).all()
    assert (found.trajectory.pose_covariances[-1] == estimator.pose_covariance).all()
    assert found.trajectory.twist_covariances[-1] == pytest.approx(
        estimator.twist_covariance, rel=1e-12
    )
    assert found.health.rejections() == estimator.health.rejections()
    assert found.health.sensors["tracks"].used == len(log.tracks.stamps)


def test_start_is_where_the_run_starts(result):
    # Three seconds of standstill: the first row is the start.
    assert result.trajectory.poses[0] == pytest.approx([1.0, 2.0, 0.5], abs=0.05)
    assert result.state_sigmas[0, s.POSE] == pytest.approx([0.1, 0.1, 0.05], rel=0.6)


def test_truth_is_not_looked_at(log):
    blind = Log(log.name, log.tracks, log.imu, log.fixes)
    a, b = run(log, ALPHA, "inertia-online"), run(blind, ALPHA, "inertia-online")
    assert (a.states == b.states).all()


def test_tracks_alone_give_a_row_for_each(log):
    alone = run(Log(log.name, log.tracks), ALPHA, "constant-fixed")
    assert alone.stamps.tolist() == log.tracks.stamps.tolist()


def test_refused_track_speeds_have_no_row(log):
    speeds = log.tracks.speeds.copy()
    speeds[[100, 200]] = np.nan
    bad = Log(log.name, TrackSpeedSeries(log.tracks.stamps, speeds))
    found = run(bad, ALPHA, "inertia-online")
    assert found.stamps.tolist() == np.delete(log.tracks.stamps, [100, 200]).tolist()
    assert found.health.rejections() == {"tracks: not finite": 2}
    with_imu = run(Log(log.name, bad.tracks, log.imu), ALPHA, "inertia-online")
    assert len(with_imu.stamps) == len(run(log, ALPHA, "inertia-online").stamps) - 2


def test_log_without_track_speeds_says_what_is_missing():
    stamps = np.array([1, 2], dtype=np.int64)
    empty = TrackSpeedSeries(stamps[:0], np.zeros((0, 2)))
    log = Log("imu only", empty, ImuSeries(stamps, np.zeros((2, 3))))
    with pytest.raises(EstimatorError, match="'imu only' holds no track speeds"):
        run(log, ALPHA, "inertia-online")
    with pytest.raises(EstimatorError, match="'imu only' holds no track speeds"):
        run(Log("imu only", empty), ALPHA, "inertia-online")
