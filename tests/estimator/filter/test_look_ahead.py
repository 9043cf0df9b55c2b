"""Fixes and body velocities between two IMU samples: they do not end the step that is under way."""

import numpy as np
import pytest

from icreckon import BodyVelocity, ImuSample, PoseEstimator, PositionFix, TrackSpeeds, load_robot
from icreckon.estimator.base import state as s
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.sensors.measurement_models import MODELS
from icreckon.estimator.sensors.predictions import pose_ahead, pose_now, twist_ahead

ALPHA = load_robot("auriga-alpha")
EPOCH = 1_700_000_000_000_000_000
STEP = 10_000_000
NO_DENSITY = np.zeros((3, 3))


def some_ekf():
    rng = np.random.default_rng(1)
    ekf = IcrEkf(LaggedIndexMotion(ALPHA.constants))
    ekf.x[s.PARAMETERS] = ALPHA.indices.as_array()
    ekf.x[s.POSE] = 1.0, -2.0, 0.7
    ekf.x[s.SLIP] = 0.01, -0.02, 0.05
    ekf.x[s.FAST_SLIP] = 0.02 * rng.normal(size=3)
    return ekf


def test_pose_ahead_is_that_of_the_motion_without_fast_slip_and_so_are_its_derivatives():
    ekf, elapsed = some_ekf(), 0.05

    def predicted(x):
        ekf.x = x
        return pose_ahead(x, ekf.twist_model(0.2, 0.6), NO_DENSITY, elapsed)

    x = ekf.x.copy()
    found = predicted(x)
    still = x.copy()
    still[s.FAST_SLIP] = 0.0
    assert found.values == pytest.approx(predicted(still).values, abs=1e-12)
    for column in range(s.SIZE):
        step = np.zeros(s.SIZE)
        step[column] = 1e-6
        slope = (predicted(x + step).values - predicted(x - step).values) / 2e-6
        assert slope == pytest.approx(found.H[:, column], rel=1e-4, abs=1e-7)


def test_the_noise_of_a_prediction_is_the_fast_slip_to_come():
    ekf = some_ekf()
    model, density = ekf.twist_model(0.2, 0.6), np.diag([1e-6, 2e-6, 3e-4])
    pose = pose_ahead(ekf.x, model, density, 0.01)
    assert pose.R.diagonal().sum() == pytest.approx(1e-2 * np.trace(density), rel=1e-3)
    twist = twist_ahead(ekf.x, model, density, 0.01)
    assert pytest.approx(density / 0.01) == twist.R
    without = model.twist - ekf.x[s.FAST_SLIP]
    assert twist.values == pytest.approx(without, abs=1e-12)
    assert (pose_now(ekf.x).R == 0.0).all()
    velocity = BodyVelocity(EPOCH, 0.2, 0.0, 0.5)
    assert np.diag(MODELS[BodyVelocity].linearise(velocity, twist).R) == pytest.approx(
        [0.5 + 1e-4, 0.5 + 2e-4]
    )


def test_without_an_imu_to_wait_for_the_estimate_goes_to_the_fix():
    estimator = PoseEstimator(ALPHA)
    for k in range(200):
        estimator.feed(TrackSpeeds(EPOCH + k * STEP, 0.3, 0.3))
        estimator.feed(ImuSample(EPOCH + k * STEP, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
    later = estimator.stamp + 10 * STEP
    assert estimator.feed(PositionFix(later, estimator.pose[0] + 0.03, 0.0, 1e-2))
    assert estimator.stamp == later
