import msgspec
import numpy as np
import pytest

from estimator.robot import Indices, Slip, load_robot
from simulation.errors import SimulationError
from simulation.sensors import (
    EPOCH,
    GRAVITY,
    NOISE_PRESETS,
    InertialNoise,
    SensorNoise,
    TrackNoise,
    accelerometer_noise,
    gyro_noise,
    noise_preset,
    read_fixes,
    read_imu,
    read_tracks,
    sample_times,
    specific_forces,
    to_stamps,
    track_noise,
)
from simulation.trajectories import make_trajectory
from simulation.truth import KinematicTruth

ALPHA = load_robot("auriga-alpha")
IDEAL = msgspec.structs.replace(ALPHA, indices=Indices())
EXACT = KinematicTruth(spread=0.0, slip=Slip(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
SILENT = InertialNoise(0.0, 0.0, 0.0)


def rng(seed=0):
    return np.random.default_rng(seed)


def circle(duration=10.0, left=0.3, right=0.6, robot=IDEAL):
    def command(times):
        return np.tile([left, right], (len(times), 1)).astype(float)

    return EXACT.run(command, duration, robot, rng(), rate=200.0)


def imu(motion, robot, duration=10.0, rate=100.0, gyro=SILENT, accelerometer=SILENT, seed=0):
    times = sample_times(duration, rate)
    return read_imu(motion, times, rate, robot, gyro, accelerometer, rng(seed), rng(seed + 1))


def mounted(**values):
    return msgspec.structs.replace(IDEAL, imu=msgspec.structs.replace(IDEAL.imu, **values))


def sample_band(count, sigmas=5.0):
    """Band of a sample variance over the true one: chi-square of so many, as a normal."""
    return sigmas * np.sqrt(2.0 / count)


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_track_noise_follows_its_density(rate):
    motion = circle(600.0)
    times = sample_times(600.0, rate)
    series = read_tracks(motion, times, rate, TrackNoise(2e-3, 0.0), rng(1))
    errors = series.speeds - [0.3, 0.6]
    variance = errors.var() / (2e-3**2 * rate)
    assert abs(variance - 1.0) < sample_band(errors.size)
    # What the errors add up to in a second does not depend on the rate.
    per_second = errors[1:].reshape(600, int(rate), 2).mean(axis=1)
    assert abs(per_second.var() / 2e-3**2 - 1.0) < sample_band(per_second.size)
    assert abs(np.corrcoef(errors.T)[0, 1]) < 5.0 / np.sqrt(len(errors))


def test_track_speeds_are_averages_over_the_interval_before():
    command = make_trajectory("aggressive", 30.0, ALPHA, rng(4))
    motion = EXACT.run(command, 30.0, ALPHA, rng(), rate=1000.0)
    series = read_tracks(motion, sample_times(30.0, 10.0), 10.0, TrackNoise(0.0, 0.0), rng())
    fine = command(np.arange(0.0005, 30.0, 0.001)).reshape(300, 100, 2).mean(axis=1)
    assert np.allclose(series.speeds[1:], fine, atol=1e-6)


def test_a_standing_track_reads_exactly_zero():
    command = make_trajectory("stop-and-go", 60.0, ALPHA, rng())
    motion = EXACT.run(command, 60.0, ALPHA, rng(), rate=200.0)
    series = read_tracks(motion, sample_times(60.0, 50.0), 50.0, TrackNoise(1e-2, 0.0), rng())
    standing = motion.mean_track_speeds(sample_times(60.0, 50.0)) == 0.0
    assert standing.sum() > 300
    assert (series.speeds[standing] == 0.0).all()
    assert (series.speeds[~standing] != 0.0).all()


def test_track_scale_is_drawn_once_for_both_tracks():
    motion = circle()
    speeds = read_tracks(
        motion, sample_times(10.0, 50.0), 50.0, TrackNoise(0.0, 0.05), rng(3)
    ).speeds
    scales = np.array([0.3, 0.6]) / speeds
    assert np.ptp(scales) < 1e-12
    assert 0.0 < abs(scales[0, 0] - 1.0) < 0.25


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_inertial_noise_follows_its_density(rate):
    motion = circle(600.0)
    noise = InertialNoise(5e-3, 0.0, 0.0)
    series = imu(motion, IDEAL, 600.0, rate, noise, InertialNoise(3e-2, 0.0, 0.0)).series
    clean = imu(motion, IDEAL, 600.0, rate).series
    for errors, density in (
        (series.angular_velocity - clean.angular_velocity, 5e-3),
        (series.linear_acceleration - clean.linear_acceleration, 3e-2),
    ):
        assert abs(errors.var() / (density**2 * rate) - 1.0) < sample_band(errors.size)
        per_second = errors[1:].reshape(600, int(rate), 3).mean(axis=1)
        assert abs(per_second.var() / density**2 - 1.0) < sample_band(per_second.size)


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_bias_and_its_walk(rate):
    motion = circle(20.0)
    noise = InertialNoise(0.0, 0.01, 2e-3)
    runs = [imu(motion, IDEAL, 20.0, rate, noise, seed=2 * seed) for seed in range(200)]
    biases = np.array([run.gyro_bias for run in runs])
    assert abs(biases[:, 0].var() / 0.01**2 - 1.0) < sample_band(600)
    walked = biases[:, -1] - biases[:, 0]
    assert abs(walked.var() / (2e-3**2 * 20.0) - 1.0) < sample_band(600)
    clean = imu(motion, IDEAL, 20.0, rate).series.angular_velocity
    assert np.allclose(runs[0].series.angular_velocity - clean, biases[0], atol=1e-15)


def test_upside_down_mounting():
    motion = circle()
    w = 0.3 / 0.42
    series = imu(motion, mounted(rotation_rpy_deg=(180.0, 0.0, 0.0))).series
    assert np.allclose(series.angular_velocity, [0.0, 0.0, -w])
    # Centripetal acceleration is to the left, which is the IMU's right.
    assert np.allclose(series.linear_acceleration, [0.0, -0.45 * w, -GRAVITY])


def test_sideways_mounting_is_undone_by_the_rotation_of_the_robot_file():
    motion = circle()
    robot = mounted(rotation_rpy_deg=(90.0, 10.0, -30.0), position=(0.2, -0.1, 0.4))
    tilted = imu(motion, robot).series
    level = imu(motion, mounted(position=(0.2, -0.1, 0.4))).series
    for a, b in (
        (tilted.angular_velocity, level.angular_velocity),
        (tilted.linear_acceleration, level.linear_acceleration),
    ):
        assert np.allclose(a @ robot.imu_rotation.T, b)


def test_accelerometer_in_circular_motion():
    motion = circle()
    w, v = 0.3 / 0.42, 0.45
    at_origin = specific_forces(motion, np.array([5.0]), 0.01, (0.0, 0.0, 0.0))[0]
    assert at_origin == pytest.approx([0.0, w * v, GRAVITY])
    away = specific_forces(motion, np.array([5.0]), 0.01, (0.3, -0.2, 0.5))[0]
    assert away == pytest.approx([-(w**2) * 0.3, w * v + w**2 * 0.2, GRAVITY])


def test_accelerometer_feels_angular_acceleration_at_its_place():
    # Spinning up about the origin: V_r = -V_l = t / 10.
    motion = EXACT.run(
        lambda times: np.stack([-times / 10.0, times / 10.0], axis=-1),
        5.0,
        IDEAL,
        rng(),
        rate=200.0,
    )
    rate, w = 0.2 / 0.42, 0.2 * 3.0 / 0.42
    forces = specific_forces(motion, np.array([3.0]), 0.01, (0.3, -0.2, 0.0))[0]
    expected = [rate * 0.2 - w**2 * 0.3, rate * 0.3 + w**2 * 0.2, GRAVITY]
    assert forces == pytest.approx(expected)


def test_forces_are_the_second_derivative_of_the_imu_s_path():
    command = make_trajectory("slalom", 20.0, ALPHA, rng())
    motion = EXACT.run(command, 20.0, ALPHA, rng(), rate=1000.0)
    place, step = np.array([0.3, -0.2]), 0.01
    times = np.arange(4.0, 19.0, 0.25)

    def path(at):
        x, y, yaw = motion.poses_at(at).T
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.stack(
            [x + cos * place[0] - sin * place[1], y + sin * place[0] + cos * place[1]], axis=-1
        )

    in_odom = (path(times + step) - 2.0 * path(times) + path(times - step)) / step**2
    yaw = motion.poses_at(times)[:, 2]
    cos, sin = np.cos(yaw), np.sin(yaw)
    expected = np.stack(
        [cos * in_odom[:, 0] + sin * in_odom[:, 1], cos * in_odom[:, 1] - sin * in_odom[:, 0]],
        axis=-1,
    )
    forces = specific_forces(motion, times, 0.01, (0.3, -0.2, 0.0))
    assert np.allclose(forces[:, :2], expected, atol=1e-3)


def test_gyro_scale_and_missing_axes():
    motion = circle()
    w = 0.3 / 0.42
    robot = mounted(gyro_scale=1.02, gyro_axes="z", rotation_rpy_deg=(0.0, 10.0, 0.0))
    rates = imu(motion, robot, gyro=InertialNoise(0.0, 0.0, 0.0)).series.angular_velocity
    assert np.allclose(rates, [0.0, 0.0, 1.02 * w * np.cos(np.radians(10.0))])


def test_fixes_noise_heading_and_outages():
    motion = circle(2000.0)
    times = sample_times(2000.0, 1.0)
    series = read_fixes(motion, times, 0.05, 0.02, 1.0, ((100.0, 200.0), (300.0, 310.5)), rng(5))
    seconds = (series.stamps - EPOCH) * 1e-9
    assert len(series.stamps) == 2001 - 101 - 11
    assert not ((seconds >= 100.0) & (seconds <= 200.0)).any()
    errors = series.poses - motion.poses_at(seconds)
    assert abs(errors[:, :2].var() / 0.05**2 - 1.0) < sample_band(2 * len(errors))
    assert abs(errors[:, 2].var() / 0.02**2 - 1.0) < sample_band(len(errors))
    assert np.allclose(series.variances, [0.05**2, 0.02**2])
    # An outage takes fixes away and changes no other; neither does heading.
    whole = read_fixes(motion, times, 0.05, None, 1.0, (), rng(5))
    assert np.isnan(whole.poses[:, 2]).all()
    kept = np.isin(whole.stamps, series.stamps)
    assert np.array_equal(whole.poses[kept, :2], series.poses[:, :2])


def test_perfect_fixes_state_a_variance_that_a_log_accepts():
    motion = circle()
    series = read_fixes(motion, sample_times(10.0, 1.0), 0.05, None, 0.0, (), rng())
    assert np.allclose(series.poses[:, :2], motion.poses_at(sample_times(10.0, 1.0))[:, :2])
    assert (series.variances > 0.0).all()


def test_times_and_stamps():
    assert sample_times(1.0, 50.0)[-1] == pytest.approx(1.0)
    assert len(sample_times(0.3, 10.0)) == 4
    stamps = to_stamps(sample_times(1000.0, 30.0))
    assert stamps[0] == EPOCH
    assert stamps.dtype == np.int64
    assert (np.diff(stamps) > 33_333_000).all()


def test_nominal_noise_is_the_robot_file_s():
    noise = noise_preset("nominal")
    assert track_noise(noise, ALPHA) == TrackNoise(ALPHA.tracks.speed_noise_density, 0.0)
    assert gyro_noise(noise, ALPHA) == InertialNoise(5e-4, 0.01, 2e-5)
    assert accelerometer_noise(noise, ALPHA) == InertialNoise(0.01, 0.1, 5e-4)


def test_presets_and_overrides():
    for make in (track_noise, gyro_noise, accelerometer_noise):
        figures = msgspec.structs.astuple(make(NOISE_PRESETS["perfect"], ALPHA))
        assert figures == (0.0,) * len(figures)
    grades = [noise_preset(name) for name in ("consumer", "industrial", "tactical")]
    for field in SensorNoise.__struct_fields__[2:8]:
        values = [getattr(grade, field) for grade in grades]
        assert values == sorted(values, reverse=True)
    changed = noise_preset("industrial", {"gyro_noise_density": 1e-3, "gyro_factor": 2.0})
    assert gyro_noise(changed, ALPHA).density == pytest.approx(2e-3)
    assert gyro_noise(changed, ALPHA).bias_sigma == pytest.approx(2.0 * 3.5e-3)
    assert accelerometer_noise(changed, ALPHA) == accelerometer_noise(grades[1], ALPHA)


@pytest.mark.parametrize(
    ("name", "overrides", "message"),
    [
        ("industral", {}, "did you mean 'industrial'"),
        ("nominal", {"gyro_noise": 1.0}, "did you mean 'gyro_noise_density'"),
        ("nominal", {"gyro_factor": -1.0}, "gyro_factor must be zero or a positive number"),
        ("nominal", {"speed_noise_density": float("nan")}, "speed_noise_density must be"),
    ],
)
def test_bad_noise_is_refused(name, overrides, message):
    with pytest.raises(SimulationError, match=message):
        noise_preset(name, overrides)
