"""Being told that the robot stands: what that moves, what it leaves alone, when it is not believed."""

import math

import numpy as np
import pytest

from fed_estimators import known
from icreckon import PoseEstimator, Settings, StandstillSettings, load_robot
from icreckon.estimator.base import state as s
from icreckon.estimator.log.measurements import (
    STANDSTILL_SIGMA,
    ImuSample,
    TrackSpeeds,
    ZeroVelocity,
)

ALPHA = load_robot("auriga-alpha")
EPOCH = 1_700_000_000_123_456_789
STEP = 10_000_000
BIAS = 0.012
# Vibration, say, keeps the filter from finding out by itself.
BLIND = StandstillSettings(duration=60.0)


def brought_to_a_stop(told_every=None, *, after=10.0, shift=STEP // 3, standstill=BLIND):
    """Two seconds of a bend, the last half of one slowing down, then at rest; IMU at 100 Hz.

    The gyro has some bias and noise.
    """
    settings = Settings(standstill=standstill)
    estimator, rng = PoseEstimator(ALPHA, settings=settings), np.random.default_rng(0)
    probe = PoseEstimator(ALPHA, "inertia-fixed")
    probe.feed(TrackSpeeds(0, 0.3, 0.6))
    v_x, v_y, w = probe.twist
    for k in range(200 + round(100 * after)):
        stamp, moving = EPOCH + k * STEP, k < 200
        share = min(1.0, max(0.0, (200 - k) / 50))
        slows = 2.0 if 0.0 < share < 1.0 else 0.0
        if k % 2 == 0:
            estimator.feed(TrackSpeeds(stamp, 0.3 * share, 0.6 * share))
        reading = share * w + BIAS + 5e-3 * rng.normal()
        turning = share**2 * w
        force = -slows * v_x - turning * v_y, -slows * v_y + turning * v_x, 9.81
        estimator.feed(ImuSample(stamp, (0.0, 0.0, reading), force))
        if told_every and not moving and k % told_every == 0:
            estimator.feed(ZeroVelocity(stamp + shift))
    return estimator


def sigma_of(estimator, index):
    return math.sqrt(estimator.covariance[index, index])


@pytest.mark.parametrize("shift", [0, STEP // 3])
def test_the_gyro_tells_its_bias_once_the_robot_is_known_to_stand(shift):
    untold = brought_to_a_stop()
    assert sigma_of(untold, s.GYRO_BIAS) > 5e-3, "or there is nothing to gain"
    told = brought_to_a_stop(10, shift=shift)
    # The noise of the gyro over a hundred samples that were taken at a known rest.
    sigma = sigma_of(told, s.GYRO_BIAS)
    assert 5e-3 / math.sqrt(100.0) < sigma < 1.3 * 5e-3 / math.sqrt(100.0) + 1e-4
    assert abs(told.biases["gyro_bias"] - BIAS) < 4.0 * sigma
    assert told.health.sensors["zero velocity"].used == 100
    assert told.health.rejections() == {}


@pytest.mark.parametrize("shift", [0, STEP // 3, 30 * STEP])
def test_it_moves_neither_pose_nor_what_was_learnt_but_the_slip(shift):
    estimator = brought_to_a_stop(after=2.0)
    before, P = estimator.state, estimator.covariance
    shared = P[s.SLIP_W, s.GYRO_BIAS]
    assert abs(shared) > 1e-5
    assert estimator.feed(ZeroVelocity(estimator.stamp + shift)) is True
    after = estimator.state
    assert (after[s.LEARNT] == before[s.LEARNT]).all()
    # But for the walk of the biases.
    variances, walked = np.diagonal(P)[s.LEARNT], estimator.covariance.diagonal()[s.LEARNT]
    assert walked == pytest.approx(variances, rel=5e-3)
    if shift < STEP:
        assert (after[s.POSE] == before[s.POSE]).all()
        assert (walked == variances).all()
        assert np.abs(after[s.SLIP]).max() < 1e-4 < np.abs(before[s.SLIP]).max()
        assert (
            sigma_of(estimator, s.SLIP_W)
            < 1.01 * STANDSTILL_SIGMA[2]
            < math.sqrt(P[s.SLIP_W, s.SLIP_W])
        )
        # What the slip was believed to share with the bias is gone with it.
        assert abs(estimator.covariance[s.SLIP_W, s.GYRO_BIAS]) < 0.01 * abs(shared)


def test_between_imu_samples_the_estimate_stays_where_it_is_and_the_step_goes_on():
    one, other = brought_to_a_stop(after=2.0), brought_to_a_stop(after=2.0)
    stamp = one.stamp
    assert one.feed(ZeroVelocity(stamp + STEP // 2))
    assert one.stamp == stamp
    sample = ImuSample(stamp + STEP, (0.0, 0.0, BIAS), (0.0, 0.0, 9.81))
    for estimator in (one, other):
        assert estimator.feed(sample)
    assert one.stamp == other.stamp == stamp + STEP
    assert sigma_of(one, s.GYRO_BIAS) < 0.8 * sigma_of(other, s.GYRO_BIAS)
    # One step later it may be pushed again, as far as is known.
    pushed, resting = (one._reckoning.slip_sigma(pushed=may_be)[2] for may_be in (True, False))
    assert one._reckoning.slip_sigma()[2] == pushed > resting


def test_a_robot_that_moves_is_not_believed_to_stand_and_nothing_changes():
    estimator = PoseEstimator(ALPHA)
    for k in range(100):
        estimator.feed(TrackSpeeds(EPOCH + k * STEP, 0.5, 0.5))
        estimator.feed(ImuSample(EPOCH + k * STEP, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
    for shift in (0, STEP // 2):
        before = known(estimator)
        assert estimator.feed(ZeroVelocity(estimator.stamp + shift)) is False
        assert known(estimator) == before
    assert estimator.health.rejections() == {"zero velocity: gate": 2}


@pytest.mark.parametrize("delay", [0.02, 0.1, 0.5])
def test_drivers_that_pause_at_rest_resume_where_the_robot_stood(delay: float) -> None:
    """The age of the track speeds counts from the last zero velocity, not from the begin of the pause."""
    estimator, stamp = PoseEstimator(ALPHA), EPOCH

    def feed_pair(at: int) -> None:
        estimator.feed(TrackSpeeds(at, 0.0, 0.0))
        estimator.feed(ImuSample(at, (0.0, 0.0, BIAS), (0.0, 0.0, 9.81)))

    for _ in range(500):
        stamp += 2 * STEP
        feed_pair(stamp)
    for _ in range(30):
        stamp += 1_000_000_000
        assert estimator.feed(ZeroVelocity(stamp))
    feed_pair(stamp + round(delay * 1e9))
    x, y, yaw = np.sqrt(np.diag(estimator.pose_covariance))
    assert max(x, y) < 0.1
    assert yaw < 0.1
