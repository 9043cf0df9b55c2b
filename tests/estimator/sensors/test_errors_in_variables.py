"""Noise in the track speeds must not teach the filter wrong parameters: what is smoothed for that."""

import msgspec
import numpy as np
import pytest

from icreckon.estimator.base import state as s
from icreckon.estimator.base.records import assign, plain_copy
from icreckon.estimator.engine.constants import REGRESSOR_SMOOTHING
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.log.measurements import ImuSample, TrackSpeeds
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant, slip_of
from icreckon.estimator.sensors.held_tracks import (
    SMOOTHING,
    TrackRecord,
    smoothing_share,
    take_tracks,
)
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

ALPHA = load_robot("auriga-alpha")
SECOND = 1_000_000_000
SETTINGS = input_settings(ALPHA, Settings())


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


def test_smoothed_speeds_are_remembered():
    tracks, other = held([(0.2, 0.3), (0.5, 0.1)], 50), TrackRecord()
    assign(other, plain_copy(TrackRecord, tracks))
    assert smooth(other) == smooth(tracks)


def test_slip_is_as_large_as_the_smoothed_speeds_make_it():
    disturbances = Disturbances(
        ALPHA, slip_of(ALPHA, find_variant("inertia-online")), np.zeros(s.PARAMETER_COUNT)
    )
    noisy = held([(0.2, 0.6)] * 50 + [(0.1, 0.8)], 400)
    steady = held([smooth(noisy)], 400)
    sizes = [disturbances.slip_sigma(one, 1.5, pushed=False) for one in (noisy, steady)]
    assert sizes[0] == sizes[1]


def test_derivatives_by_the_parameters_follow_those_of_the_moment():
    ekf = IcrEkf(LaggedIndexMotion(ALPHA.constants))
    ekf.x[s.PARAMETERS] = ALPHA.indices.as_array()
    before, now = (ekf.twist_model(*speeds) for speeds in ((0.2, 0.6), (0.3, 0.4)))
    # At the first step they are those of the moment, from the next on they lag.
    ekf.smooth_regressors(0.02, 0.2, 0.6)
    assert (ekf.twist_model(0.2, 0.6).jacobian == before.jacobian).all()
    ekf.smooth_regressors(0.02, 0.3, 0.4)
    smoothed = ekf.twist_model(0.3, 0.4)
    share = smoothing_share(0.02, REGRESSOR_SMOOTHING)
    of_both = (1.0 - share) * before.jacobian + share * now.jacobian
    of_parameters = np.zeros(s.SIZE, dtype=bool)
    of_parameters[s.PARAMETERS] = True
    expected = np.where(of_parameters, of_both, now.jacobian)
    assert smoothed.jacobian == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert (smoothed.twist == now.twist).all()
    assert (smoothed.by_speeds == now.by_speeds).all()


def test_noise_at_a_high_rate_teaches_no_wrong_parameter():
    # Without slip, and with a gyro that is good, the mean error of eta0 is that of errors in variables.
    rate, density, errors = 400, ALPHA.tracks.speed_noise_density, []
    imu = msgspec.structs.replace(ALPHA.imu, gyro_bias_sigma=1e-4)
    robot = msgspec.structs.replace(ALPHA, imu=imu)
    icr_width = (
        PoseEstimator(robot, "constant-online").parameters["eta0"] * robot.vehicle.track_gauge
    )
    for seed in range(3):
        rng = np.random.default_rng(seed)
        estimator = PoseEstimator(
            robot, "constant-online", settings=Settings(use_accelerometer=False)
        )
        for k in range(20 * rate):
            stamp, phase = k * SECOND // rate, 0.5 * k / rate
            left, right = 0.4 + 0.2 * np.sin(phase), 0.4 - 0.2 * np.cos(phase)
            noise = density * np.sqrt(rate) * rng.normal(size=2)
            estimator.feed(TrackSpeeds(stamp, left + noise[0], right + noise[1]))
            w = (right - left) / icr_width
            w += robot.imu.gyro_noise_density * np.sqrt(rate) * rng.normal()
            # The first step begins with the first track speeds.
            if k:
                estimator.feed(ImuSample(stamp, (0.0, 0.0, w)))
        start = PoseEstimator(robot, "constant-online").state[s.ETA0]
        sigma = np.sqrt(estimator.covariance[s.ETA0, s.ETA0])
        errors.append((estimator.state[s.ETA0] - start) / sigma)
    assert abs(np.mean(errors)) < 0.3
