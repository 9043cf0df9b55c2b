"""The compiled filter and the plain one are the same filter."""

from functools import cache

import numpy as np
import pytest

from conftest import thorough
from fed_estimators import feed_all
from icreckon import GateSettings, PoseEstimator, Scenario, Settings, Terrain, load_robot, simulate
from icreckon.estimator.base import state
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.robot.variants import (
    VARIANTS,
    Variant,
    find_variant,
    initial_parameters,
    motion_model,
    register,
)
from same_runs import apart, assert_same_estimate

ALPHA = load_robot("auriga-alpha")
CORRELATED = ((0.04, 0.01, -0.02), (0.01, 0.05, 0.03), (-0.02, 0.03, 0.5))
START = {"start": (1.0, 2.0, 0.5), "start_sigma": (0.1, 0.1, 0.1)}


# --- the motion models ------------------------------------------------------------------------------

ROUNDING = 1e-12
# eta2 [1/N²] is a very small number.
UNITS = np.ones(state.SIZE)
UNITS[state.ETA2] = 1e-5
WEIGHT = ALPHA.constants.mass * 9.81
NASTY = [
    (0.0, 0.0), (0.5, 0.5), (-0.5, -0.5), (0.7, -0.7), (-0.7, 0.7), (0.0, 0.8), (0.8, 0.0),
    (-1e-300, 1e-300), (0.5, 0.5 + 1e-9), (1e-13, -1e-13),
    # Beyond the table of the friction model, and of anything that drives.
    (9.0, -3.0), (-40.0, 55.0),
]  # fmt: skip


def points():
    rng = np.random.default_rng(1)
    for V_l, V_r in [*rng.uniform(-1.2, 1.2, (20, 2)).tolist(), *NASTY]:
        slip = tuple(rng.normal(scale=0.1, size=3).tolist())
        yield V_l, V_r, rng.uniform(0.7, 1.3, 9), slip
        yield V_l, V_r, np.ones(9), (0.0, 0.0, 0.0)
        # From no real vehicle: everything held at its limit.
        yield V_l, V_r, rng.uniform(-30.0, 30.0, 9), slip


def assert_same(found, expected, rel=ROUNDING):
    for one, other in zip(flat(found), flat(expected), strict=True):
        assert one == pytest.approx(other, rel=rel, abs=1e-13)


def flat(result):
    if isinstance(result, tuple | list):
        return [number for part in result for number in flat(part)]
    return [result]


def ekfs(variant):
    """The textbook's filter and a compiled one, of one motion model each."""
    compiled = PoseEstimator(ALPHA, variant.name)._reckoning.ekf
    return IcrEkf(motion_model(ALPHA, variant)), compiled


def put_on_a_slope(ekf, number):
    """Slopes of up to more than anything drives on or than there are, and tracks of unlike radii."""
    factor = 15.0 if number % 6 == 5 else 1.0
    ekf.x[state.GRAVITY] = factor * np.array([0.7 * (number % 5) - 1.0, 3.0 - 0.9 * (number % 7)])
    ekf.x[state.TRACK_SCALE] = 0.01 * (number % 3)
    ekf.x[state.TRACK_DIFFERENCE] = 0.02 * (number % 4) - 0.03


def assert_same_twist(plain, compiled, left, right, slip_shares, rel=ROUNDING):
    expected = plain.twist_model(left, right, slip_shares)
    found = compiled.evaluation(compiled, left, right, slip_shares)
    if np.abs(flat(expected.motion)).max() < 1e9:
        assert_same(found.motion, expected.motion, rel)
        assert found.twist == pytest.approx(expected.twist, rel=rel, abs=1e-13)
        of_unit, expected_of_unit = found.jacobian * UNITS, expected.jacobian * UNITS
        assert of_unit == pytest.approx(expected_of_unit, rel=10.0 * rel, abs=1e-13)
        assert found.by_speeds == pytest.approx(expected.by_speeds, rel=rel, abs=1e-13)
    return expected


