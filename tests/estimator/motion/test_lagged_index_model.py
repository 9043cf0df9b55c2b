"""The filter's index model: its derivatives, symmetries and limits, and the paper's motion as its end."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from complex_step import assert_derivatives
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.motion.index_model import solve
from icreckon.estimator.motion.lagged_index_model import LaggedIndexMotion
from icreckon.estimator.motion.motion_model import LEVEL, NO_SLIP, Motion, VehicleConstants
from icreckon.estimator.robot.robot_file import load_robot

ALPHA = load_robot("auriga-alpha")
LAG = 0.2
VEHICLE = VehicleConstants(0.42, 258.0, -0.015, 0.04, 0.05, LAG, 0.2)
PUBLISHED = ALPHA.indices.as_array()
WEIGHT = VEHICLE.mass * GRAVITY
EPSILON_F = 8
# Every parameter at work: epsilon_F is not published.
USUAL = PUBLISHED + np.eye(9)[EPSILON_F] * 0.3
# Signs of the parameters of a mirrored vehicle, and of one that is turned by 180 degrees: the force of
# inertia and epsilon change theirs in both, zeta and the force along the tracks if it is turned.
MIRRORED = np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
TURNED = np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0])


def driven(
    model: LaggedIndexMotion,
    speeds: Floats,
    parameters: Floats,
    dt: float = 0.02,
    gravity: tuple[float, float] = LEVEL,
) -> Motion:
    """Motion after steps at track speeds (n, 2)."""
    for V_l, V_r in speeds.tolist():
        model.begin_step(dt, V_l, V_r, parameters, gravity)
    return model.linearise(*speeds[-1].tolist(), parameters, NO_SLIP, gravity)[0]


def steady(
    V_l: float,
    V_r: float,
    parameters: Floats,
    gravity: tuple[float, float] = LEVEL,
    vehicle: VehicleConstants = VEHICLE,
) -> Motion:
    """Motion after a long time at constant track speeds."""
    return driven(
        LaggedIndexMotion(vehicle), np.tile([V_l, V_r], (1000, 1)), parameters, 0.02, gravity
    )


def moving(rng: np.random.Generator, **changes: float) -> LaggedIndexMotion:
    """A model whose forces are anything but steady."""
    model = LaggedIndexMotion(VEHICLE._replace(**changes))
    model.recall(np.array([400.0 * rng.normal(), 0.5 * rng.normal(), 2.0 * rng.normal(), 1.0]))
    return model


def test_derivatives_are_the_complex_step_ones() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        V_l, V_r = rng.uniform(-1.0, 1.0, 2).tolist()
        parameters = USUAL * rng.uniform(0.6, 1.4, 9)
        parameters[5] = max(parameters[5], 1.2)
        slip, gravity = rng.normal(scale=0.1, size=3), rng.normal(scale=1.5, size=2)
        assert_derivatives(moving(rng), V_l, V_r, parameters, tuple(slip), tuple(gravity))


@pytest.mark.parametrize("V_l", [0.02, -0.03, 0.0])
def test_derivatives_where_a_track_hardly_rolls(V_l: float) -> None:
    """Its resistance grows with its speed there."""
    rng = np.random.default_rng(2)
    for V_r in (0.5, -0.4, 0.01):
        assert_derivatives(moving(rng), V_l, V_r, USUAL, NO_SLIP, (0.3, -0.2))


def beyond(place: int, value: float, gravity: tuple[float, float]) -> Floats:
    parameters = USUAL.copy()
    parameters[place] = value
    motion, _ = LaggedIndexMotion(VEHICLE).linearise(0.2, 0.9, parameters, NO_SLIP, gravity)
    half = 0.5 * VEHICLE.gauge * motion.indices.eta
    found = np.array([motion.indices.zeta / (2.0 * half), motion.indices.epsilon / half])
    assert np.isclose(np.abs(found), [1.0, 0.98]).any() or motion.indices.eta == 1.0
    return parameters


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("place", "value"),
    [(1, 3.0), (2, 0.01), (3, 2.0), (4, 0.02), (EPSILON_F, 30.0), (5, -9.0), (6, -0.05)],
)
def test_derivatives_at_the_limits_of_the_indices(place: int, value: float, side: float) -> None:
    gravity = (-2.0, -0.8)
    parameters = beyond(place, side * value if place < 5 else value, gravity)
    for V_l, V_r in ((0.2, 0.9), (-0.6, 0.3), (0.9, 0.2)):
        assert_derivatives(
            LaggedIndexMotion(VEHICLE), V_l, V_r, parameters, (0.01, 0.02, 0.03), gravity
        )


@pytest.mark.parametrize("gravity", [(30.0, 0.1), (-30.0, 0.1), (0.2, 30.0), (0.2, -30.0)])
def test_derivatives_where_the_forces_are_at_their_limits(gravity: tuple[float, float]) -> None:
    """More than the weight acts on no index; its derivative is zero."""
    parameters = USUAL * [1.0, 1.0, 0.2, 1.0, 0.05, 1.0, 0.1, 0.1, 0.3]
    motion, by = LaggedIndexMotion(VEHICLE).linearise(0.3, 0.8, parameters, NO_SLIP, gravity)
    assert_derivatives(LaggedIndexMotion(VEHICLE), 0.3, 0.8, parameters, (0.1, 0.2, 0.3), gravity)
    if abs(gravity[0]) > 1.0:
        assert abs(motion.force) == pytest.approx(WEIGHT)
        assert abs(motion.u) == pytest.approx(30.0 * VEHICLE.mass)
        assert not np.array(by.by_gravity)[:, 0].any()
    else:
        assert not np.array(by.by_gravity)[:, 1].any()


def test_each_gain_has_a_derivative_in_a_turn_and_none_on_a_straight_line() -> None:
    rng = np.random.default_rng(3)
    _, by = moving(rng).linearise(0.2, 0.8, USUAL, NO_SLIP, (0.4, 0.5))
    assert (np.abs(by.by_parameters).max(axis=0) > 0.0).tolist() == [False] + 8 * [True]
    _, by = moving(rng).linearise(0.5, 0.5, USUAL, NO_SLIP, (0.4, 0.5))
    assert not np.array(by.by_parameters).any()
    assert not np.array(by.by_gravity).any()


SPEEDS = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
SLOPES = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
FACTORS = st.tuples(*[st.floats(0.5, 1.5)] * 9)


@pytest.mark.parametrize(
    ("along", "signs", "of_twist"),
    [(1.0, MIRRORED, (-1.0, 1.0, -1.0)), (-1.0, TURNED, (-1.0, -1.0, 1.0))],
    ids=["mirrored", "turned by 180 degrees"],
)
@settings(max_examples=50)
@given(speeds=st.lists(SPEEDS, min_size=2, max_size=10), gravity=SLOPES, factors=FACTORS)
def test_a_vehicle_that_is_mirrored_or_turned_around_makes_that_motion(
    along, signs, of_twist, speeds, gravity, factors
):
    """Turned, tracks change sides and direction, and so does the slope under the robot."""
    parameters, V = USUAL * factors, np.array(speeds)
    motion = driven(LaggedIndexMotion(VEHICLE), V, parameters, gravity=gravity)
    other = LaggedIndexMotion(VEHICLE._replace(x_CM=-VEHICLE.x_CM))
    gravity = -gravity[0], along * gravity[1]
    found = driven(other, along * V[:, ::-1], parameters * signs, gravity=gravity)
    assert found.twist == pytest.approx(np.array(motion.twist) * of_twist, abs=1e-12)
    assert found.u == pytest.approx(-motion.u, abs=1e-8)


@settings(max_examples=30)
@given(speeds=SPEEDS, factors=st.tuples(*[st.floats(0.9, 1.1)] * 8))
def test_in_steady_motion_on_level_ground_it_is_the_papers_model(speeds, factors):
    parameters = np.append(PUBLISHED[:8] * factors, 0.0)
    found, expected = steady(*speeds, parameters), solve(*speeds, parameters, VEHICLE)
    assert found.twist == pytest.approx(expected.twist, abs=1e-9)
    assert found.indices == pytest.approx(expected.indices, abs=1e-8)
    assert found.u == pytest.approx(expected.u, abs=1e-6)


def test_without_gains_it_is_the_model_of_constant_icrs_on_any_slope() -> None:
    constant = ALPHA.constant_indices.as_array()
    for gravity in ((0.0, 0.0), (2.0, -1.0), (-3.0, 3.0)):
        found = steady(0.2, 0.7, constant, gravity, VEHICLE._replace(zeta_F=0.0))
        assert found.twist == pytest.approx(solve(0.2, 0.7, constant, VEHICLE).twist, abs=1e-14)


def test_gravity_acts_as_the_force_of_inertia_that_is_as_large() -> None:
    """Friction cannot tell them apart."""
    gravity = (0.7, 0.0)
    on_slope = steady(0.3, 0.5, PUBLISHED, gravity)
    model = LaggedIndexMotion(VEHICLE)
    model.recall(np.array([on_slope.u, 0.4, 0.0, 1.0]))
    level = model.linearise(0.3, 0.5, PUBLISHED, NO_SLIP, LEVEL)[0]
    assert on_slope.twist == pytest.approx(level.twist, abs=1e-12)
    inertia = -VEHICLE.mass * on_slope.twist.w
    inertia *= on_slope.twist.v_y + VEHICLE.x_CM * on_slope.twist.w
    assert on_slope.u == pytest.approx(inertia - VEHICLE.mass * 0.7, abs=1e-6)


@pytest.mark.parametrize(("V_l", "V_r"), [(0.3, 0.7), (0.7, 0.3), (-0.7, -0.3), (-0.3, 0.1)])
def test_a_force_along_the_tracks_takes_from_their_speed_in_a_turn(V_l: float, V_r: float) -> None:
    """Uphill and against rolling resistance, tracks slip; downhill the robot is faster than they are."""
    parameters = np.append(PUBLISHED[:8], 0.3)
    vehicle = VEHICLE._replace(rolling_resistance=0.0)
    level, uphill, downhill = (
        steady(V_l, V_r, parameters, (0.0, forward), vehicle).twist for forward in (0.0, -2.0, 2.0)
    )
    assert uphill.v_y < level.v_y < downhill.v_y
    shift = abs(level.w) * 0.3 * 2.0 / GRAVITY
    assert downhill.v_y - level.v_y == pytest.approx(shift, rel=0.1)
    rolling = steady(V_l, V_r, parameters, LEVEL, VEHICLE).twist
    assert abs(rolling.v_y) < abs(level.v_y) or np.sign(V_l) != np.sign(V_r)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_turn_on_a_slope_slides_down_it_without_an_acceleration(side: float) -> None:
    """The slide has a constant direction in the world; the load alone is behind the middle."""
    parameters = np.append(PUBLISHED[:8], 0.3)
    vehicle, uphill = VEHICLE._replace(rolling_resistance=0.0), (0.0, -2.0)
    level, found = (
        steady(-0.3 * side, 0.3 * side, parameters, gravity, vehicle) for gravity in (LEVEL, uphill)
    )
    slide = abs(level.twist.w) * 0.3 * 2.0 / GRAVITY
    assert found.twist.v_y == pytest.approx(level.twist.v_y - slide, rel=1e-9)
    assert found.u == pytest.approx(level.u, abs=1e-9)
    assert found.indices.zeta == pytest.approx(level.indices.zeta - 0.2 * 2.0 / GRAVITY, abs=1e-9)


def test_forces_lag_whatever_the_step() -> None:
    """After a time constant, the rest is 1/e, in one step or in many."""
    speeds = (0.3, 0.8)
    # Without gains the force does not act on itself, and its lag is exact.
    parameters = ALPHA.constant_indices.as_array()
    end = steady(*speeds, parameters).u
    for count in (1, 2, 10, 1000):
        model = LaggedIndexMotion(VEHICLE)
        model.begin_step(1e-12, 0.0, 0.0, parameters, LEVEL)
        for _ in range(count):
            model.begin_step(LAG / count, *speeds, parameters, LEVEL)
        force, V_m, acceleration, _ = model.memory
        assert force == pytest.approx(end * -np.expm1(-1.0), rel=1e-9)
        assert V_m == pytest.approx(0.55 * -np.expm1(-1.0), rel=1e-9)
        assert acceleration == pytest.approx(0.55 * np.exp(-1.0) / LAG, rel=1e-9)


def test_the_first_step_begins_with_the_force_of_its_motion_and_without_acceleration() -> None:
    model = LaggedIndexMotion(VEHICLE)
    model.begin_step(0.01, 0.3, 0.8, ALPHA.constant_indices.as_array(), LEVEL)
    end = steady(0.3, 0.8, ALPHA.constant_indices.as_array())
    assert model.memory == pytest.approx([end.u, 0.55, 0.0, 1.0])


@pytest.mark.parametrize("dt", [0.002, 0.01, 0.05])
def test_a_lasting_acceleration_is_felt_in_full(dt: float) -> None:
    """But for that of half a step, by which mean speeds are late."""
    model = LaggedIndexMotion(VEHICLE)
    for k in range(round(4.0 / dt)):
        V = 0.5 * dt * k
        model.begin_step(dt, V, V, USUAL, LEVEL)
    assert model.memory[2] == pytest.approx(0.5, rel=0.55 * dt / LAG)


def test_evaluating_changes_no_memory_and_going_back_repeats_the_motion() -> None:
    rng = np.random.default_rng(4)
    model, speeds = LaggedIndexMotion(VEHICLE), rng.uniform(-1.0, 1.0, (40, 2))
    driven(model, speeds[:20], USUAL)
    kept = model.memory
    copy = kept.copy()
    once = driven(model, speeds[20:], USUAL, gravity=(0.5, 0.2))
    np.testing.assert_array_equal(kept, copy)
    model.recall(kept)
    assert driven(model, speeds[20:], USUAL, gravity=(0.5, 0.2)) == once


@settings(max_examples=300)
@given(
    speeds=st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)), min_size=1, max_size=10),
    gravity=st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)),
    factors=st.tuples(*[st.floats(-30.0, 30.0)] * 9),
    dt=st.sampled_from([1e-6, 0.01, 0.1, 1.0, 30.0]),
)
def test_no_parameters_make_it_leave_what_tracks_can_do(speeds, gravity, factors, dt):
    """Forward it is between its tracks, and it turns no faster than the ideal differential drive."""
    V = np.array(speeds)
    motion = driven(LaggedIndexMotion(VEHICLE), V, USUAL * factors, dt, gravity)
    low, high = V[-1].min(), V[-1].max()
    assert low - 1e-12 <= motion.twist.v_y <= high + 1e-12
    D = V[-1, 1] - V[-1, 0]
    assert abs(motion.twist.w) <= abs(D) / VEHICLE.gauge * (1.0 + 1e-12)
    assert motion.twist.w * D >= 0.0
    # The ICR is no further away than the effective gauge.
    assert abs(motion.twist.v_x) <= abs(D) * (1.0 + 1e-12)
    assert motion.indices.eta >= 1.0
    assert abs(motion.force) <= WEIGHT
