from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icreckon import EncoderSpec, FixSpec, Indices, InertialSpec, Robot, SimulationError, load_robot
from icreckon.estimator.base.frames import rotate
from icreckon.simulation.base.sampling import EPOCH, sample_times, to_stamps
from icreckon.simulation.drives.trajectories import make_trajectory
from icreckon.simulation.sensors.encoders import DROPOUT_READINGS, STANDING, EncoderErrors
from icreckon.simulation.sensors.fixes import FixErrors, with_fix_errors
from icreckon.simulation.sensors.imu import InertialErrors, specific_forces
from icreckon.simulation.sensors.specs import SensorErrors, SensorSpecs, noise_preset, sensor_errors
from icreckon.simulation.truth.kinematic import KinematicTruth
from sensor_readings import read_fixes, read_imu, read_tracks

ALPHA = load_robot("auriga-alpha")
IDEAL = msgspec.structs.replace(ALPHA, indices=Indices(epsilon_F=0.0))
EXACT = KinematicTruth(spread=0.0, slip_noise=0.0)
SILENT = InertialErrors()


def errors_of(noise: str = "nominal", robot: Robot = ALPHA, **specs: Any) -> SensorErrors:
    return sensor_errors(SensorSpecs(**specs), noise, robot)


OUTAGES = ((100.0, 200.0), (300.0, 310.5))


def rng(seed=0):
    return np.random.default_rng(seed)


@cache
def circle(duration=10.0):
    def command(times):
        return np.tile([0.3, 0.6], (len(times), 1))

    return EXACT.run(command, duration, IDEAL, rng(), rate=200.0)


def imu(motion, robot, duration=10.0, gyro=SILENT, accelerometer=SILENT, seed=0):
    times = sample_times(duration, 100.0)
    return read_imu(motion, times, 100.0, robot, gyro, accelerometer, rng(seed), rng(seed + 1))


def mounted(**values):
    return msgspec.structs.replace(IDEAL, imu=msgspec.structs.replace(IDEAL.imu, **values))


def sample_band(count):
    """Band of a sample variance over the true one: chi-square of so many, as a normal."""
    return 5.0 * np.sqrt(2.0 / count)


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_track_noise_follows_its_density(rate):
    motion = circle(600.0)
    times = sample_times(600.0, rate)
    series = read_tracks(motion, times, rate, EncoderErrors(speed_noise_density=2e-3), rng(1))
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
    series = read_tracks(motion, sample_times(30.0, 10.0), 10.0, EncoderErrors(), rng())
    fine = command(np.arange(0.0005, 30.0, 0.001)).reshape(300, 100, 2).mean(axis=1)
    fine = np.where(np.abs(fine) > STANDING, fine, 0.0)
    assert np.allclose(series.speeds[1:], fine, atol=1e-6)


def test_a_standing_track_reads_exactly_zero():
    command = make_trajectory("stop-and-go", 60.0, ALPHA, rng())
    motion = EXACT.run(command, 60.0, ALPHA, rng(), rate=200.0)
    times = sample_times(60.0, 50.0)
    series = read_tracks(motion, times, 50.0, EncoderErrors(speed_noise_density=1e-2), rng())
    standing = np.abs(motion.mean_track_speeds(times)) <= STANDING
    assert standing.sum() > 300
    assert (series.speeds[standing] == 0.0).all()
    assert (series.speeds[~standing] != 0.0).all()


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


def test_forces_are_the_second_derivative_of_the_imu_s_path():
    command = make_trajectory("slalom", 20.0, ALPHA, rng())
    motion = EXACT.run(command, 20.0, ALPHA, rng(), rate=1000.0)
    times, step = np.arange(4.0, 19.0, 0.25), 0.01

    def path(at):
        poses = motion.poses_at(at)
        return poses[:, :2] + rotate(np.tile([0.3, -0.2], (len(at), 1)), poses[:, 2])

    in_odom = (path(times + step) - 2.0 * path(times) + path(times - step)) / step**2
    expected = rotate(in_odom, -motion.poses_at(times)[:, 2])
    forces = specific_forces(motion, times, 0.01, (0.3, -0.2, 0.0))
    assert np.allclose(forces[:, :2], expected, atol=1e-3)