@pytest.mark.parametrize("name", ["inertia-online", "full-linear"])
def test_explicit_models_are_the_same_compiled(name):
    variant = find_variant(name)
    plain, compiled = ekfs(variant)
    start = initial_parameters(ALPHA, variant)
    held = 0
    for number, (V_l, V_r, factors, slip) in enumerate(points()):
        for ekf in (plain, compiled):
            ekf.x[state.PARAMETERS] = start * factors
            ekf.x[state.SLIP], ekf.x[state.FAST_SLIP] = slip, slip[::-1]
            put_on_a_slope(ekf, number)
        # The forces lag behind a motion at other speeds.
        plain.begin_step(0.2 * (1 + number % 4), V_r, 0.3 * V_l)
        compiled.model.recall(plain.model.memory)
        expected = assert_same_twist(
            plain, compiled, V_l, V_r, (0.9, 0.8, 0.5 + 0.25 * (number % 3))
        )
        held += abs(expected.motion.u) > WEIGHT
    assert held > 10 or name == "full-linear"


# --- the estimator ----------------------------------------------------------------------------------


@cache
def everything():
    """All kinds of measurements: standstill, wrong ones that are gated and believed, holes, late ones."""
    scenario = Scenario(
        duration=10.7, trajectory="aggressive", track_rate=25.0, imu_rate=50.0, fix_rate=10.0, seed=5,
        terrain=Terrain(slope_deg=5.0, uphill_deg=40.0),
    )  # fmt: skip
    # It stands for the first three seconds.
    log = simulate(scenario, ALPHA).part(3.0, 10.7)
    rng = np.random.default_rng(6)
    measurements = []
    for m in log.measurements():
        time = (m.stamp - log.start) * 1e-9
        match m:
            case TrackSpeeds():
                if 2.6 < time < 3.2 or 3.5 < time < 4.3:
                    continue
                if 5.7 < time < 6.7:
                    m = TrackSpeeds(m.stamp, 0.0, 0.0)
                # Stuck.
                if time > 6.8:
                    m = TrackSpeeds(m.stamp, 0.123, m.right)
            case ImuSample(stamp, (_, _, w), force):
                if 2.3 < time < 2.6:
                    continue
                if 5.8 < time < 6.7:
                    w, force = 0.002 + 1e-4 * rng.normal(), (0.0, 0.01 * rng.normal(), 9.81)
                if 4.4 < time < 4.7:
                    w += 30.0
                if 4.8 < time < 5.3:
                    # Too slowly for a jump.
                    w += 12.0 * (1.0 - abs(time - 5.05) / 0.25)
                if 5.3 < time < 5.6:
                    force = (0.0, 40.0, 9.81)
                if 0.3 < time < 0.5:
                    force = None
                m = ImuSample(stamp, (0.0, 0.0, w), force)
            case PositionFix():
                if time > 2.3 and len(measurements) % 3 == 0:
                    continue
        measurements.append(m)
        if isinstance(m, TrackSpeeds) and 5.9 < time < 6.6:
            measurements.append(ZeroVelocity(m.stamp + 10_000_000 * (int(10.0 * time) % 3)))
        if isinstance(m, PositionFix) and 0.6 < time < 2.3:
            away = 3.0 if 1.0 < time < 2.2 else 0.0
            # Some with an IMU sample, some between two.
            stamp = m.stamp + 7_000_000 * (int(10.0 * time) % 2)
            measurements[-1] = PositionFix(stamp, m.x + away, m.y, m.variance)
            measurements.append(BodyVelocity(stamp, 0.4, 0.01, 0.01))
            measurements.append(HeadingFix(stamp, 0.3 * rng.normal(), 0.5))
            for at in (stamp, stamp + 3_000_000):
                pose = PoseFix(at, m.x + away, m.y, rng.normal(), CORRELATED)
                measurements += [pose, ZeroVelocity(at)]
    # Some come late.
    arrival = [
        m.stamp + (100_000_000 if rng.random() < 0.01 else 0) - log.start for m in measurements
    ]
    return [measurements[index] for index in np.argsort(arrival, kind="stable")]


