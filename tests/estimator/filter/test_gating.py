"""Gates: what they admit, and the way back."""

import numpy as np
import pytest
from scipy.stats import chi2

from fed_estimators import known, seconds
from icreckon import BodyVelocity, ImuSample, PoseEstimator, PositionFix, TrackSpeeds, load_robot
from icreckon.estimator.base import state as s
from icreckon.estimator.filter.gate import CHI_SQUARE_1E4, LONGEST_COUNTED, Gate
from icreckon.estimator.filter.health import ADMITTED, REACQUIRED, REJECTED

ALPHA = load_robot("auriga-alpha")


def test_thresholds_are_the_quantiles_of_chi_square():
    for degrees, threshold in CHI_SQUARE_1E4.items():
        assert threshold == pytest.approx(chi2.isf(1e-4, degrees), abs=5e-4)


def test_gate_admits_up_to_its_threshold():
    gate = Gate(2, 10.0)
    assert gate.judge(18.4, 1.0) == ADMITTED
    assert gate.judge(18.5, 1.0) == REJECTED
    assert gate.judge(float("nan"), 1.0) == REJECTED


def test_one_admitted_sample_starts_the_time_again():
    gate = Gate(1, 3.0)
    for nis in (100.0, 100.0, 100.0, 1.0, 100.0, 100.0, 100.0):
        assert gate.judge(nis, 1.0) != REACQUIRED


def test_a_pause_of_the_sensor_and_a_clock_that_was_set_back_count_little():
    gate = Gate(1, 10.0)
    assert gate.interval_to(0) == 0.0
    gate.keep(seconds(100.0), ADMITTED, np.zeros(1), np.eye(1))
    assert gate.interval_to(seconds(100.2)) == pytest.approx(0.2)
    assert gate.interval_to(seconds(500.0)) == LONGEST_COUNTED
    assert gate.interval_to(seconds(50.0)) == 0.0


@pytest.mark.parametrize("hertz", [1, 10])
@pytest.mark.parametrize(("distance", "expected"), [(4.0, 10.0), (12.0, 12.0), (20.0, 20.0)])
def test_wrong_fixes_are_used_after_the_same_time_at_any_rate(hertz, distance, expected):
    """At 1 m/s. Ten rejections in a row were enough, a second at 10 Hz."""
    estimator, wrong = PoseEstimator(ALPHA, "constant-online"), []
    for k in range(350):
        stamp = seconds(0.1 * k)
        estimator.feed(TrackSpeeds(stamp, 0.2, 0.2))
        estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
        if k % (10 // hertz) == 0:
            y = distance if k > 100 else 0.0
            used = estimator.feed(PositionFix(stamp, 0.02 * k, y, 0.0025))
            assert used or y
            wrong += [used] if y else []
    assert wrong.index(True) / hertz == pytest.approx(expected, abs=0.15)
    assert estimator.pose[1] == pytest.approx(distance, abs=0.1)


@pytest.mark.parametrize("hertz", [50, 100, 200])
def test_the_second_rejected_sample_of_the_imu_in_a_row_is_used(hertz):
    """No other sensor replaces the IMU. One wrong sample alone moves nothing."""
    estimator = PoseEstimator(ALPHA, "inertia-online")
    for k in range(4 * hertz):
        stamp, force = seconds(k / hertz), 20.0 if k >= 3 * hertz else 0.0
        estimator.feed(TrackSpeeds(stamp, 0.5, 0.5))
        estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.0), (force, 0.0, 9.81)))
    ahead = estimator.health.sensors["accelerometer_x"]
    assert ahead.reacquired > 0
    assert ahead.rejected["gate"] == ahead.reacquired < 5


def standing_since(rates, speeds=(0.0, 0.0), estimator=None):
    """When an estimator first finds that the robot stands [s], or None; IMU at 100 Hz from 0 s."""
    estimator = estimator or PoseEstimator(ALPHA)
    for k, rate in enumerate(rates):
        if k % 2 == 0:
            estimator.feed(TrackSpeeds(seconds(k / 100), *speeds))
        estimator.feed(ImuSample(seconds(k / 100), (0.0, 0.0, rate)))
        if estimator.stands:
            return k / 100
    return None


def test_robot_stands_after_half_a_second_of_rest():
    estimator = PoseEstimator(ALPHA)
    assert standing_since([0.0] * 100, estimator=estimator) == 0.5
    # Driving on ends it at once.
    estimator.feed(TrackSpeeds(seconds(0.51), 0.3, 0.3))
    estimator.feed(ImuSample(seconds(0.51), (0.0, 0.0, 0.0)))
    assert not estimator.stands