def test_gyro_scale_and_missing_axes():
    motion = circle()
    w = 0.3 / 0.42
    robot = mounted(gyro_scale=1.02, gyro_axes="z", rotation_rpy_deg=(0.0, 10.0, 0.0))
    rates = imu(motion, robot, gyro=SILENT).series.angular_velocity
    assert np.allclose(rates, [0.0, 0.0, 1.02 * w * np.cos(np.radians(10.0))])


def test_fixes_noise_heading_and_outages():
    motion = circle(2000.0)
    times = sample_times(2000.0, 1.0)
    series = read_fixes(motion, times, FixErrors(heading_sigma=0.02), OUTAGES, rng(5))
    seconds = (series.stamps - EPOCH) * 1e-9
    assert len(series.stamps) == 2001 - 101 - 11
    assert not ((seconds >= 100.0) & (seconds <= 200.0)).any()
    errors = series.poses - motion.poses_at(seconds)
    assert abs(errors[:, :2].var() / 0.05**2 - 1.0) < sample_band(2 * len(errors))
    assert abs(errors[:, 2].var() / 0.02**2 - 1.0) < sample_band(len(errors))
    assert np.allclose(series.variances, [0.05**2, 0.02**2])
    # An outage takes fixes away and changes no other; neither does heading.
    whole = read_fixes(motion, times, FixErrors(), (), rng(5))
    assert np.isnan(whole.poses[:, 2]).all()
    kept = np.isin(whole.stamps, series.stamps)
    assert np.array_equal(whole.poses[kept, :2], series.poses[:, :2])


def test_a_figure_left_out_is_the_preset_s_and_then_the_robot_file_s():
    assert errors_of().encoders == EncoderErrors(
        speed_noise_density=ALPHA.tracks.speed_noise_density
    )
    assert errors_of().gyro == InertialErrors(noise_density=5e-4, bias_sigma=0.01, bias_walk=2e-5)
    assert errors_of().accelerometer == InertialErrors(
        noise_density=0.01, bias_sigma=0.1, bias_walk=5e-4
    )
    unsure = mounted(gyro_scale_sigma=0.02)
    assert errors_of(robot=unsure).gyro.scale_sigma == 0.02
    consumer = noise_preset("consumer")
    errors = errors_of("consumer", unsure, gyro=InertialSpec(bias_walk=1.0)).gyro
    assert (errors.scale_sigma, errors.bias_walk) == (0.01, 1.0)
    assert errors.noise_density == consumer.gyro.noise_density
    assert errors_of(fixes=FixSpec(latency=0.1)).fixes == FixErrors(latency=0.1)


def test_the_factor_is_on_errors_and_not_on_times_and_shares():
    twice = {"factor": 2.0}
    encoders = EncoderSpec(resolution=1e-3, dropouts_per_hour=3.0, dropout_duration=2.0, **twice)
    assert errors_of(encoders=encoders).encoders == EncoderErrors(
        speed_noise_density=2.0 * ALPHA.tracks.speed_noise_density,
        resolution=2e-3,
        dropouts_per_hour=3.0,
        dropout_duration=2.0,
    )
    plain = errors_of("industrial").gyro
    doubled = errors_of("industrial", gyro=InertialSpec(**twice)).gyro
    for name in InertialErrors.__struct_fields__:
        expected = 1.0 if name in {"range", "bias_instability_time"} else 2.0
        assert getattr(doubled, name) == pytest.approx(expected * getattr(plain, name)), name
    fixes = FixSpec(heading_sigma=0.1, outlier_share=0.2, latency=0.3, **twice)
    assert errors_of(fixes=fixes).fixes == FixErrors(
        sigma=0.1, heading_sigma=0.2, outlier_share=0.2, latency=0.3
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: noise_preset("industral"), "did you mean 'industrial'"),
        (lambda: EncoderSpec(dropouts_per_hour=1e9), "dropouts_per_hour must be from 0 to 36000"),
        (lambda: EncoderSpec(dropout_reads="zeros"), "cannot be 'zeros'; did you mean 'zero'"),
    ],
)
def test_bad_figures_are_refused(make, message):
    with pytest.raises(SimulationError, match=message):
        make()


# Encoders that count, differ, and drop out.


DRIVEN = EXACT.run(
    make_trajectory("aggressive", 60.0, ALPHA, rng(4)), 60.0, ALPHA, rng(), rate=200.0
)


