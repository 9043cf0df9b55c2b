"""Both accelerometers: what they read at their place, and its derivatives by the state."""

import msgspec
import numpy as np
import pytest

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.reference.imu import StepTwist, accelerometer
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.variants import find_variant, initial_parameters, motion_model
from icreckon.estimator.sensors.imu_noise import ImuNoise
from icreckon.estimator.sensors.measurement_models import (
    ACCELEROMETERS,
    Linearised,
    imu_fixed,
    innovation_components,
)
from icreckon.estimator.sensors.sensor_models import (
    SensorModels,
    TrackChange,
    accelerometer_forecast,
)

ALPHA = load_robot("auriga-alpha")
CALM = TrackChange((0.0, 0.0), 0.0)
NOISE = ImuNoise(1e-6, 1e-4, 1e-4)
AXES = pytest.mark.parametrize("axis", [0, 1], ids=ACCELEROMETERS)
PLACES = pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2), (-0.5, 0.2, 0.0)])


def mounted(place: tuple[float, float, float]) -> Robot:
    return msgspec.structs.replace(ALPHA, imu=msgspec.structs.replace(ALPHA.imu, position=place))


@AXES
@PLACES
def test_a_forecast_is_the_acceleration_of_its_place(axis, place):
    """By differences of the place's path in odom, of a robot whose tracks change their speeds."""
    sensors = SensorModels(mounted(place))
    by_speeds = np.array([[0.5, 0.5], [0.02, -0.03], [-0.9, 0.8]])
    start, rise = np.array([0.3, 0.8]), np.array([0.5, -0.7])
    step = 1e-4

    def motion(t: float) -> Floats:
        return by_speeds @ (start + rise * t)

    # Yaw and position to second order in time, exactly.
    (v_x, v_y, w), (a_x, a_y, dw) = motion(0.0), by_speeds @ rise

    def path(t: float) -> Floats:
        yaw = w * t + 0.5 * dw * t * t
        forward = v_x * t + 0.5 * (a_x - w * v_y) * t * t
        left = v_y * t + 0.5 * (a_y + w * v_x) * t * t
        cos, sin = np.cos(yaw), np.sin(yaw)
        x, y = place[:2]
        return np.array([forward + cos * x - sin * y, left + sin * x + cos * y])

    acceleration = (path(step) - 2.0 * path(0.0) + path(-step)) / step**2
    change = CALM._replace(acceleration=tuple(rise.tolist()))
    found = accelerometer_forecast(
        sensors.imu_position, axis, 1e-4, 0.01, motion(0.0), by_speeds, change, 0.0
    )
    assert found.predicted == pytest.approx(acceleration[axis], abs=1e-6)


def some_ekf(rng: np.random.Generator, variant: str) -> IcrEkf:
    found = find_variant(variant)
    ekf = IcrEkf(motion_model(ALPHA, found))
    ekf.x[s.PARAMETERS] = initial_parameters(ALPHA, found)
    ekf.x[s.SLIP] = 0.02 * rng.normal(size=3)
    ekf.x[s.BIASES] = 0.05 * rng.normal(size=8)
    ekf.x[s.GRAVITY] = rng.normal(size=2)
    return ekf


def linearised(ekf: IcrEkf, x: Floats, axis: int, place: tuple[float, float, float]) -> Linearised:
    ekf.x = x
    at = StepTwist(ekf.twist_model(0.2, 0.7), x.copy(), 0.01, CALM, NOISE)
    return accelerometer(SensorModels(mounted(place)).imu_position, axis, 0.4, at, x, 0.0)


@AXES
@PLACES
@pytest.mark.parametrize("variant", ["inertia-online", "full-linear"])
def test_its_jacobian_is_the_derivative_of_its_prediction(axis, place, variant):
    ekf = some_ekf(np.random.default_rng(axis), variant)
    at = ekf.x.copy()
    found = linearised(ekf, at, axis, place)
    assert found.H[0, s.GRAVITY_X + axis] != 0.0
    assert found.H[0, s.ACCELEROMETER_BIAS_X + axis] == 1.0
    assert found.H[0, s.ACCELEROMETER_BIAS_X + 1 - axis] == 0.0
    size = np.ones(s.SIZE)
    size[s.PARAMETERS] = np.maximum(np.abs(at[s.PARAMETERS]), 1e-6)
    for column in range(s.SIZE):
        step = np.zeros(s.SIZE)
        step[column] = 1e-5 * size[column]
        ahead, behind = (linearised(ekf, at + sign * step, axis, place).z for sign in (1.0, -1.0))
        slope = (behind - ahead).item() / 2e-5
        assert slope == pytest.approx(found.H[0, column] * size[column], rel=1e-5, abs=1e-8)


@AXES
def test_an_update_between_moves_the_prediction_along_its_jacobian(axis: int) -> None:
    ekf = some_ekf(np.random.default_rng(4), "inertia-online")
    x = ekf.x.copy()
    at = StepTwist(ekf.twist_model(0.2, 0.7), x, 0.01, CALM, NOISE)
    imu = SensorModels(ALPHA).imu_position
    moved = x + 0.01 * np.random.default_rng(5).normal(size=s.SIZE)
    before, after = (accelerometer(imu, axis, 0.4, at, state, 0.0) for state in (x, moved))
    assert (after.H == before.H).all()
    assert after.z == pytest.approx(before.z - before.H @ (moved - x), abs=1e-12)


def test_the_imu_moves_only_what_it_shows() -> None:
    """Neither pose and height nor the scales, and of the parameters those that the model names."""
    names = {
        variant: {s.STATE_NAMES[i] for i in imu_fixed(motion_model(ALPHA, found).taught_by_imu)}
        for variant in ("inertia-online", "full-linear")
        for found in (find_variant(variant),)
    }
    always = {"x", "y", "yaw", "z", "track_scale", "gyro_scale"}
    parameters = {*s.PARAMETER_NAMES}
    assert names["inertia-online"] == always | parameters - {"eta0"}
    # The linear model's coefficients of the yaw rate are in the places of epsilon1 and eta0.
    assert names["full-linear"] == always | parameters - {"epsilon1", "eta0"}
    assert innovation_components()["accelerometer_x"] == ("accelerometer_x",)