@pytest.mark.parametrize(
    ("rates", "speeds"),
    [
        ([0.0] * 100, (0.0, 0.01)),
        ([0.0] * 100, (-0.01, 0.0)),
        # Pushed round by hand, with the tracks stopped.
        ([0.5] * 100, (0.0, 0.0)),
        # Rocking, once a second.
        ((0.1 * np.sin(2.0 * np.pi * np.arange(100) / 100)).tolist(), (0.0, 0.0)),
    ],
)
def test_what_moves_does_not_stand(rates, speeds):
    assert standing_since(rates, speeds) is None


def test_starts_that_the_tracks_show_late_do_not_become_a_bias_of_the_gyro():
    """IMU at 400 Hz, tracks at 10 Hz: slow starts on the spot moved it by 4 standard deviations."""
    estimator, noise = PoseEstimator(ALPHA, "gyro"), ALPHA.imu.gyro_noise_density * np.sqrt(400)
    rng = np.random.default_rng(0)
    for k in range(80 * 400):
        stamp, in_cycle = seconds(k / 400), k / 400 % 5.03
        yaw_rate = 0.15 * np.clip(in_cycle - 2.0, 0.0, 2.0)
        if k % 40 == 0:
            speed = 0.5 * ALPHA.effective_track * yaw_rate
            estimator.feed(TrackSpeeds(stamp, -speed, speed))
        estimator.feed(ImuSample(stamp, (0.0, 0.0, yaw_rate + noise * rng.normal())))
    sigma = np.sqrt(estimator.covariance[s.GYRO_BIAS, s.GYRO_BIAS])
    assert abs(estimator.state[s.GYRO_BIAS]) < 2.0 * sigma


def test_a_body_velocity_is_used_whole_or_not_at_all():
    """One component beyond all doubt does not let the other in."""
    estimator = PoseEstimator(ALPHA, "constant-online")
    for step in range(100):
        stamp = step * 20_000_000
        estimator.feed(TrackSpeeds(stamp, 0.3, 0.3))
        estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.0)))
    stamp, before = estimator.stamp, known(estimator)
    assert not estimator.feed(BodyVelocity(stamp, 0.3, 5.0, 1e-4))
    assert known(estimator) == before
    assert estimator.feed(BodyVelocity(stamp + 1, 0.3, 0.0, 1e-4))
    counts = estimator.health.sensors["body velocity"]
    assert (counts.used, counts.rejected, counts.degrees) == (1, {"gate": 1}, 2)


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_a_short_fault_leaves_gravity_and_motion_as_they_were(variant: str) -> None:
    """Forty m/s² for 0.4 s, in a bend: long enough for the gate to give in."""
    estimator = PoseEstimator(ALPHA, variant)
    twists = []
    for k in range(1200):
        stamp = k * 10_000_000
        if k % 2 == 0:
            estimator.feed(TrackSpeeds(stamp, 0.3, 0.6))
        v_x, v_y, w = estimator.twist.tolist()
        knocked = 40.0 if 600 <= k < 640 else 0.0
        estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.27), (-w * v_y, w * v_x + knocked, 9.81)))
        twists.append(estimator.twist)
    assert estimator.health.sensors["accelerometer_y"].reacquired > 0
    assert np.hypot(*estimator.state[s.GRAVITY]) < 0.5
    # Some uncertainty of the slip is used to explain it, too.
    assert np.abs(np.array(twists[600:]) - twists[590]).max() < 0.1
    assert estimator.twist == pytest.approx(twists[590], abs=0.02)


@pytest.mark.parametrize("variant", ["gyro", "inertia-online"])
def test_rtk_is_used_at_once_after_it_has_floated(variant: str) -> None:
    """While it floats, its fixes have one error: counted as many, it kept RTK out for ten seconds."""
    estimator = PoseEstimator(ALPHA, variant)

    def drive(start: float, end: float, sigma: float, off: float) -> list[bool]:
        used = []
        for k in range(round(start * 50), round(end * 50)):
            estimator.feed(TrackSpeeds(seconds(k / 50), 0.3, 0.3))
            estimator.feed(ImuSample(seconds(k / 50), (0.0, 0.0, 0.0)))
            if k % 10 == 0:
                fix = PositionFix(seconds(k / 50), 0.3 * k / 50, off, sigma**2)
                used.append(estimator.feed(fix))
        return used

    drive(0.0, 10.0, 0.012, 0.0)
    # One fix in between explains no error of later ones.
    drive(10.0, 10.2, 0.35, 0.6)
    assert not any(drive(10.2, 10.8, 0.012, 0.5))
    drive(10.8, 20.0, 0.012, 0.0)
    drive(20.0, 50.0, 0.35, 0.6)
    assert estimator.state[s.Y] > 0.4
    assert all(drive(50.0, 52.0, 0.012, 0.0))
    assert abs(estimator.state[s.Y]) < 0.02
    assert abs(estimator.state[s.YAW]) < 0.1