@settings(max_examples=30)
@given(
    resolution=st.floats(1e-6, 0.1),
    density=st.sampled_from([0.0, 1e-3]),
    rate=st.sampled_from([7.0, 50.0, 130.0]),
    seed=st.integers(0, 2**32),
)
def test_counting_never_adds_up_to_more_than_a_count(resolution, density, rate, seed):
    times = sample_times(60.0, rate)
    exact = EncoderErrors(speed_noise_density=density, scale_sigma=0.05)
    counting = msgspec.structs.replace(exact, resolution=resolution)
    without = read_tracks(DRIVEN, times, rate, exact, rng(seed)).speeds
    counted = read_tracks(DRIVEN, times, rate, counting, rng(seed)).speeds
    travel = np.cumsum(counted - without, axis=0) / rate
    assert np.abs(travel).max() < resolution * (1.0 + 1e-6)
    counts = counted / rate / resolution
    assert np.allclose(counts, np.rint(counts), atol=1e-6)


def test_the_difference_of_scales_is_left_less_right_and_keeps_the_mean():
    differences, motion = [], circle(0.1)
    for seed in range(300):
        errors = EncoderErrors(scale_sigma=0.01, scale_difference_sigma=0.004)
        common = EncoderErrors(scale_sigma=0.01)
        times = sample_times(0.1, 50.0)
        one, other = (
            [0.3, 0.6] / read_tracks(motion, times, 50.0, which, rng(seed)).speeds[0]
            for which in (errors, common)
        )
        assert one.mean() == pytest.approx(other.mean(), abs=1e-12)
        differences.append(one[0] - one[1])
    variance = np.var(differences) / 0.004**2
    assert abs(variance - 1.0) < sample_band(300)
    assert abs(np.mean(differences)) < 5.0 * 0.004 / np.sqrt(300)


@cache
def dropped(reads, **values):
    motion, duration = circle(7200.0), 7200.0
    values = {"dropouts_per_hour": 120.0, "dropout_duration": 2.0} | values
    times = sample_times(duration, 10.0)
    errors = EncoderErrors(speed_noise_density=1e-3, dropout_reads=reads, **values)
    return read_tracks(motion, times, 10.0, errors, rng(2))


def test_dropouts_have_their_rate_and_duration_and_change_nothing_else():
    whole = dropped("zero", dropouts_per_hour=0.0).speeds
    zero = dropped("zero").speeds
    lost = (zero == 0.0).all(axis=1)
    assert np.array_equal(zero[~lost], whole[~lost])
    starts = np.count_nonzero(np.diff(lost.astype(int)) == 1)
    # 120 an hour of time without: 240 / (1 + 120 * 2 / 3600) in two hours, less those of two that
    # merge or fall between samples (some 7 %); five standard deviations of a Poisson count.
    expected = 240.0 / (1.0 + 120.0 * 2.0 / 3600.0)
    assert abs(starts - expected) < 5.0 * np.sqrt(expected)
    share = 120.0 * 2.0 / 3600.0 / (1.0 + 120.0 * 2.0 / 3600.0)
    assert abs(lost.mean() - share) < 5.0 * share * np.sqrt(2.0 / expected)


def test_what_samples_read_in_a_dropout():
    assert DROPOUT_READINGS == ("nothing", "last", "zero")
    whole, zero = dropped("zero", dropouts_per_hour=0.0), dropped("zero")
    lost = (zero.speeds == 0.0).all(axis=1)
    nothing = dropped("nothing")
    assert np.array_equal(nothing.stamps, whole.stamps[~lost])
    assert np.array_equal(nothing.speeds, whole.speeds[~lost])
    last = dropped("last").speeds
    assert np.array_equal(last[~lost], whole.speeds[~lost])
    stuck = np.flatnonzero(lost)
    assert np.array_equal(last[stuck], last[stuck - 1])
    assert not lost[0]


# Scale, alignment, range and instability of gyro and accelerometer.


def test_scale_and_misalignment_are_drawn_once_for_each_axis():
    motion = circle(1.0)
    rates = np.array([0.0, 0.0, 0.3 / 0.42])
    found = []
    for seed in range(300):
        errors = InertialErrors(scale_sigma=0.02, misalignment_sigma=0.005)
        gyro = imu(motion, IDEAL, 1.0, gyro=errors, seed=seed).series.angular_velocity
        assert np.ptp(gyro, axis=0) == pytest.approx(0.0, abs=1e-12)
        found.append((gyro[0] - rates) / rates[2])
    found = np.array(found)
    assert abs(found[:, 2].var() / 0.02**2 - 1.0) < sample_band(300)
    assert abs(found[:, :2].var() / 0.005**2 - 1.0) < sample_band(600)
    assert np.abs(found.mean(axis=0)).max() < 5.0 * 0.02 / np.sqrt(300)


