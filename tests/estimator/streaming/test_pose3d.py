"""Height, roll and pitch: of a state, over hills, and by fixes of the height."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from icreckon import (
    HeightFix,
    Imu,
    ImuSample,
    PoseEstimator,
    Scenario,
    Slope,
    Terrain,
    TrackSpeeds,
    load_robot,
    run,
)
from icreckon.estimator.base import state as s
from icreckon.estimator.base.frames import quaternion_to_rpy, rpy_to_quaternion
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.motion.pose3d import pose3d_of
from icreckon.estimator.sensors.measurement_models import WITH_HEIGHT
from icreckon.simulation.simulate import simulate

ROBOT = load_robot("husky")
HILLS = Terrain(rolling_deg=8.0, slope_deg=3.0, uphill_deg=70.0)
RUNS, STEP = 12, 10_000_000


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.3, -0.2, 7.0), (-0.4, 0.5, -2.0)])
def test_attitude_is_that_of_gravity_and_yaw(rpy: tuple[float, float, float]) -> None:
    turn, x = Rotation.from_euler("xyz", rpy), np.zeros(s.SIZE)
    x[s.GRAVITY] = turn.inv().apply([0.0, 0.0, -GRAVITY])[:2]
    x[s.YAW] = rpy[2]
    found = pose3d_of(x, np.eye(s.SIZE))
    assert found.rpy == pytest.approx(rpy, abs=1e-12)
    assert Rotation.from_quat(found.quaternion).as_matrix() == pytest.approx(turn.as_matrix())
    assert np.cos(quaternion_to_rpy(found.quaternion) - rpy) == pytest.approx(1.0)
    assert rpy_to_quaternion(*np.array([rpy, rpy]).T).shape == (2, 4)


def test_its_covariance_is_by_the_derivatives() -> None:
    rng = np.random.default_rng(3)
    root, x = rng.normal(size=(s.SIZE, s.SIZE)), rng.normal(size=s.SIZE)

    def vector(state: np.ndarray) -> np.ndarray:
        found = pose3d_of(state, np.eye(s.SIZE))
        return np.concatenate([found.position, found.rpy])

    steps = 1e-6 * np.eye(s.SIZE)
    jacobian = np.array([(vector(x + one) - vector(x - one)) / 2e-6 for one in steps]).T
    P = root @ root.T
    assert pose3d_of(x, P).covariance == pytest.approx(jacobian @ P @ jacobian.T, rel=1e-6)


def test_errors_over_hills_are_as_the_filter_predicts() -> None:
    """Height at the end and mean tilt of each run, by their own standard deviations."""
    heights, tilts, moved = [], [], []
    for seed in range(RUNS):
        log = simulate(
            Scenario(duration=60.0, seed=seed, trajectory="random", terrain=HILLS), ROBOT
        )
        one, poses = run(replace(log, truth=None), ROBOT, "inertia-online"), log.truth.poses
        true = np.column_stack(
            [np.interp(one.stamps, poses.stamps, column) for column in poses.spatial.T]
        )
        path = one.trajectory
        off = path.spatial - true
        heights.append((off[-1, 0] / path.spatial_sigmas[-1, 0]) ** 2)
        tilts.append(((off[-1, 1:] / path.spatial_sigmas[-1, 1:]) ** 2).sum())
        moved.append([np.abs(off[-1, 0]), np.ptp(true[:, 0])])
        settled = one.stamps > one.stamps[0] + 10**10
        assert np.degrees(np.sqrt(np.mean(off[settled, 1:] ** 2))) < 1.5
    # The prior of slopes and biases is wider than this robot's: errors may be smaller, not larger.
    assert sum(heights) < chi2.ppf(0.999, RUNS)
    assert sum(tilts) < chi2.ppf(0.999, 2 * RUNS)
    errors, ranges = np.array(moved).T
    assert np.sqrt(np.mean(errors**2)) < 0.2 * np.sqrt(np.mean(ranges**2))


def uphill(seconds: float) -> PoseEstimator:
    """Drive straight up a plane of 10°, at 0.5 m/s, with an IMU without bias."""
    imu = Imu(gyro_noise_density=0.001, accelerometer_noise_density=0.01)
    wide = Slope(sigma=3.0)
    robot, slope = msgspec.structs.replace(ROBOT, imu=imu, slope=wide), np.radians(10.0)
    estimator = PoseEstimator(robot)
    force = (GRAVITY * np.sin(slope), 0.0, GRAVITY * np.cos(slope))
    for k in range(round(100 * seconds)):
        estimator.feed(TrackSpeeds(k * STEP, 0.5, 0.5))
        estimator.feed(ImuSample(k * STEP, (0.0, 0.0, 0.0), force))
    return estimator


def test_the_height_is_that_of_the_path_and_its_slope() -> None:
    before, after = uphill(10.0).pose3d, uphill(20.0).pose3d
    x, _, z = after.position - before.position
    assert z / x == pytest.approx(np.tan(np.radians(10.0)), rel=0.01)
    assert np.hypot(x, z) == pytest.approx(5.0, rel=1e-3)
    assert np.degrees(after.rpy) == pytest.approx([0.0, -10.0, 0.0], abs=0.1)


def test_a_height_corrects_height_and_slope_but_not_the_place() -> None:
    estimator = uphill(20.0)
    before, P = estimator.state, estimator.covariance
    stamp = estimator.stamp
    # The first one sets the height.
    assert estimator.feed(HeightFix(stamp, 312.0, 0.04))
    assert estimator.pose3d.position[2] == pytest.approx(312.0, abs=0.3)
    assert estimator.pose3d.covariance[2, 2] < 0.041
    assert estimator.feed(HeightFix(stamp + STEP, estimator.state[s.Z] - 0.5, 0.0001))
    after, fixed = estimator.state, [i for i in range(s.SIZE) if i not in WITH_HEIGHT]
    assert estimator.pose3d.position[2] < 311.8
    for state in set(fixed) - {s.X, s.SLIP_X, *range(s.FAST_SLIP.start, s.FAST_SLIP.stop)}:
        assert after[state] == pytest.approx(
            before[state], abs=1e-6 + 1e-3 * np.sqrt(P[state, state])
        )
    # One that is far off is rejected, and counted.
    assert not estimator.feed(HeightFix(stamp + 2 * STEP, 350.0, 0.01))
    assert estimator.health.rejections() == {"height: gate": 1}


def test_rates_of_roll_and_pitch_are_in_the_twist() -> None:
    estimator = uphill(2.0)
    stamp = estimator.stamp
    estimator.feed(TrackSpeeds(stamp + STEP, 0.5, 0.5))
    estimator.feed(ImuSample(stamp + STEP, (0.2, -0.1, 0.0), (0.0, 0.0, GRAVITY)))
    twist = estimator.twist3d
    assert twist.linear[:2] == pytest.approx(estimator.twist[:2])
    assert twist.angular == pytest.approx([0.2, -0.1, estimator.twist[2]], abs=0.02)
    assert (twist.covariance.diagonal()[[0, 1, 3, 4, 5]] > 0.0).all()
    z_only = msgspec.structs.replace(ROBOT, imu=Imu(gyro_axes="z"))
    alone = PoseEstimator(z_only, "gyro")
    alone.feed(TrackSpeeds(0, 0.5, 0.5))
    alone.feed(ImuSample(STEP, (0.0, 0.0, 0.0)))
    assert np.isnan(alone.twist3d.angular[:2]).all()
    # A slope is not estimated: it stays as uncertain as it was.
    assert np.degrees(np.sqrt(alone.pose3d.covariance[4, 4])) == pytest.approx(2.9, abs=0.1)
