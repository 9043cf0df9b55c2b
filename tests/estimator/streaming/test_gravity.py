"""Robots on slopes: what of gravity, biases and radii the filter finds, and what it cannot tell apart."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from icreckon import VARIANTS, PoseEstimator, Scenario, Terrain, run, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import compose
from icreckon.estimator.log.measurements import HeadingFix, ImuSample, PoseFix, TrackSpeeds
from icreckon.estimator.log.scores import pose_nees
from icreckon.estimator.motion.icr import IndexValues, direct
from icreckon.estimator.robot.robot_file import Indices, changed_robot, load_robot
from icreckon.simulation.truth.true_motion import exponential

ALPHA = load_robot("auriga-alpha")
# Constant ICRs, whatever the variant; gains that are all zero would be those of Coulomb friction.
CONSTANT = msgspec.structs.replace(
    ALPHA,
    indices=Indices(zeta0=0.05, epsilon0=0.1, eta0=2.5, eta2=1e-30, epsilon_F=0.0),
    constant_icr=None,
)
INDICES = IndexValues(0.05, 0.1, 2.5)
EPOCH = 1_700_000_000_000_000_000
DT = 0.02
GRAVITY, BIAS, GYRO_BIAS = np.array([1.0, -0.6]), np.array([0.05, -0.08]), 0.008
FIX_SIGMA = 0.02


def driven(
    estimator: PoseEstimator,
    speeds: Floats,
    *,
    gravity: Floats = GRAVITY,
    difference: float = 0.0,
    fix_every: int = 0,
) -> Floats:
    """Feed a drive of constant ICRs on a plane slope; returns the true pose at its end."""
    rng, robot = np.random.default_rng(0), estimator.robot
    pose, down = np.zeros(3), np.array(gravity)
    estimator.feed(TrackSpeeds(EPOCH, *speeds[0].tolist()))
    gyro, force = (
        density / np.sqrt(DT)
        for density in (robot.imu.gyro_noise_density, robot.imu.accelerometer_noise_density)
    )
    for k, (left, right) in enumerate(speeds.tolist(), start=1):
        stamp = EPOCH + round(k * DT * 1e9)
        rightward, v_x, w = direct(left, right, INDICES, robot.vehicle.track_gauge)
        twist = np.array([v_x, -rightward, w])
        along = [-w * twist[1], w * twist[0]] - down + BIAS + force * rng.normal(size=2)
        measured = left / (1.0 - 0.5 * difference), right / (1.0 + 0.5 * difference)
        estimator.feed(TrackSpeeds(stamp, *measured))
        rate = float(w + GYRO_BIAS + gyro * rng.normal())
        estimator.feed(ImuSample(stamp, (0.0, 0.0, rate), (*along.tolist(), 9.7)))
        pose = compose(pose, exponential(twist[None] * DT)[0])
        turned = np.array([[np.cos(w * DT), np.sin(w * DT)], [-np.sin(w * DT), np.cos(w * DT)]])
        down = turned @ down
        if fix_every and k % fix_every == 0:
            noisy = pose + FIX_SIGMA * rng.normal(size=3)
            estimator.feed(PoseFix(stamp, *noisy.tolist(), np.eye(3) * FIX_SIGMA**2))
    return pose


@pytest.mark.parametrize("variant", ["inertia-online", "constant-online"])
def test_standing_on_a_slope_shows_gravity_less_bias_and_the_gyros_bias(variant: str) -> None:
    estimator = PoseEstimator(CONSTANT, variant)
    driven(estimator, np.zeros((1500, 2)))
    assert estimator.stands
    assert np.abs(estimator.pose).max() < 0.02
    sigma = np.sqrt(np.diagonal(estimator.covariance))
    assert abs(estimator.biases["gyro_bias"] - GYRO_BIAS) < 4.0 * sigma[s.GYRO_BIAS] < 4e-3
    for axis in range(2):
        gravity, bias = s.GRAVITY_X + axis, s.ACCELEROMETER_BIAS_X + axis
        row = np.zeros(s.SIZE)
        row[[gravity, bias]] = 1.0, -1.0
        together = float(np.sqrt(row @ estimator.covariance @ row))
        assert together < 0.01
        assert abs(row @ estimator.state - (GRAVITY - BIAS)[axis]) < 4.0 * together
        # Which of them it is, a standing robot does not show.
        assert sigma[gravity] > 0.5 * ALPHA.imu.accelerometer_bias_sigma
        assert sigma[bias] > 0.5 * ALPHA.imu.accelerometer_bias_sigma


@pytest.mark.parametrize("axes", ["z", "xyz"])
def test_turning_on_a_slope_tells_gravity_from_bias(axes: str) -> None:
    """To both sides: in a steady turn, biases of roll and pitch rate look like those of the forces."""
    estimator = PoseEstimator(changed_robot(CONSTANT, {"imu.gyro_axes": axes}), "constant-online")
    speeds = np.concatenate([np.tile([-0.2, 0.4], (3000, 1)), np.tile([0.4, -0.2], (1000, 1))])
    end = driven(estimator, speeds, fix_every=50)
    assert abs(end[2]) > 4.0 * np.pi
    sigma = np.sqrt(np.diagonal(estimator.covariance))
    cos, sin = np.cos(end[2]), np.sin(end[2])
    down = np.array([[cos, sin], [-sin, cos]]) @ GRAVITY
    for axis in range(2):
        bias, gravity = s.ACCELEROMETER_BIAS_X + axis, s.GRAVITY_X + axis
        assert sigma[bias] < 0.3 * ALPHA.imu.accelerometer_bias_sigma
        assert abs(estimator.state[bias] - BIAS[axis]) < 4.0 * sigma[bias]
        assert abs(estimator.state[gravity] - down[axis]) < 4.0 * sigma[gravity]


def test_a_fix_that_turns_the_yaw_leaves_gravity_in_base_link() -> None:
    """Gravity is known in the robot's axes; where north is says nothing of it."""
    estimator = PoseEstimator(CONSTANT, "constant-online", start_sigma=(0.0, 0.0, 1.0))
    driven(estimator, np.tile([0.3, 0.5], (300, 1)))
    before = estimator.state
    assert estimator.feed(HeadingFix(estimator.stamp or 0, float(before[s.YAW]) + 0.9, 1e-4))
    after, sigma = estimator.state, np.sqrt(np.diagonal(estimator.covariance))
    assert after[s.YAW] - before[s.YAW] == pytest.approx(0.9, abs=0.02)
    moved = np.abs(after - before)[s.GRAVITY] / sigma[s.GRAVITY]
    assert moved.max() < 0.05


