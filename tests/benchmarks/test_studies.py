"""What the studies in benchmarks/ are made of: intervals, recovery, noise at several rates."""

import adaptation
import consistency
import long_run
import numpy as np
import pytest
import step_size
from _friction import seconds_to_return, smooth
from _study import bootstrap, mean_interval, spread, told

from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import PositionFix
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

ALPHA = load_robot("auriga-alpha")


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(Scenario(duration=80.0, seed=3, track_rate=10.0, imu_rate=20.0), ALPHA)


def test_intervals_hold_the_mean_at_the_rate_they_say():
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(400):
        _, low, high = mean_interval(rng.normal(5.0, 2.0, 50))
        inside.append(low < 5.0 < high)
    # 95 %, less a per cent for the normal instead of Student's distribution, within 4 sigma.
    assert np.mean(inside) == pytest.approx(0.945, abs=4.0 * np.sqrt(0.05 / 400))


def test_bootstrap_is_about_the_statistic_of_all_runs():
    samples = np.random.default_rng(2).normal(1.0, 0.1, (30, 1))
    value, low, high = bootstrap(lambda x: x[..., 0].mean(-1), samples)
    assert value == pytest.approx(samples.mean())
    assert low < value < high
    assert told(value, low, high, ".1f") == "1.0 (1.0 to 1.0)"


def test_jobs_keep_their_order_in_processes():
    assert spread(abs, [-3, 1, -2], 2) == [3, 1, 2]


def test_smoothing_looks_ahead_and_keeps_the_end():
    assert smooth(np.array([0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 1.0])) == pytest.approx(
        [1.0, 1.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    )


def test_a_curve_is_back_when_it_stays_down():
    curve = np.array([9.0] * 5 + [0.0] * 3 + [9.0] + [0.0] * 20)
    assert seconds_to_return(curve, 1.0) == 9.0
    assert seconds_to_return(curve[:15], 1.0) == np.inf
    assert seconds_to_return(np.zeros(20), 1.0) == 0.0


@pytest.mark.parametrize("name", adaptation.CHANGES)
def test_changes_are_scenarios(name):
    Scenario(duration=20.0, **adaptation.changed(name, 10.0))


def test_predictions_of_the_right_kinematics_are_right(monkeypatch):
    monkeypatch.setattr(adaptation, "DURATION", 20)
    scenario = Scenario(
        duration=20.0, seed=4, truth="kinematic", truth_spread=0.0, slip_noise=0.0, truth_rate=50.0
    )
    log = simulate(scenario, ALPHA)
    result = run(log, ALPHA, "inertia-fixed")
    errors = adaptation.prediction_errors(result, log, ALPHA, "inertia-fixed")
    # Steps of 0.1 s through a metre or two.
    assert errors.max() < 0.01


def test_slower_sensors_see_means_of_the_same_noise():
    quick, slow = (step_size.noisy_log(ALPHA, rate, 0)[0] for rate in (400, 50))
    quiet = [
        simulate(
            Scenario(
                duration=60.0,
                seed=step_size.SEED,
                noise="perfect",
                track_rate=float(rate),
                imu_rate=float(rate),
                outages=((40.0, 60.0),),
            ),
            ALPHA,
        )
        for rate in (400, 50)
    ]
    noise = [
        a.imu.angular_velocity - b.imu.angular_velocity
        for a, b in zip((quick, slow), quiet, strict=True)
    ]
    bias = noise[0][0]
    assert noise[1][1:] - bias == pytest.approx(
        (noise[0][1:] - bias).reshape(-1, 8, 3).mean(axis=1), abs=1e-12
    )
    assert quick.fixes.poses[:, :2] == pytest.approx(slow.fixes.poses[:, :2], abs=1e-4)


def test_nees_of_consistency_is_the_quadratic_form():
    rng = np.random.default_rng(5)
    root = rng.normal(size=(4, 4))
    covariance, error = root @ root.T, rng.normal(size=4)
    expected = error @ np.linalg.inv(covariance) @ error
    assert consistency.nees_of(error, covariance) == pytest.approx(expected)
    # What a gate at 1e-4 takes from the mean of a chi-square variable.
    assert 0.99 < consistency.expected_nis(1) < 1.0


def test_a_matrix_that_is_no_covariance_is_told():
    P = np.diag([1.0, 0.0, 4.0])
    assert long_run.smallest_correlation(P) == pytest.approx(1.0)
    assert long_run.smallest_correlation(-P) == -1.0
    P[0, 2] = 3.0
    assert np.isnan(long_run.smallest_correlation(P))
    P[2, 0] = 3.0
    assert long_run.smallest_correlation(P) == pytest.approx(-0.5)


def test_a_repeated_run_goes_on_from_where_it_was():
    drive = consistency.moving_speeds(ALPHA, "random", 3.0, [1])
    sampler = consistency.ModelSampler(
        ALPHA, consistency.find_variant("constant-online"), consistency.SETTINGS
    )
    once = sampler.run(drive, 1.0 / consistency.RATE, np.random.default_rng(1))
    measurements = list(long_run.repeated(once, 400))
    stamps = [m.stamp for m in measurements]
    assert stamps == sorted(stamps)
    fixes = [(m.x, m.y) for m in measurements if isinstance(m, PositionFix)]
    # At most max_track_speed for a second, and noise.
    assert np.hypot(*np.diff(fixes, axis=0).T).max() < 1.5
    estimator = PoseEstimator(
        ALPHA, "constant-online", settings=Settings(standstill=consistency.SETTINGS.standstill)
    )
    for measurement in measurements:
        estimator.feed(measurement)
    assert not estimator.health.rejections().get("position: gate")
    assert long_run.smallest_correlation(estimator.covariance) > 0.0


SENSIBLE = ("steps of 1 ns", "a gap of 90 s, then on", "gyro at 1e6 rad/s", "fixes 1e9 m off")


@pytest.mark.parametrize("name", SENSIBLE)
def test_extreme_inputs_leave_a_covariance(name):
    estimator, stamp = long_run.start(ALPHA, "inertia-online")
    for measurement in long_run.extremes(stamp)[name][:400]:
        estimator.feed(measurement)
    assert np.isfinite(estimator.state).all()
    assert long_run.smallest_correlation(estimator.covariance) > 0.0


def test_a_shift_of_all_stamps_by_a_microsecond_changes_nothing(log):
    shifted = Log(
        log.name,
        TrackSpeedSeries(log.tracks.stamps + 1000, log.tracks.speeds),
        type(log.imu)(log.imu.stamps + 1000, log.imu.angular_velocity, log.imu.linear_acceleration),
        type(log.fixes)(log.fixes.stamps + 1000, log.fixes.poses, log.fixes.variances),
    )
    finals = [run(one, ALPHA, "inertia-online").states[-1] for one in (log, shifted)]
    assert np.abs(finals[1] - finals[0]).max() < 1e-6