def test_a_sensor_saturates_at_its_range_in_its_own_axes():
    errors = InertialErrors(range=0.5, noise_density=0.05)
    gyro = imu(circle(), IDEAL, gyro=errors).series.angular_velocity
    plain = imu(circle(), IDEAL, gyro=InertialErrors(noise_density=0.05)).series.angular_velocity
    assert (np.abs(plain) > 0.5).any()
    assert np.array_equal(gyro, np.clip(plain, -0.5, 0.5))
    upside_down = mounted(rotation_rpy_deg=(180.0, 0.0, 0.0))
    forces = imu(circle(), upside_down, accelerometer=InertialErrors(range=5.0)).series
    assert forces.linear_acceleration[:, 2] == pytest.approx(-5.0)


# Fixes that are late or wrong.


def test_a_late_fix_shows_the_pose_of_before():
    times = sample_times(60.0, 1.0)
    errors = FixErrors(sigma=0.0, heading_sigma=0.0, latency=0.35)
    series = read_fixes(DRIVEN, times, errors, (), rng())
    assert np.array_equal(series.stamps, to_stamps(times))
    expected = DRIVEN.poses_at(np.maximum(times - 0.35, 0.0))
    assert np.allclose(series.poses, expected, atol=1e-12)
    assert np.abs(series.poses - DRIVEN.poses_at(times)).max() > 0.05


def test_outliers_have_their_share_and_size_and_do_not_say_so():
    motion = circle(5000.0)
    times = sample_times(5000.0, 1.0)
    plain = read_fixes(motion, times, FixErrors(heading_sigma=0.02), (), rng(5))
    errors = FixErrors(heading_sigma=0.02, outlier_share=0.1, outlier_sigma=3.0)
    series = read_fixes(motion, times, errors, (), rng(5))
    excess = series.poses - plain.poses
    outlying = (excess[:, :2] != 0.0).any(axis=1)
    assert abs(outlying.sum() - 500.1) < 5.0 * np.sqrt(5001 * 0.1 * 0.9)
    assert abs(excess[outlying, :2].var() / 9.0 - 1.0) < sample_band(2 * outlying.sum())
    assert not excess[:, 2].any()
    assert np.array_equal(series.variances, plain.variances)
    # More outliers keep the old ones.
    more = msgspec.structs.replace(errors, outlier_share=0.3)
    again = read_fixes(motion, times, more, (), rng(5)).poses
    assert np.array_equal(again[outlying], series.poses[outlying])


def test_fixes_that_wander():
    times = np.arange(0.0, 40_000.0, 1.0)
    poses = np.zeros((len(times), 3))

    def errors(**figures):
        return with_fix_errors(poses, times, FixErrors(**figures), (), np.random.default_rng(5))

    plain = errors(sigma=0.3)
    found = errors(sigma=0.3, wander_sigma=1.2, wander_time=60.0)
    # The white noise is the same, and the log states it alone.
    wander = (found.poses - plain.poses)[:, :2]
    np.testing.assert_array_equal(found.variances, plain.variances)
    assert wander.std(axis=0) == pytest.approx(1.2, rel=0.1)
    for lag in (10, 60):
        correlation = np.mean(wander[lag:] * wander[:-lag], axis=0) / wander.var(axis=0)
        assert correlation == pytest.approx(np.exp(-lag / 60.0), abs=0.08)
    assert abs(np.corrcoef(wander.T)[0, 1]) < 0.15
    with pytest.raises(SimulationError, match="wander_time must be"):
        FixSpec(wander_sigma=1.0, wander_time=0.0)


def test_the_gyro_has_the_bias_of_the_robot_file():
    """About the vertical of base_link, however the IMU is mounted."""
    turned = msgspec.structs.replace(ALPHA.imu, rotation_rpy_deg=(180.0, 0.0, 30.0))
    files = (turned, msgspec.structs.replace(turned, gyro_bias=0.02))
    robots = [msgspec.structs.replace(ALPHA, imu=one) for one in files]
    without, biased = (imu(circle(), one).series for one in robots)
    off = (biased.angular_velocity - without.angular_velocity) @ robots[0].imu_rotation.T
    np.testing.assert_allclose(off, np.tile([0.0, 0.0, 0.02], (len(off), 1)), atol=1e-12)
