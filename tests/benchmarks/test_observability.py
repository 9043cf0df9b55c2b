"""What manoeuvres show: null spaces by what is known of the model, and the covariance by the filter's."""

import numpy as np
import pytest
from analysis.linearised import LinearisedModel, Sensors, stepped
from analysis.observability import observe

from icreckon.estimator.base import state as s
from icreckon.estimator.base.frames import compose
from icreckon.estimator.log.measurements import ImuSample, PositionFix, TrackSpeeds
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.sensors.imu_noise import noise_of_file
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.truth.true_motion import exponential

ALPHA = load_robot("auriga-alpha")
DT = 0.05
COUNT = 300
TIMES = np.arange(COUNT) * DT
STRAIGHT = np.full((COUNT, 2), 0.5)
CIRCLE = np.tile([0.3, 0.6], (COUNT, 1))
SLALOM = 0.5 + 0.2 * np.sin(TIMES)[:, None] * [-1.0, 1.0]
IMU = Sensors(gyro=True, accelerometer=True)
FIXES = Sensors(gyro=True, accelerometer=True, position_sigma=0.05)
POSES = Sensors(gyro=True, accelerometer=True, position_sigma=0.05, heading_sigma=0.02)
INDICES = ["zeta0", "zeta1", "epsilon0", "epsilon1", "eta0", "eta1", "eta2"]


def names(speeds, sensors, variant="inertia-online"):
    return observe(ALPHA, variant, speeds, DT, sensors).unobservable_names


@pytest.mark.parametrize("speeds", [STRAIGHT, CIRCLE, SLALOM], ids=["straight", "circle", "slalom"])
@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_h_never_shows(speeds, variant):
    assert "H" in names(speeds, POSES, variant)


@pytest.mark.parametrize("sensors", [IMU, FIXES, POSES])
def test_straight_driving_shows_no_index(sensors):
    assert set(INDICES) < set(names(STRAIGHT, sensors))


def test_tracks_alone_show_nothing():
    seen = observe(ALPHA, "inertia-online", SLALOM, DT, Sensors())
    assert seen.rank == 0
    assert np.isnan(seen.condition)
    assert seen.unobservable_names == list(seen.states)


def test_a_standing_robot_knows_its_gyro_bias_and_gravity_less_bias_alone():
    seen = observe(ALPHA, "inertia-online", np.zeros((COUNT, 2)), DT, IMU)
    assert seen.rank == 3
    assert "gyro_bias" not in seen.unobservable_names
    for axis in "xy":
        assert f"accelerometer_bias_{axis} with gravity_{axis}" in seen.unobservable_names
    assert seen.left_of("gyro_bias") < 0.05


def test_changing_turns_with_fixes_show_all_but_h():
    seen = observe(ALPHA, "inertia-online", SLALOM, DT, FIXES)
    assert seen.unobservable_names == ["H"]
    assert seen.rank == len(seen.states) - 1
    assert seen.left_of("eta0") < 0.5 < seen.left_of("eta2")


def test_a_constant_circle_cannot_tell_bias_from_scale_of_the_gyro():
    assert "gyro_scale against gyro_bias" in names(CIRCLE, POSES, "constant-online")


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
def test_covariance_along_a_motion_is_the_filters(variant, monkeypatch):
    """Readings that are just as predicted leave the state on the motion; only the covariance moves."""
    # Readings without noise would be measured as such.
    monkeypatch.setattr(
        "icreckon.estimator.engine.lane_functions.noise_of_step",
        lambda *given: noise_of_file(given[-1]),
    )
    settings = Settings(engine="plain", use_accelerometer=False)
    sensors = Sensors(gyro=True, position_sigma=0.05)
    model = LinearisedModel(ALPHA, find_variant(variant), sensors, DT, settings, as_filter=True)
    estimator = PoseEstimator(ALPHA, variant, settings=settings)
    # It is refused, but tells the interval of the next.
    estimator.feed(ImuSample(-1, (0.0, 0.0, 0.0)))
    estimator.feed(TrackSpeeds(0, 0.0, 0.0))
    x, P = model.start.copy(), np.diag(model.sigmas**2)
    for k, (left, right) in enumerate(SLALOM[:100].tolist(), start=1):
        stamp = round(k * DT * 1e9)
        model.begin(x, left, right)
        twist = model.twist_model(x, left, right).twist
        P = stepped(P, model.step(x, left, right), ruled=True)
        x[s.POSE] = compose(x[s.POSE], exponential(twist[None] * DT)[0])
        estimator.feed(TrackSpeeds(stamp, left, right))
        estimator.feed(ImuSample(stamp, (0.0, 0.0, twist[2])))
        if k % 20 == 0:
            estimator.feed(PositionFix(stamp, x[s.X], x[s.Y], 0.05**2))
    assert estimator.state == pytest.approx(x, abs=1e-9)
    sigma = np.sqrt(np.diagonal(P)) + 1e-30
    assert np.abs((estimator.covariance - P) / np.outer(sigma, sigma)).max() < 1e-6
