"""Track speeds that are unknown: what the filter reports while they are stale or stuck."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from agreement_scenes import with_stuck_track
from icreckon import Log, PoseEstimator, Scenario, Settings, load_robot, run, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.engine.constants import REGRESSOR_SMOOTHING
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.reference.ekf import IcrEkf, ProcessNoise
from icreckon.estimator.robot.variants import find_variant, slip_of
from icreckon.estimator.sensors.held_tracks import SMOOTHING, TrackRecord, take_tracks
from icreckon.estimator.sensors.input_settings import input_settings
from same_runs import without

SECOND = 1_000_000_000
ROBOT = load_robot("auriga-alpha")
FASTEST = ROBOT.vehicle.max_track_speed
FROM = 8.0
"""When a driver stops sending track speeds [s]."""
VARIANTS = ("constant-online", "inertia-online")


@pytest.fixture(scope="module")
def log() -> Log:
    scenario = Scenario(duration=14.0, seed=3, trajectory="slalom", fix_rate=0.0)
    return simulate(scenario, ROBOT)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_stale_speed_dies_away_and_no_accelerometer_moves_it(log: Log, variant: str) -> None:
    """A yaw rate times a speed is a force; an unknown speed may not follow from it."""
    estimator = PoseEstimator(ROBOT, variant)
    found = []
    for m in without(log, "tracks", FROM, 99.0).measurements():
        estimator.feed(m)
        if m.stamp > log.start + round(FROM * SECOND):
            sigma = np.sqrt(np.diagonal(estimator.twist_covariance))
            found.append((estimator.twist[0], *sigma[:2]))
    speeds, *sigmas = np.abs(found).T
    assert speeds.max() < 1.1 * speeds[0]
    assert speeds[-1] < 0.25 * speeds[0]
    assert np.max(sigmas) < 1.001 * FASTEST
    assert sigmas[0][-1] > 0.9 * FASTEST


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_stuck_speed_is_not_moved_by_the_accelerometer(log: Log, variant: str) -> None:
    estimator = PoseEstimator(ROBOT, variant)
    for m in with_stuck_track(log).measurements():
        estimator.feed(m)
        assert abs(estimator.twist[0]) < 1.2 * FASTEST
        assert np.sqrt(estimator.twist_covariance[0, 0]) < 1.001 * FASTEST
    assert estimator.health.times["stuck"] == 1


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("seed", [3, 4])
def test_a_bend_that_begins_while_no_track_speeds_come_is_no_rest(seed: int, variant: str) -> None:
    options = {"drive": 12.0, "rest": 5.0}
    scenario = Scenario(
        duration=34.0, seed=seed, trajectory="stop-and-go", trajectory_options=options, fix_rate=0.0
    )
    whole = simulate(scenario, ROBOT)
    found = run(without(whole, "tracks", 20.0, 33.0), ROBOT, variant)
    error = found.trajectory.poses[-1, :2] - whole.truth.poses.poses[-1, :2]
    covariance = found.trajectory.pose_covariances[-1, :2, :2]
    assert np.linalg.norm(error) > 2.0
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(0.99, 2)
    biases = [one.states[-1, s.GYRO_BIAS] for one in (found, run(whole, ROBOT, variant))]
    assert abs(biases[0] - biases[1]) < 0.01


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_driver_that_sends_nothing_at_rest_shows_the_bias(variant: str) -> None:
    options = {"drive": 6.0, "rest": 10.0}
    scenario = Scenario(
        duration=50.0, seed=3, trajectory="stop-and-go", trajectory_options=options, fix_rate=0.0
    )
    whole = simulate(scenario, ROBOT)
    sends = np.abs(whole.tracks.speeds).max(axis=1) > 0.02 * FASTEST
    sends[0] = True
    tracks = TrackSpeedSeries(whole.tracks.stamps[sends], whole.tracks.speeds[sends])
    silent, found = (run(one, ROBOT, variant) for one in (replace(whole, tracks=tracks), whole))
    assert silent.state_sigmas[-1, s.GYRO_BIAS] < 1.5 * found.state_sigmas[-1, s.GYRO_BIAS]
    assert abs(silent.states[-1, s.GYRO_BIAS] - found.states[-1, s.GYRO_BIAS]) < 0.001


SETTINGS = input_settings(ROBOT, Settings())


def held(speeds, rate, tracks=None, start=0):
    tracks = tracks or TrackRecord()
    for k, (left, right) in enumerate(speeds):
        take_tracks(tracks, start + k * SECOND // rate, left, right, SETTINGS)
    return tracks


def smooth(tracks):
    return tracks.smooth_left, tracks.smooth_right


@pytest.mark.parametrize("rate", [50, 400])
def test_smoothed_speeds_follow_a_step_in_their_time_whatever_the_rate(rate):
    count = round(SMOOTHING * rate)
    tracks = held([(0.0, 1.0)] + [(1.0, 0.0)] * count, rate)
    assert smooth(tracks) == pytest.approx((1.0 - np.exp(-1.0), np.exp(-1.0)), abs=1e-6)


def test_smoothed_speeds_begin_anew_after_a_hole():
    tracks = held([(0.2, 0.3)] * 5, 50)
    assert smooth(tracks) == pytest.approx((0.2, 0.3))
    assert smooth(held([(0.7, -0.1)], 50, tracks, start=SECOND)) == pytest.approx((0.7, -0.1))


def test_slip_is_as_large_as_the_smoothed_speeds_make_it():
    disturbances = Disturbances(
        ROBOT, slip_of(ROBOT, find_variant("inertia-online")), np.zeros(s.PARAMETER_COUNT)
    )
    noisy = held([(0.2, 0.6)] * 50 + [(0.1, 0.8)], 400)
    steady = held([smooth(noisy)], 400)
    sizes = [disturbances.slip_sigma(one, 1.5, pushed=False) for one in (noisy, steady)]
    assert sizes[0] == sizes[1]


@pytest.mark.parametrize("share", [-0.5, 0.0, 0.4, 1.0, 1.5])
def test_derivatives_by_the_parameters_are_of_the_turn_that_tracks_and_yaw_rate_show(share):
    ekf = IcrEkf(LaggedIndexMotion(ROBOT.constants))
    ekf.x[s.PARAMETERS] = ROBOT.indices.as_array()
    model, ekf.regressors = ekf.twist_model(0.2, 0.6), np.zeros((3, s.REGRESSOR_COUNT))
    of_tracks, by = model.twist[2], model.by_speeds[2]
    # The robot turns `share` of what its tracks show, all the time.
    ekf.x[s.SLIP_W] = (share - 1.0) * of_tracks
    lasting = ProcessNoise(np.zeros(3), (1e9, 1e9, 1e9), np.zeros(s.SIZE))
    for _ in range(round(10 * REGRESSOR_SMOOTHING / 0.01)):
        ekf.predict_motion(0.01, 0.2, 0.6, lasting)
    ekf.x[s.SLIP_W] = 0.0
    shown = min(max(share, 0.0), 1.0)
    assert ekf.regressors[2, -1] == pytest.approx(shown * of_tracks, rel=1e-3, abs=1e-5)
    less = (shown - 1.0) * of_tracks / by.dot(by)
    speeds = np.array((0.2, 0.6)) + less * by
    for i in range(s.PARAMETERS.start, s.PARAMETERS.stop):
        twists, step = [], 1e-6 * max(1.0, abs(ekf.x[i]))
        for more in (step, -2.0 * step):
            ekf.x[i] += more
            twists.append(ekf.twist_model(*speeds).twist)
        ekf.x[i] += step
        expected = (twists[0] - twists[1]) / (2.0 * step)
        found = ekf.regressors[:, i - s.PARAMETERS.start]
        assert found == pytest.approx(expected, rel=1e-3, abs=1e-5), i
