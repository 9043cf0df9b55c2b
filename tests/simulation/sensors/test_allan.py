"""The Allan deviation of what gyro and accelerometer read at rest, against their specification."""

import allantools
import numpy as np
import pytest

from icreckon import load_robot
from icreckon.simulation.base.sampling import sample_times
from icreckon.simulation.sensors.imu import INSTABILITY_FLOOR, MARKOV_PEAK, InertialErrors
from icreckon.simulation.sensors.specs import SensorSpecs, sensor_errors
from icreckon.simulation.truth.true_motion import TrueMotion
from sensor_readings import read_imu

ALPHA = load_robot("auriga-alpha")
SILENT = InertialErrors()
# Time over correlation time at which the Allan deviation of a Gauss-Markov process peaks.
MARKOV_PEAK_AT = 1.8926
SENSORS = ("gyro", "accelerometer")


def at_rest(sensor: str, errors: InertialErrors, duration: float, rate: float) -> np.ndarray:
    """What a sensor's three axes (n, 3) read while the robot stands."""
    still = np.zeros((int(duration) + 2, 3))
    motion = TrueMotion(1.0, still, still, still[:, :2], still[:, :2], None, "rest")
    gyro, accelerometer = (errors if name == sensor else SILENT for name in SENSORS)
    rngs = [np.random.default_rng(seed) for seed in (11, 12)]
    times = sample_times(duration, rate)
    series = read_imu(motion, times, rate, ALPHA, gyro, accelerometer, *rngs).series
    return series.angular_velocity if sensor == "gyro" else series.linear_acceleration


def deviations(readings: np.ndarray, rate: float, taus: np.ndarray) -> np.ndarray:
    """Overlapping Allan deviations (k,) at taus (k,) [s], from the mean variance of the three axes."""
    each = []
    for axis in readings.T:
        found, deviation, _, _ = allantools.oadev(axis, rate=rate, data_type="freq", taus=taus)
        assert np.allclose(found, taus)
        each.append(deviation)
    return np.sqrt(np.mean(np.square(each), axis=0))


def markov_deviation(taus: np.ndarray, instability: float, time: float) -> np.ndarray:
    """Allan deviation of the process that stands for bias instability (simulation/sensors/imu.py)."""
    x = taus / time
    variance = 2.0 / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))
    return INSTABILITY_FLOOR / MARKOV_PEAK * instability * np.sqrt(variance)


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_floor_of_bias_instability_is_that_of_the_data_sheet(sensor: str) -> None:
    instability, time, rate, duration = 5e-5, 10.0, 10.0, 40_000.0
    errors = InertialErrors(bias_instability=instability, bias_instability_time=time)
    readings = at_rest(sensor, errors, duration, rate)
    taus = np.array([1.0, 2.0, 5.0, 10.0, MARKOV_PEAK_AT * time, 50.0, 100.0, 200.0]).round(1)
    measured = deviations(readings, rate, taus)
    # At least half of the stretches as long as tau, or as the correlation time, are independent.
    sigma = np.sqrt(np.maximum(taus, time) / (3.0 * duration))
    expected = markov_deviation(taus, instability, time)
    assert (np.abs(measured / expected - 1.0) < 4.0 * sigma).all()
    peak = measured[4]
    assert peak == pytest.approx(0.664 * instability, rel=4.0 * sigma[4])
    assert (measured <= peak * (1.0 + 2.0 * sigma)).all()


@pytest.mark.parametrize(
    ("grade", "sensor"),
    [("consumer", "gyro"), ("industrial", "accelerometer"), ("tactical", "gyro")],
)
def test_a_whole_data_sheet(grade: str, sensor: str) -> None:
    errors = getattr(sensor_errors(SensorSpecs(), grade, ALPHA), sensor)
    rate, duration = 10.0, 20_000.0
    readings = at_rest(sensor, errors, duration, rate)
    taus = np.array([0.1, 1.0, 10.0, 100.0, 500.0])
    expected = np.sqrt(
        errors.noise_density**2 / taus
        + markov_deviation(taus, errors.bias_instability, errors.bias_instability_time) ** 2
        + errors.bias_walk**2 * taus / 3.0
    )
    sigma = np.sqrt(taus / (3.0 * duration))
    ratio = deviations(readings, rate, taus) / expected
    assert (np.abs(ratio - 1.0) < 4.0 * sigma + 1e-3).all()