@pytest.mark.parametrize(
    "variant", ["inertia-online", *map(thorough, sorted(VARIANTS.keys() - {"inertia-online"}))]
)
def test_compiled_agrees_with_plain(variant):
    gates = GateSettings(patience=0.15)
    settings = [Settings(engine=engine, gates=gates) for engine in ("plain", "compiled")]
    plain, compiled = (PoseEstimator(ALPHA, variant, settings=one, **START) for one in settings)
    before = 0.0
    for number, m in enumerate(everything()):
        assert plain.feed(m) == compiled.feed(m)
        if number % 20 == 0:
            assert apart(compiled, plain.state, plain.covariance, before) < 1e-9
            before = np.sqrt(np.diagonal(plain.covariance))
            assert (compiled.covariance == compiled.covariance.T).all()
    assert_same_estimate(compiled, plain)
    a = plain.health
    assert compiled.health.rejections() == a.rejections()
    assert a.standstill_updates > 10
    assert a.track_gaps == 2
    assert a.times["stuck"] > 0
    # The gyro's gate is wide where it alone shows the turning.
    wide = variant in ("gyro", "differential")
    assert wide or a.sensors["gyro"].rejected["gate"] > 0
    assert a.sensors["gyro"].rejected["jumped"] >= 10
    forces = ("accelerometer_y",) if VARIANTS[variant].accelerometers else ()
    assert all(a.sensors[name].rejected["gate"] > 0 for name in forces)
    assert a.sensors["position"].rejected["gate"] >= 10
    assert a.sensors["pose"].degrees > 10
    assert a.sensors["zero velocity"].degrees > 100
    # Re-acquired after some time: used, but no degree of freedom.
    many = {"position": 2} if wide else {"position": 2, "pose": 3}
    for name in (*(() if wide else ("gyro",)), *forces, *many):
        degrees = many.get(name, 1)
        assert a.sensors[name].degrees < degrees * a.sensors[name].used


# --- a model with memory ----------------------------------------------------------------------------


class Sluggish:
    """A motion model that is not compiled and remembers: the published one, a little late."""

    def __init__(self):
        self._inner, self._tracks = LaggedIndexMotion(ALPHA.constants), np.zeros(2)

    @property
    def vehicle(self):
        return self._inner.vehicle

    @property
    def taught_by_imu(self):
        return self._inner.taught_by_imu

    @property
    def memory(self):
        return np.concatenate([self._tracks, self._inner.memory])

    def recall(self, memory):
        self._inner.recall(memory[2:])
        self._tracks = memory[:2]

    def linearise(self, V_l, V_r, parameters, slip, gravity):
        left, right = self._tracks.tolist()
        V_l, V_r = left + 0.5 * (V_l - left), right + 0.5 * (V_r - right)
        found, by = self._inner.linearise(V_l, V_r, parameters, slip, gravity)
        by_speeds = 0.5 * np.array(by.by_speeds)
        return found, by._replace(by_parameters=np.array(by.by_parameters), by_speeds=by_speeds)

    @property
    def bounds(self):
        return self._inner.bounds

    def steering_efficiency(self, parameters):
        return self._inner.steering_efficiency(parameters)

    def begin_step(self, dt, V_l, V_r, parameters, gravity):
        self._inner.begin_step(dt, V_l, V_r, parameters, gravity)
        share = -np.expm1(-dt / 0.2)
        self._tracks = self._tracks + share * (np.array([V_l, V_r]) - self._tracks)


@pytest.fixture
def sluggish():
    """A registered variant of the name."""
    register(Variant("sluggish", "inertia", online=True, motion=lambda _: Sluggish()))
    yield "sluggish"
    del VARIANTS["sluggish"]


def test_what_a_model_remembers_goes_back_in_time_with_the_filter(sluggish, tmp_path):
    some = everything()[405:445]  # with late ones
    late = feed_all(PoseEstimator(ALPHA, sluggish, **START), some)
    in_order = PoseEstimator(ALPHA, sluggish, **START)
    feed_all(in_order, sorted(some, key=lambda m: m.stamp))
    memory = late._reckoning.ekf.model.memory
    assert np.abs(memory).max() > 0.01
    assert (memory == in_order._reckoning.ekf.model.memory).all()
    assert (late.state == in_order.state).all()

    before = feed_all(PoseEstimator(ALPHA, sluggish, **START), some[:25])
    before.save(tmp_path / "saved.json")
    after = PoseEstimator.restore(tmp_path / "saved.json", ALPHA)
    for m in some[25:]:
        assert before.feed(m) == after.feed(m)
    assert (before.state == after.state).all()
    assert (before._reckoning.ekf.model.memory == after._reckoning.ekf.model.memory).all()
