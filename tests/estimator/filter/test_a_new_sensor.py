"""A sensor that is no part of the package: a radar that measures the forward speed at its place."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from icreckon import EstimatorError, Log, PoseEstimator, load_robot, run, smooth
from icreckon.estimator.base import state as s
from icreckon.estimator.log.measurements import ImuSample, Mark, Measurement, TrackSpeeds
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.robot.settings import GateSettings, Settings
from icreckon.estimator.sensors.measurement_models import (
    POSE_FIXED,
    FixModel,
    Linearised,
    register,
    unregister,
)
from icreckon.estimator.sensors.predictions import Prediction, twist_ahead, twist_now

# --- the sensor ---------------------------------------------------------------------------------------


class GroundSpeed(msgspec.Struct, frozen=True):
    """Forward speed of the ground under a radar."""

    stamp: int
    speed: float  # [m/s]
    variance: float  # [m²/s²]


class Radar(FixModel[GroundSpeed]):
    """Radar at the left edge of the robot: v_x - w y."""

    name, predicts = "radar", "twist"
    components = ("radar",)
    inflated = (s.SLIP_X,)
    fixed = POSE_FIXED
    y = 0.2  # position in base_link, to the left [m]

    def linearise(self, measurement: GroundSpeed, predicted: Prediction) -> Linearised:
        """Compare the speed with the predicted twist."""
        along = np.array([[1.0, 0.0, -self.y]])
        z = measurement.speed - along @ predicted.values
        return Linearised(
            z, along @ predicted.H, along @ predicted.R @ along.T + measurement.variance
        )


# --- its tests ----------------------------------------------------------------------------------------

ALPHA = load_robot("auriga-alpha")
EPOCH = 1_700_000_000_000_000_000
STEP = 10_000_000
TRUE_SPEED, TRUE_W = 0.42, 0.3


@pytest.fixture(autouse=True)
def radar() -> Iterator[Radar]:
    model = Radar()
    register(GroundSpeed, model)
    yield model
    unregister(GroundSpeed)


def seen(stamp: int, wrong: float = 0.0) -> GroundSpeed:
    return GroundSpeed(stamp, TRUE_SPEED - Radar.y * TRUE_W + wrong, 1e-4)


def drive(seconds: float = 4.0, *, offset: int = 3_000_000) -> list[Measurement]:
    """A bend in which the tracks slip, and a radar reading between two IMU samples at 10 Hz."""
    found: list[Measurement] = []
    for k in range(round(seconds * 100)):
        stamp = EPOCH + k * STEP
        if k % 2 == 0:
            found.append(TrackSpeeds(stamp, 0.45, 0.60))
        found.append(ImuSample(stamp, (0.0, 0.0, TRUE_W), (0.0, TRUE_SPEED * TRUE_W, 9.81)))
        if k % 10 == 5:
            found.append(seen(stamp + offset))
    return found


def fed(measurements: list[Measurement], **gates: float) -> PoseEstimator:
    settings = Settings(gates=GateSettings(**gates))
    estimator = PoseEstimator(ALPHA, settings=settings)
    for measurement in measurements:
        estimator.feed(measurement)
    return estimator


@pytest.mark.parametrize("ahead", [False, True])
def test_its_jacobian_is_the_derivative_of_its_predicted_measurement(radar: Radar, ahead: bool):
    ekf = IcrEkf(LaggedIndexMotion(ALPHA.constants))
    ekf.x[s.PARAMETERS] = ALPHA.indices.as_array()
    ekf.x[s.SLIP] = 0.01, -0.02, 0.05
    at = ekf.x.copy()

    def linearised(x: np.ndarray) -> Linearised:
        ekf.x = x
        model = ekf.twist_model(0.2, 0.6)
        density = np.diag([1e-6, 2e-6, 3e-4])
        predicted = twist_ahead(x, model, density, 0.01) if ahead else twist_now(model)
        return radar.linearise(GroundSpeed(0, 0.3, 1e-4), predicted)

    found = linearised(at)
    for column in range(s.SIZE):
        step = np.zeros(s.SIZE)
        step[column] = 1e-6
        slope = (linearised(at - step).z - linearised(at + step).z) / 2e-6
        assert slope == pytest.approx(found.H[:, column], rel=1e-4, abs=1e-7)
    noise = 1e-4 + ahead * (1e-4 + Radar.y**2 * 3e-2)
    assert found.R.item() == pytest.approx(noise)


def test_it_corrects_the_speed_and_is_counted_in_health():
    without = fed([m for m in drive() if not isinstance(m, GroundSpeed)])
    estimator = fed(drive())
    assert without.twist[0] - TRUE_SPEED > 0.05
    assert abs(estimator.twist[0] - TRUE_SPEED) < 0.5 * (without.twist[0] - TRUE_SPEED)
    counts = estimator.health.sensors["radar"]
    assert (counts.used, counts.degrees, counts.rejected) == (40, 40 - counts.reacquired, {})
    assert counts.newest.stamp == drive()[-1].stamp - 4 * STEP + 3_000_000


def test_its_gate_rejects_outliers_and_reacquires_after_some_time():
    estimator = fed(drive(), patience=0.0395)
    state, stamp = estimator.state, estimator.stamp
    for k in range(1, 4):
        assert not estimator.feed(seen(stamp + k * 1_000_000, wrong=2.0))
    assert (estimator.state == state).all()
    assert estimator.feed(seen(stamp + 4_000_000, wrong=2.0))
    counts = estimator.health.sensors["radar"]
    assert (counts.rejected, counts.reacquired) == ({"gate": 3}, 1)
    assert estimator.twist[0] == pytest.approx(TRUE_SPEED + 2.0, abs=0.05)
    assert (estimator.pose == state[s.POSE]).all(), "it must not move the pose"


def test_bad_readings_are_refused():
    estimator = fed(drive(1.0))
    stamp = estimator.stamp
    for bad in (
        GroundSpeed(stamp, float("nan"), 1e-4),
        GroundSpeed(stamp, 0.4, 0.0),
        GroundSpeed(EPOCH + 5 * STEP + 3_000_000, 0.4, 1e-4),
    ):
        assert not estimator.feed(bad)
    rejected = estimator.health.sensors["radar"].rejected
    reasons = "speed is not finite", "variance not positive", "duplicate stamp"
    assert rejected == dict.fromkeys(reasons, 1)
    with pytest.raises(EstimatorError, match="must be a number"):
        estimator.feed(GroundSpeed(stamp, "fast", 1e-4))  # type: ignore[arg-type]
    assert estimator.feed(GroundSpeed(np.int64(stamp), 1, np.float32(1.0)))  # type: ignore[arg-type]


def test_its_innovations_are_in_the_rows_of_a_run():
    log = Log.from_measurements(drive())
    found = run(log, ALPHA, "inertia-online")
    assert found.innovation_names == ("gyro", "accelerometer_x", "accelerometer_y", "radar")
    radar = found.innovations[:, 3]
    assert np.isfinite(radar).sum() == 40
    assert np.abs(radar[np.isfinite(radar)][5:]).max() < 1.0
    smoothed = smooth(log, ALPHA, "inertia-online").smoothed
    assert smoothed.trajectory.twists[20, 0] == pytest.approx(TRUE_SPEED, abs=0.03)


def test_a_saved_estimator_goes_on_with_it(tmp_path):
    measurements = drive()
    half = len(measurements) // 2
    before = fed(measurements[:half])
    before.save(tmp_path / "saved.json")
    restored = PoseEstimator.restore(tmp_path / "saved.json", ALPHA)
    late = seen(measurements[half].stamp - 200_000_001)
    for estimator in (before, restored):
        assert estimator.feed(late)
        for measurement in measurements[half:]:
            estimator.feed(measurement)
    assert (before.state == restored.state).all()
    assert before.health == restored.health
    unregister(GroundSpeed)
    try:
        with pytest.raises(
            EstimatorError, match=r"sensor 'radar' is not known here: register it before"
        ):
            PoseEstimator.restore(tmp_path / "saved.json", ALPHA)
    finally:
        register(GroundSpeed, Radar())


class Unnamed(msgspec.Struct, frozen=True):
    """Measurement with a field that cannot be checked."""

    stamp: int
    text: str


class Without(msgspec.Struct, frozen=True):
    """Measurement without a stamp."""

    speed: float


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        (GroundSpeed, "another", "there is such a sensor already"),
        (Without, "radar", "there is such a sensor already"),
        (Without, "gyro", "there is such a sensor already"),
        (Mark, "mark", "there is such a sensor already"),
        (Without, "without", "the first field must be stamp"),
        (Unnamed, "unnamed", "Unnamed.text: cannot be"),
    ],
)
def test_what_cannot_be_a_sensor_is_refused(kind: type, name: str, message: str):
    model = type("Other", (Radar,), {"name": name})()
    with pytest.raises(EstimatorError, match=message):
        register(kind, model)
    uneven = type("Uneven", (Radar,), {"name": name, "components": ("one", "two")})()
    with pytest.raises(EstimatorError, match="one inflated state for each component"):
        register(kind, uneven)
    far = type("Far", (Radar,), {"name": name, "inflated": (999,)})()
    with pytest.raises(EstimatorError, match=r"inflated states are 0 to \d+, found \(999,\)"):
        register(kind, far)
    with pytest.raises(EstimatorError, match=r"a FixModel\(\) is needed"):
        register(kind, Radar)


def test_an_estimator_refuses_sensors_that_were_registered_after_it_was_made() -> None:
    unregister(GroundSpeed)
    estimator = PoseEstimator(ALPHA)
    register(GroundSpeed, Radar())
    for measurement in drive(1.0):
        if isinstance(measurement, GroundSpeed):
            with pytest.raises(EstimatorError, match="GroundSpeed was registered after"):
                estimator.feed(measurement)
        else:
            assert estimator.feed(measurement) in (True, False)


class BrokenRadar(Radar):
    """Radar whose readings above 10 m/s break its model, one way or another."""

    breaks: object = None

    def linearise(self, measurement: GroundSpeed, predicted: Prediction) -> Linearised:
        if measurement.speed <= 10.0:
            return super().linearise(measurement, predicted)
        if isinstance(self.breaks, Exception):
            raise self.breaks
        return self.breaks


@pytest.fixture
def broken() -> BrokenRadar:
    unregister(GroundSpeed)
    model = BrokenRadar()
    register(GroundSpeed, model)
    return model


@pytest.mark.parametrize("late", [0, 400_000_000])
def test_a_reading_that_raises_is_as_if_it_had_not_been_there(broken: BrokenRadar, late: int):
    broken.breaks = ValueError("bad frame")
    estimator, without = fed(drive()), fed(drive())
    with pytest.raises(ValueError, match="bad frame"):
        estimator.feed(GroundSpeed(estimator.stamp + 1 - late, 20.0, 1e-4))
    after = drive(5.0)[len(drive()) :]
    for one in (estimator, without):
        for measurement in [*after, seen(EPOCH + 4_200_000_001)]:
            assert one.feed(measurement)
    assert (estimator.state == without.state).all()
    assert (estimator.covariance == without.covariance).all()


@pytest.mark.parametrize("part", range(3))
def test_what_is_not_finite_is_rejected(broken: BrokenRadar, part: int):
    parts = [np.zeros(1), np.zeros((1, s.SIZE)), np.eye(1)]
    parts[part] = parts[part] * np.nan
    broken.breaks = Linearised(*parts)
    estimator = fed(drive())
    before, stamp = estimator.state, estimator.stamp
    for k in range(1, 40):
        assert not estimator.feed(GroundSpeed(stamp + k * 200_000, 20.0, 1e-4))
    assert estimator.health.sensors["radar"].rejected == {"not finite": 39}
    assert (estimator.state == before).all()


@pytest.mark.parametrize(
    "breaks",
    [
        None,
        (0.5, np.zeros((1, s.SIZE)), np.eye(1)),
        (np.zeros(1), np.zeros(s.SIZE), np.eye(1)),
        (np.zeros(1), np.zeros((1, s.SIZE)), 1e-4),
        (np.zeros(1), np.zeros((1, s.SIZE)), -np.eye(1)),
    ],
)
def test_other_shapes_and_negative_variances_are_refused_by_the_sensors_name(
    broken: BrokenRadar, breaks: object
):
    broken.breaks = breaks
    estimator = fed(drive())
    with pytest.raises(EstimatorError, match="radar: linearise must return z, H and R of shapes"):
        estimator.feed(GroundSpeed(estimator.stamp + 1, 20.0, 1e-4))