@pytest.mark.parametrize(
    ("variant", "difference"), [("constant-online", 0.04), ("inertia-online", -0.03)]
)
def test_radii_that_differ_are_learnt(variant: str, difference: float) -> None:
    estimator = PoseEstimator(changed_robot(CONSTANT, {"tracks.difference_sigma": 0.05}), variant)
    t = DT * np.arange(3000)
    forward = 0.5 + 0.4 * np.sin(0.2 * t)
    speeds = forward[:, None] + 0.15 * np.sin(0.5 * t)[:, None] * [-1.0, 1.0]
    driven(estimator, speeds, gravity=np.zeros(2), difference=difference, fix_every=50)
    sigma = np.sqrt(estimator.covariance[s.TRACK_DIFFERENCE, s.TRACK_DIFFERENCE])
    assert sigma < 0.3 * 0.05
    assert abs(estimator.state[s.TRACK_DIFFERENCE] - difference) < 4.0 * sigma
    assert estimator.state[s.TRACK_DIFFERENCE] * difference > 0.0


def test_the_robot_file_gives_the_first_values() -> None:
    tracks = {"tracks.difference": 0.02, "tracks.difference_sigma": 0.003}
    robot = changed_robot(ALPHA, {**tracks, "imu.gyro_bias": -0.004, "slope.sigma": 0.7})
    for variant in VARIANTS:
        estimator = PoseEstimator(robot, variant)
        sigma = np.sqrt(np.diagonal(estimator.covariance))
        assert estimator.state[s.TRACK_DIFFERENCE] == 0.02
        assert estimator.biases["gyro_bias"] == -0.004
        assert sigma[s.TRACK_DIFFERENCE] == pytest.approx(0.003)
        assert sigma[s.GRAVITY] == pytest.approx([0.7, 0.7])
        assert not estimator.state[s.GRAVITY].any()
        # Of the same measured speed, the right track is the faster one.
        estimator.feed(TrackSpeeds(EPOCH, 0.5, 0.5))
        estimator.feed(TrackSpeeds(EPOCH + 500_000_000, 0.5, 0.5))
        assert estimator.twist[2] > 0.0


@pytest.mark.parametrize("eta0", [2.6, 1.02])
def test_a_gyro_alone_teaches_no_gravity(eta0: float) -> None:
    """Neither does a bound of eta that is met: it would take the model's errors for slopes."""
    robot = changed_robot(ALPHA, {"indices.eta0": eta0})
    log = simulate(Scenario(duration=40.0, seed=3, terrain=Terrain(slope_deg=6.0)), ALPHA)
    gyro_alone = replace(log, fixes=None, imu=replace(log.imu, linear_acceleration=None))
    found = run(gyro_alone, robot, "inertia-online")
    assert np.abs(found.states[:, s.GRAVITY]).max() < 1e-12
    assert found.state_sigmas[-1, s.GRAVITY] == pytest.approx(ALPHA.slope.sigma, rel=0.1)


def test_level_ground_stays_level_whatever_the_gyros_show() -> None:
    level = changed_robot(ALPHA, {"slope.sigma": 0.0})
    log = simulate(Scenario(duration=20.0, seed=3, terrain=Terrain(rolling_deg=5.0)), ALPHA)
    found = run(log, level, "inertia-online")
    assert (found.states[:, s.GRAVITY] == 0.0).all()


