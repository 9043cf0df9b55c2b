"""A shaking gyro: resting tracks hold the yaw, turns are noticed."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from icreckon import Log, PoseEstimator, Settings, changed_robot, feed_arrays, load_robot
from icreckon.estimator.base import state as s
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.sensors.standstill import LASTING

ALPHA = load_robot("auriga-alpha")
# Noise of 0.05 rad/s at 100 Hz.
DENSITY, BIAS = 0.005, -0.005
FACTORS = pytest.mark.parametrize("factor", [1.0 / 30.0, 1.0])
RATES = pytest.mark.parametrize("rate", [50, 400])


def robot_with(density):
    return changed_robot(ALPHA, {"imu.gyro_noise_density": density})


def stamps_of(t):
    return np.rint(t * 1e9).astype(np.int64)


@functools.cache
def shaken(rate, seconds, hertz=0.0, turn=0.0, seed=0, share=1.0):
    """A log at rest that may be turned from the half on."""
    rng = np.random.default_rng(seed)
    t, track_t = (np.arange(int(seconds * each)) / each for each in (rate, 50))
    noise = DENSITY * np.sqrt(rate) * rng.standard_normal(len(t))
    if hertz:
        noise = DENSITY * 10.0 * np.sqrt(2.0) * np.sin(2.0 * np.pi * hertz * t + 0.5)
    rates = np.zeros((len(t), 3))
    rates[:, 2] = BIAS + share * noise + np.where(t >= seconds / 2, turn, 0.0)
    forces = np.column_stack([0.5 * rng.standard_normal((len(t), 2)), np.full(len(t), 9.81)])
    tracks = TrackSpeedSeries(stamps_of(track_t), np.zeros((len(track_t), 2)))
    return Log("shaken", tracks, ImuSeries(stamps_of(t), rates, forces))


def fed(log, robot):
    estimator = PoseEstimator(robot, "constant-online", settings=Settings(history=0.0))
    feed_arrays(estimator, log.tracks, log.imu)
    return estimator


def yaw_of(estimator):
    return np.degrees(estimator.pose[2]), np.degrees(estimator.pose_covariance[2, 2] ** 0.5)


@RATES
@pytest.mark.parametrize("factor", [1.0 / 30.0, 30.0])
def test_yaw_stays_for_ten_minutes_whatever_the_file_says(rate, factor):
    estimator = fed(shaken(rate, 600.0), robot_with(factor * DENSITY))
    yaw, sigma = yaw_of(estimator)
    assert abs(yaw) < 1.0
    assert abs(yaw) < 3.0 * sigma < 6.0
    assert estimator.health.standstill_updates > 0.99 * 600 * rate
    bias = estimator.biases["gyro_bias"] - BIAS
    assert abs(bias) < 3.5 * estimator.covariance[s.GYRO_BIAS, s.GYRO_BIAS] ** 0.5
    assert abs(bias) < 1e-3


@RATES
@FACTORS
def test_an_engine_is_not_a_turn(rate, factor):
    estimator = fed(shaken(rate, 120.0, hertz=12.0), robot_with(factor * DENSITY))
    yaw, sigma = yaw_of(estimator)
    assert abs(yaw) < min(1.0, 3.0 * sigma)
    assert abs(estimator.biases["gyro_bias"] - BIAS) < 5e-4
    assert estimator.health.standstill_updates > 0.98 * 120 * rate


@pytest.mark.parametrize("seed", range(2))
@FACTORS
def test_the_first_reading_does_not_set_the_bias(factor, seed):
    """After one second at rest the bias is a mean, as uncertain as it is wrong."""
    estimator = fed(shaken(100, 1.0, seed=seed), robot_with(factor * DENSITY))
    bias = estimator.biases["gyro_bias"] - BIAS
    sigma = estimator.covariance[s.GYRO_BIAS, s.GYRO_BIAS] ** 0.5
    assert 0.003 < sigma < 0.0101
    assert abs(bias) < 3.0 * sigma


@FACTORS
@pytest.mark.parametrize("turn", [0.06, -0.3])
def test_a_slow_turn_with_resting_tracks_is_a_bias_and_the_covariance_covers_it(turn, factor):
    estimator = fed(shaken(100, 120.0, turn=turn), robot_with(factor * DENSITY))
    yaw, sigma = yaw_of(estimator)
    turned = abs(np.degrees(60.0 * turn))
    # Until the change has lasted, it is a turn.
    assert abs(yaw) < np.degrees(LASTING * abs(turn))
    assert 0.3 * turned < sigma < 0.7 * turned
    assert estimator.biases["gyro_bias"] - BIAS == pytest.approx(turn, abs=0.01)
    assert estimator.stands


@FACTORS
@pytest.mark.parametrize("turn", [0.5, -0.45])
def test_a_turn_with_resting_tracks_is_noticed(turn, factor):
    estimator = fed(shaken(100, 120.0, turn=turn), robot_with(factor * DENSITY))
    yaw, sigma = yaw_of(estimator)
    turned = np.degrees(60.0 * turn)
    assert abs(yaw - turned) < max(3.0 * sigma, 0.02 * abs(turned))
    # The slip of a pushed robot fades within a second, which takes a little of a noisy yaw rate.
    assert abs(yaw - turned) < 4.0 + 0.012 * abs(turned)
    assert abs(estimator.biases["gyro_bias"] - BIAS) < 1.5e-3
    assert not estimator.stands


def test_a_robot_that_is_pushed_back_and_forth_is_followed():
    """By half a radian in each direction, once in four seconds."""
    log = shaken(100, 60.0, share=0.1)
    t = log.imu.stamps * 1e-9
    rates = log.imu.angular_velocity.copy()
    pushed = t >= 30.0
    rates[pushed, 2] += 0.4 * np.sin(0.5 * np.pi * (t[pushed] - 30.0))
    log = replace(log, imu=replace(log.imu, angular_velocity=rates))
    for end, expected in ((32.0, 0.8 / np.pi * 2.0), (34.0, 0.0)):
        estimator = fed(log.part(0.0, end), robot_with(0.1 * DENSITY))
        assert estimator.pose[2] == pytest.approx(expected, abs=0.04)
