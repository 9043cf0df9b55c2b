"""Noise of the IMU, measured from its samples: white, coloured, turning, repeated, with gaps."""

import math

import numpy as np
import pytest

from icreckon import Settings, load_robot
from icreckon.estimator.sensors.imu_noise import (
    LEAST_GYRO_SHARE,
    ImuNoise,
    NoiseRecord,
    imu_noise,
    measure_noise,
    measured_noise,
)
from icreckon.estimator.sensors.input_settings import input_settings

SETTINGS = input_settings(load_robot("auriga-alpha"), Settings())
OF_FILE = SETTINGS.gyro_noise_density
OF_FORCE = SETTINGS.accelerometer_noise_density**2
NOISE_OF_FILE = ImuNoise(OF_FILE**2, OF_FORCE, OF_FORCE)
EPOCH = 1_700_000_000_123_456_789
RATES = pytest.mark.parametrize("rate", [20, 50, 100, 200, 400])


def stamps_at(rate, count):
    return (EPOCH + np.rint(np.arange(count) * 1e9 / rate).astype(np.int64)).tolist()


def white(rate, seconds, density=1.0, seed=0):
    """Stamps and readings (n, 3) of white noise of a density."""
    count = int(rate * seconds)
    readings = np.random.default_rng(seed).normal(scale=density * math.sqrt(rate), size=(count, 3))
    return stamps_at(rate, count), readings


def measured(stamps, readings, record=None):
    record = NoiseRecord() if record is None else record
    for stamp, (rate, x, y) in zip(stamps, np.asarray(readings).tolist(), strict=True):
        measure_noise(record, stamp, rate, x, y, SETTINGS.hold)
    return record


def densities(record):
    axes = record.gyro, record.accelerometer_x, record.accelerometer_y
    return [measured_noise(axis) for axis in axes]


@RATES
def test_the_density_of_white_noise_is_measured_at_any_rate(rate):
    found = [densities(measured(*white(rate, 30.0, seed=k))) for k in range(5)]
    assert np.mean(found) == pytest.approx(1.0, abs=0.12)
    assert np.ptp(found) < 0.8


@RATES
def test_turning_is_no_noise(rate):
    """Nor are a turn of 2 rad/s that begins within half a second, a bias, and a slope."""
    stamps, readings = white(rate, 20.0, 0.005)
    t = np.arange(len(stamps)) / rate
    calm = densities(measured(stamps, readings))
    readings += np.array([0.5, 3.0, -2.0]) + 2.0 * np.tanh(np.sin(0.7 * t) / 0.35)[:, None]
    assert densities(measured(stamps, readings)) == pytest.approx(calm, rel=0.15)


@pytest.mark.parametrize("rate", [50, 100])
def test_repeated_samples_change_nothing(rate):
    stamps, readings = white(rate, 20.0)
    once = densities(measured(stamps, readings))
    doubled = np.repeat(readings, 3, axis=0)
    between = np.ravel([[stamp, stamp + 10**6, stamp + 3 * 10**6] for stamp in stamps]).tolist()
    assert densities(measured(between, doubled)) == pytest.approx(once, rel=1e-12)


def test_gaps_and_outliers_hardly_count():
    rng = np.random.default_rng(3)
    stamps, readings = white(100, 60.0)
    found = densities(measured(stamps, readings))
    # In a turn that goes faster and faster, one sample in twenty is lost, and one in a hundred is absurd.
    readings += np.linspace(0.0, 200.0, len(stamps))[:, None]
    readings[rng.random(len(stamps)) < 0.01] += 1000.0
    kept = rng.random(len(stamps)) > 0.05
    kept_stamps = np.array(stamps)[kept].tolist()
    # Their root mean square is ten times as large.
    assert densities(measured(kept_stamps, readings[kept])) == pytest.approx(found, rel=0.5)


def test_one_gap_is_no_noise():
    stamps, readings = white(100, 20.0)
    stamps = [stamp + (5 * 10**9 if k >= 1000 else 0) for k, stamp in enumerate(stamps)]
    readings[1000:] += 50.0
    one = measured(stamps[:1002], readings[:1002])
    assert densities(one) == pytest.approx(densities(measured(stamps[:1000], readings[:1000])))


def test_noise_that_grows_is_followed_within_seconds_and_so_is_its_end():
    calm, shaken = (white(100, 12.0, density, seed=1) for density in (1.0, 30.0))
    record = measured(*calm)
    stamps = [stamp + 12 * 10**9 for stamp in shaken[0]]
    measured(stamps[:600], shaken[1][:600], record)
    assert min(densities(record)) > 20.0
    measured([stamp + 6 * 10**9 for stamp in stamps], calm[1], record)
    assert max(densities(record)) < 3.0


def test_constant_and_missing_readings_say_nothing():
    stamps = stamps_at(100, 300)
    record = measured(stamps, np.tile([0.1, math.nan, math.nan], (300, 1)))
    assert densities(record) == [0.0, 0.0, 0.0]
    assert imu_noise(record, True, SETTINGS) == NOISE_OF_FILE
    # An accelerometer that begins later is measured then.
    _, readings = white(100, 3.0)
    readings[:100, 1:] = math.nan
    assert min(densities(measured(stamps, readings))) > 0.5


def test_the_first_sample_is_uncertain_by_a_factor_of_thirty():
    stamps, readings = white(100, 0.02, OF_FILE)
    first = imu_noise(measured(stamps[:1], readings[:1]), True, SETTINGS)
    assert first == pytest.approx(900.0 * np.array(NOISE_OF_FILE))
    assert imu_noise(measured(stamps, readings), True, SETTINGS) == NOISE_OF_FILE


@pytest.mark.parametrize("at_rest", [True, False])
def test_noise_that_agrees_with_the_file_changes_nothing_and_other_noise_is_followed(at_rest):
    """Continuously, and never far below the file."""
    record = measured(*white(100, 2.0, OF_FILE))
    share, assumed = np.geomspace(1e-3, 1e3, 2000), []
    for factor in share:
        record.gyro.readings.size = 0.0
        record.gyro.blocks.size = factor * OF_FILE / math.sqrt(0.5 * math.pi)
        assumed.append(math.sqrt(imu_noise(record, at_rest, SETTINGS).gyro) / OF_FILE)
    found, more = np.array(assumed), 1.5 if at_rest else 2.5
    assert (np.diff(np.log(found)) >= -1e-12).all()
    assert np.diff(np.log(found)).max() < 2.1 * np.log(share[1] / share[0])
    inside = (share > 0.201) & (share < 0.999 * more)
    assert (found[inside] == 1.0).all()
    assert found[share > more**2] == pytest.approx(share[share > more**2])
    assert found.min() == pytest.approx(LEAST_GYRO_SHARE)


def test_accelerometers_are_never_better_than_the_file_says():
    noise = imu_noise(measured(*white(100, 2.0, 1e-9)), True, SETTINGS)
    assert noise.gyro < NOISE_OF_FILE.gyro
    assert noise[1:] == NOISE_OF_FILE[1:]