@pytest.mark.parametrize(
    ("rates", "change"), [((0.0, 0.1, 0.0), (1, 0)), ((0.1, 0.0, 0.0), (0, -1))]
)
def test_roll_and_pitch_rates_turn_gravity(
    rates: tuple[float, float, float], change: tuple[int, int]
) -> None:
    """A nose that sinks shows a slope that falls ahead; a left side that rises one that falls right."""
    blind = {"accelerometer_noise_density": 1000.0, "gyro_bias": 0.0, "gyro_bias_sigma": 0.0}
    robot = msgspec.structs.replace(ALPHA, imu=msgspec.structs.replace(ALPHA.imu, **blind))
    estimator = PoseEstimator(robot, "inertia-online")
    for k in range(201):
        estimator.feed(TrackSpeeds(EPOCH + k * 10_000_000, 0.4, 0.4))
        estimator.feed(ImuSample(EPOCH + k * 10_000_000, rates, (0.0, 0.0, 9.81)))
    expected = 9.81 * np.sin(0.2) * np.array(change)
    assert estimator.state[s.GRAVITY] == pytest.approx(expected, abs=0.02)
    # The way is seen from above: half of a turn of 0.2 rad is climbed on average.
    along = 0.8 * np.sin(0.2) / 0.2 if change[0] else 0.8
    assert estimator.pose[0] == pytest.approx(along, abs=0.02)


@pytest.mark.parametrize("axes", ["z", "xyz"])
def test_a_yaw_gyro_alone_misses_the_pitch_of_a_robot_that_leans(axes: str) -> None:
    """Yaw rate is pitch rate times up_y / (up_y² + up_z²), and gravity's random walk is pitch."""
    variances, by_walk = [], 0.0
    for walk in (0.0, 0.6):
        changes = {"imu.gyro_axes": axes, "slope.sigma": 1.7, "slope.walk": walk}
        estimator = PoseEstimator(changed_robot(ALPHA, changes), "inertia-online")
        by_walk = 0.0
        for k in range(2000):
            estimator.feed(TrackSpeeds(EPOCH + k * 10_000_000, 0.4, 0.4))
            force = 9.81 * np.array((0.0, np.sin(0.17), np.cos(0.17)))
            estimator.feed(ImuSample(EPOCH + k * 10_000_000, (0.0, 0.0, 0.0), tuple(force)))
            up_x, up_y = estimator.state[s.GRAVITY] / -9.81
            factor = up_y / (1.0 - up_x**2) / np.sqrt(1.0 - up_x**2 - up_y**2) / 9.81
            by_walk += 0.004 * (walk * factor) ** 2  # of 4 mm of travel
        variances.append(estimator.pose_covariance[2, 2])
    missed = by_walk if axes == "z" else 0.0
    assert variances[1] - variances[0] == pytest.approx(missed, rel=0.03, abs=1e-6)


def test_biases_of_roll_and_pitch_rate_are_learnt() -> None:
    """On rolling ground; so they change the slope little."""
    log = simulate(Scenario(duration=60.0, seed=3, terrain=Terrain(rolling_deg=8.0)), ALPHA)
    more = np.array([0.004, -0.004])
    biased = log.imu.angular_velocity + np.append(more, 0.0)
    ends = [
        run(replace(log, imu=replace(log.imu, angular_velocity=rates)), ALPHA, "inertia-online")
        for rates in (log.imu.angular_velocity, biased)
    ]
    plain, other = (one.states[-1] for one in ends)
    biases = [s.GYRO_BIAS_X, s.GYRO_BIAS_Y]
    assert other[biases] - plain[biases] == pytest.approx(more, abs=0.001)
    assert other[s.GRAVITY] == pytest.approx(plain[s.GRAVITY], abs=0.05)


@pytest.mark.slow
def test_a_z_gyro_on_hills_needs_the_slopes_of_the_hills() -> None:
    """Marmotte's gyro leans by 10 degrees: roll rates of the body appear in its reading, too."""
    robot = load_robot("marmotte")
    hilly = changed_robot(robot, {"slope.sigma": 1.7, "slope.walk": 0.6})
    nees: dict[str, list[float]] = {"gentle": [], "hilly": []}
    for seed in range(4):
        scenario = Scenario(
            duration=160.0,
            seed=seed,
            noise="industrial",
            outages=((60.0, 160.0),),
            terrain=Terrain(rolling_deg=10.0),
        )
        log = simulate(scenario, robot)
        assert log.truth is not None
        after_fixes = [(log.start + 70 * 10**9, log.end)]
        for name, file in (("gentle", robot), ("hilly", hilly)):
            trajectory = run(log, file, "inertia-online").trajectory
            values = pose_nees(trajectory, log.truth.poses, within=after_fixes)
            nees[name].append(float(values.mean()))
    # 3 is ideal.
    assert np.mean(nees["hilly"]) < 3.0 < 6.0 < np.mean(nees["gentle"])
