"""Whether the filter is as sure as it may be: NEES and NIS over simulated runs of the model itself.

Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.
"""

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

from conftest import thorough
from icreckon import PoseEstimator, Scenario, Settings, load_robot, pose_nees, run, simulate
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.reference.filter import ReferenceFilter
from icreckon.estimator.reference.imu import accelerometer
from icreckon.estimator.robot.robot_file import Indices
from icreckon.estimator.sensors import held_tracks, sensor_models, step_inputs
from icreckon.estimator.sensors.measurement_models import ACCELEROMETERS
from icreckon.simulation.truth.true_motion import TRUE_SLIP

ALPHA = load_robot("auriga-alpha")
RUNS = 8
SCENARIO = Scenario(
    duration=60.0,
    seed=7,
    trajectory="random",
    truth="kinematic",
    truth_spread=0.0,
    track_rate=25.0,
    imu_rate=50.0,
    truth_rate=5.0,
)


# Track speeds and IMU in step: an error of the track speeds is then new with each IMU sample, which is
# what the filter takes it for whatever the rates.
IN_STEP = msgspec.structs.replace(SCENARIO, track_rate=50.0)


def runs(scenario, variant, settings=None):
    """NEES (RUNS, n) after the first 10 s, and the sums of the sensors' health over all runs.

    At first the pose is known to a fraction of a millimetre, better than the track speeds are timed.
    """
    nees, nis, degrees = [], {}, {}
    for index in range(RUNS):
        log = simulate(scenario, ALPHA, run_index=index)
        result = run(log, ALPHA, variant, settings=settings)
        nees.append(pose_nees(result.trajectory, log.truth.poses)[50:])
        for name, sensor in result.health.sensors.items():
            nis[name] = nis.get(name, 0.0) + sensor.nis_sum
            degrees[name] = degrees.get(name, 0) + sensor.degrees
    shortest = min(map(len, nees))
    return np.array([one[:shortest] for one in nees]), nis, degrees


# The simulated slip has no white part.
SLIP = msgspec.structs.replace(TRUE_SLIP, white_time=0.0)


def test_pose_and_innovations_of_the_shipped_filter_are_as_uncertain_as_it_says():
    nees, nis, degrees = runs(SCENARIO, "inertia-online")
    # Pose errors under fixes once a second are correlated over some 10 s: 5 independent samples a run.
    # Above, the mean of so many chi-square variables of 3 degrees; below, half: the filter expects more
    # slip than this simulation has, and may be careful, but not much.
    spread = np.sqrt(6.0 / (5 * RUNS))
    assert 1.5 < nees.mean() < 3.0 + 3.0 * spread
    # No run of its own is far too sure: the mean of 5 such variables, once in a thousand for each.
    assert nees.mean(axis=1).max() < chi2.isf(1e-3, 15) / 5
    # Innovations are no larger than expected ...
    assert nis["position"] < chi2.isf(0.005, degrees["position"])
    # ... nor smaller by a fifth: then fixes would say too little.
    assert nis["position"] > 0.8 * degrees["position"]
    for sensor in ("gyro", *ACCELEROMETERS):
        assert nis[sensor] < 1.5 * degrees[sensor]


def test_innovations_are_white_noise_as_large_as_expected_when_the_slip_is_known():
    _, nis, degrees = runs(IN_STEP, "inertia-fixed", Settings(slip=SLIP))
    low, high = chi2.interval(0.99, degrees["position"])
    assert low < nis["position"] < high
    # Some 45000 samples: statistics leave 0.01. The rest is for the track speeds, which come late by an
    # amount that only a bound is known of.
    assert nis["gyro"] / degrees["gyro"] == pytest.approx(1.0, abs=0.15)
    # Their predictions count as doubtful in turns, whatever the slip (next test).
    for sensor in ACCELEROMETERS:
        assert nis[sensor] < 1.05 * degrees[sensor]


@pytest.mark.parametrize("averaging", [0.05, thorough(held_tracks.ACCELERATION_AVERAGING)])
def test_innovations_of_accelerometers_are_as_large_as_expected_without_that_doubt(
    averaging: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the textbook, which a test holds the filter to: some 6000 samples, statistics leave 0.02."""
    robot = msgspec.structs.replace(ALPHA, slip={"inertia-fixed": SLIP})
    squares: list[list[float]] = [[], []]

    def judged(imu, axis, force, at, x, density):
        found = accelerometer(imu, axis, force, at, x, density)
        S = found.H @ textbook.ekf.P @ found.H.T + found.R
        squares[axis].append((found.z @ np.linalg.solve(S, found.z)).item())
        return found

    monkeypatch.setattr(sensor_models, "CENTRIPETAL_DOUBT", 0.0)
    for module in (held_tracks, step_inputs):
        monkeypatch.setattr(module, "ACCELERATION_AVERAGING", averaging)
    monkeypatch.setattr("icreckon.estimator.reference.filter.accelerometer", judged)
    for index in range(2):
        textbook = ReferenceFilter(robot, "inertia-fixed")
        for m in simulate(IN_STEP, ALPHA, run_index=index).measurements():
            textbook.take(m)
    means = np.mean(squares, axis=1)
    if averaging == 0.05:
        assert means == pytest.approx([1.0, 1.0], abs=0.05)
    # A longer average is later, and innovations are 7 % larger than expected.
    assert means.max() < 1.1


@pytest.mark.parametrize(
    ("variant", "imu_rate"), [("gyro", 100.0), ("inertia-online", 100.0), ("inertia-online", 25.0)]
)
def test_a_turn_over_a_second_is_as_uncertain_as_the_gyro_whatever_its_rate(variant, imu_rate):
    scaled, second = [], 10**9
    for index in range(3):
        scenario = msgspec.structs.replace(SCENARIO, imu_rate=imu_rate, fix_rate=0.0)
        log = simulate(scenario, ALPHA, run_index=index)
        poses = log.truth.poses
        true = dict(zip(poses.stamps.tolist(), poses.poses[:, 2].tolist(), strict=True))
        estimator, scans = PoseEstimator(ALPHA, variant), iter(range(5, 59))
        scan = log.start + next(scans) * second
        for measurement in log.measurements():
            estimator.feed(measurement)
            if measurement.stamp < scan + second // 10:
                continue
            estimator.mark(scan)
            if scan - second in estimator.marks:
                motion = estimator.relative_motion(scan - second, scan)
                error = wrap_angle(true[scan] - true[scan - second] - motion.pose[2])
                scaled.append(error / np.sqrt(motion.covariance[2, 2]))
                estimator.forget(scan - second)
            scan = log.start + next(scans, 10**6) * second
    # 156 turns; their errors share a bias and a scale.
    assert len(scaled) > 150
    assert 0.8 < np.sqrt(np.mean(np.square(scaled))) < 1.25


@pytest.mark.parametrize("seed", [0, 2])
def test_a_fast_robot_turns_as_its_gyro_reads(seed):
    """Bends at 0.7 times the weight: a prior of eta2 for slow robots let the tracks decide."""
    robot = msgspec.structs.replace(load_robot("jackal"), indices=Indices(eta0=1.49))
    log = simulate(Scenario(duration=40.0, seed=seed, fix_rate=0.0, truth_rate=50.0), robot)

    def largest_error(variant):
        twists = run(log, robot, variant).trajectory.twists
        return np.abs(twists[:, 2] - log.truth.twists.twists[:, 2]).max()

    assert largest_error("inertia-online") < 1.2 * largest_error("gyro")
