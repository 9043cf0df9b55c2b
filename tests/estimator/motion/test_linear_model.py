"""The linear model: constant ICRs of two tracks, its derivatives, its bounds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from complex_step import assert_derivatives
from icreckon import IndexValues, PoseEstimator, load_robot
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import direct
from icreckon.estimator.motion.linear_model import (
    LEAST_TURN,
    PARAMETER_NAMES,
    LinearMotion,
    coefficients,
)
from icreckon.estimator.motion.motion_model import LEVEL, NO_SLIP
from icreckon.estimator.robot.variants import find_variant, initial_parameters, parameter_names

ALPHA = load_robot("auriga-alpha")
GAUGE = ALPHA.vehicle.track_gauge
MODEL = LinearMotion(ALPHA.constants)
VARIANT = find_variant("full-linear")
START = initial_parameters(ALPHA, VARIANT)

speeds = st.floats(-1.5, 1.5)
indices = st.builds(IndexValues, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(1.0, 8.0))


def padded(six: Floats) -> Floats:
    return np.concatenate([six, np.zeros(3)])


@given(V_l=speeds, V_r=speeds, values=indices)
def test_it_contains_constant_icrs(V_l: float, V_r: float, values: IndexValues) -> None:
    parameters = padded(coefficients(values, GAUGE))
    motion, _ = MODEL.linearise(V_l, V_r, parameters, NO_SLIP, (0.7, -0.4))
    assert motion.twist == pytest.approx(direct(V_l, V_r, values, GAUGE), abs=1e-12)
    assert MODEL.steering_efficiency(parameters) == pytest.approx(values.eta)
    if abs(V_r - V_l) > 1e-3:
        assert motion.indices == pytest.approx(values, abs=1e-9)


@given(V_l=speeds, V_r=speeds, values=indices, left=st.floats(0.8, 1.2), right=st.floats(0.8, 1.2))
def test_it_contains_tracks_of_different_radii(V_l, V_r, values, left, right):
    parameters = coefficients(values, GAUGE) * np.tile([left, right], 3)
    motion, _ = MODEL.linearise(V_l, V_r, padded(parameters), NO_SLIP, LEVEL)
    expected = direct(left * V_l, right * V_r, values, GAUGE)
    assert motion.twist == pytest.approx(expected, abs=1e-12)


def test_derivatives_are_the_complex_step_ones() -> None:
    rng = np.random.default_rng(1)
    for V_l, V_r in [*rng.uniform(-1.0, 1.0, (40, 2)).tolist(), (0.0, 0.0), (0.5, 0.5)]:
        parameters = START + 0.2 * rng.normal(size=9)
        slip, gravity = rng.normal(scale=0.1, size=3), rng.normal(size=2)
        assert_derivatives(MODEL, V_l, V_r, parameters, tuple(slip), tuple(gravity))


def test_gravity_and_the_places_without_a_parameter_act_on_nothing() -> None:
    one, by = MODEL.linearise(0.3, 0.7, START, NO_SLIP, (3.0, -2.0))
    other, _ = MODEL.linearise(0.3, 0.7, START, NO_SLIP, LEVEL)
    assert one.twist == other.twist
    assert not np.array(by.by_gravity).any()
    assert not np.array(by.by_parameters)[:, 6:].any()


def test_a_standing_or_straight_robot_has_finite_indices() -> None:
    symmetric = padded(coefficients(IndexValues(0.05, 0.1, 2.5), GAUGE))
    for V in (0.0, 0.4):
        motion, _ = MODEL.linearise(V, V, symmetric, NO_SLIP, LEVEL)
        assert np.isfinite(motion.indices).all()
        assert motion.twist == pytest.approx((0.0, V, 0.0), abs=1e-15)


def test_bounds_keep_each_track_turning_the_robot_to_its_own_side() -> None:
    rows = MODEL.bounds
    assert rows.shape == (2, 10)
    assert (rows[:, :-1] @ START > rows[:, -1]).all()
    for place, least in ((4, -LEAST_TURN), (5, LEAST_TURN)):
        at = START.copy()
        at[place] = 0.999 * least
        assert (rows[:, :-1] @ at < rows[:, -1]).sum() == 1
    # No vehicle within them turns the wrong way, and its steering efficiency is finite.
    at = START.copy()
    at[[4, 5]] = -LEAST_TURN, LEAST_TURN
    assert MODEL.linearise(0.1, 0.5, at, NO_SLIP, LEVEL)[0].twist.w > 0.0
    assert 0.0 < MODEL.steering_efficiency(at) < np.inf


def test_the_variant_starts_from_the_constant_icrs_of_the_robot_file() -> None:
    linear, constant = (PoseEstimator(ALPHA, name) for name in ("full-linear", "constant-fixed"))
    assert parameter_names(VARIANT) == (*PARAMETER_NAMES, "", "", "")
    assert list(linear.parameters) == list(PARAMETER_NAMES)
    for V_l, V_r in ((0.2, 0.7), (-0.4, 0.1), (0.5, 0.5)):
        twists = [one._reckoning.ekf.twist_model(V_l, V_r).twist for one in (linear, constant)]
        assert twists[0] == pytest.approx(twists[1], abs=1e-12)
