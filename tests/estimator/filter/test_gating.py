"""Gates: what they admit, and the way back."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from icreckon.estimator.filter.gate import CHI_SQUARE_1E4, Gate, inflation
from icreckon.estimator.filter.health import ADMITTED, REACQUIRED, REJECTED
from icreckon.estimator.log.measurements import BodyVelocity, ImuSample, TrackSpeeds
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import GateSettings, Settings
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.sensors.imu_noise import (
    NoiseRecord,
    imu_noise,
    measure_noise,
    measured_noise,
)
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.standstill import (
    QuietReadings,
    StandstillRecord,
    stands,
    stopped_after,
)
from icreckon.estimator.streaming.pose_estimator import PoseEstimator


def test_thresholds_are_the_quantiles_of_chi_square():
    for degrees, threshold in CHI_SQUARE_1E4.items():
        assert threshold == pytest.approx(chi2.isf(1e-4, degrees), abs=5e-4)


def test_gate_admits_up_to_its_threshold():
    gate = Gate(2, GateSettings())
    assert gate.judge(18.4) == ADMITTED
    assert gate.judge(18.5) == REJECTED
    assert gate.judge(float("nan")) == REJECTED


@pytest.mark.parametrize("patience", [1, 3, 10])
def test_after_patience_rejections_the_next_sample_is_taken(patience):
    gate = Gate(1, GateSettings(patience=patience))
    for _ in range(2):
        assert [gate.judge(100.0) for _ in range(patience)] == [REJECTED] * patience
        assert gate.judge(100.0) == REACQUIRED


def test_one_admitted_sample_starts_the_count_anew():
    gate = Gate(1, GateSettings(patience=3))
    for nis in (100.0, 100.0, 100.0, 1.0, 100.0, 100.0, 100.0):
        assert gate.judge(nis) != REACQUIRED


def test_a_state_is_made_as_uncertain_as_the_residual_is_large_but_not_beyond_all_bounds():
    assert inflation(4.0, 0.01) == 4.0
    # Beside what is left, the variance of the measurement must still be seen in double precision.
    assert inflation(1e30, 0.01) + 1e-5 * 0.01 > inflation(1e30, 0.01)


def second(value):
    return round(value * 1e9)


class Detector:
    """Standstill of a filter in Python."""

    def __init__(self, settings):
        self.settings, self.still, self.readings = settings, StandstillRecord(), QuietReadings()
        self.noise = NoiseRecord()

    def track_speeds(self, stamp, left, right):
        stopped_after(self.still, stamp, left, right, self.settings.track_speed)

    def yaw_rate(self, stamp, rate):
        measure_noise(self.noise, stamp, rate, math.nan, math.nan, self.settings.hold)
        noise = measured_noise(self.noise.gyro)
        return self.readings.mean(self.still, stamp, rate, noise, self.settings)


def detector_of(gyro_noise_density):
    settings = input_settings(
        load_robot("auriga-alpha"), Settings(), find_variant("inertia-online")
    )
    settings = settings._replace(gyro_noise_density=gyro_noise_density)
    return Detector(settings)


def standing_since(detector, rates, bias=0.0, bias_sigma=0.0, speeds=(0.0, 0.0)):
    """When the detector first found that the robot stands [s], or None; 100 Hz from 0 s."""
    standstill = Settings().standstill
    for k, rate in enumerate(rates):
        if k % 2 == 0:
            detector.track_speeds(second(k / 100), *speeds)
        mean = detector.yaw_rate(second(k / 100), rate)
        of_mean = imu_noise(detector.noise, True, detector.settings).gyro / standstill.duration
        if stands(mean, bias, bias_sigma**2, of_mean, standstill.bias_margin):
            return k / 100
    return None


def test_robot_stands_after_half_a_second_of_rest():
    assert standing_since(detector_of(5e-4), [0.0] * 100) == 0.5


@pytest.mark.parametrize("hertz", [13.0, 16.0, 30.0, 50.0])
def test_an_engine_does_not_hide_the_standstill(hertz):
    """Its vibration is a hundred times the noise of the file, and the mean is the bias."""
    rates = 0.1 * np.sin(2.0 * np.pi * hertz * np.arange(200) / 100 + 0.3)
    assert standing_since(detector_of(5e-4), rates.tolist()) == 0.5


def test_noise_of_the_gyro_does_not_hide_the_standstill():
    density = 5e-3  # 0.05 rad/s in each of 100 samples per second, more than quiet_gyro
    rates = np.random.default_rng(0).normal(scale=density * 10.0, size=100).tolist()
    assert standing_since(detector_of(density), rates) == 0.5


@pytest.mark.parametrize(
    ("rates", "more"),
    [
        ([0.0] * 100, {"speeds": (0.0, 0.01)}),
        ([0.0] * 100, {"speeds": (-0.01, 0.0)}),
        # Pushed round by hand, with the tracks stopped.
        ([0.2] * 100, {}),
        # Rocking, once a second.
        ((0.1 * np.sin(2.0 * np.pi * np.arange(100) / 100)).tolist(), {}),
    ],
)
def test_what_moves_does_not_stand(rates, more):
    detector = detector_of(5e-4)
    assert standing_since(detector, rates, **more) is None


def test_a_bias_that_may_be_so_large_is_no_motion():
    detector = detector_of(5e-4)
    assert standing_since(detector, [0.2] * 100, bias_sigma=0.06) == 0.5
    detector = detector_of(5e-4)
    assert standing_since(detector, [0.2] * 100, bias=0.19) == 0.5


def test_driving_on_ends_the_standstill_at_once():
    detector = detector_of(5e-4)
    assert standing_since(detector, [0.0] * 100) is not None
    detector.track_speeds(second(1.0), 0.3, 0.3)
    assert np.isnan(detector.yaw_rate(second(1.0), 0.0))
    detector.track_speeds(second(1.02), 0.0, 0.0)
    assert np.isnan(detector.yaw_rate(second(1.02), 0.0))


def test_a_body_velocity_is_used_whole_or_not_at_all():
    """One component beyond all doubt does not let the other in."""
    robot = load_robot("auriga-alpha")
    estimator = PoseEstimator(robot, "constant-online")
    for step in range(100):
        stamp = step * 20_000_000
        estimator.feed(TrackSpeeds(stamp, 0.3, 0.3))
        estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.0)))
    stamp = estimator.stamp
    state, covariance = estimator.state, estimator.covariance
    assert not estimator.feed(BodyVelocity(stamp, 0.3, 5.0, 1e-4))
    assert (estimator.state == state).all()
    assert (estimator.covariance == covariance).all()
    assert estimator.feed(BodyVelocity(stamp + 1, 0.3, 0.0, 1e-4))
    counts = estimator.health.sensors["body velocity"]
    assert (counts.used, counts.rejected, counts.degrees) == (1, {"gate": 1}, 2)
