"""The paper's implicit motion model: its equations and its symmetries."""

import numpy as np
import pytest

from icreckon import load_robot
from icreckon.estimator.motion.icr import direct, indices_at_inertia, symmetry_coordinates
from icreckon.estimator.motion.index_model import solve
from icreckon.estimator.motion.motion_model import VehicleConstants
from smooth_inertia import indices_at_signed_inertia, inertial_force_magnitude, signed_inertia

ALPHA = load_robot("auriga-alpha")
VEHICLE = VehicleConstants(0.42, 258.0, -0.015, 0.04)
# epsilon_F is no parameter of this model.
PUBLISHED = ALPHA.indices.as_array()[:8]
WEIGHT = 258.0 * 9.81
FORMS = ("smooth", "literal")
# The grid of the paper, section II.
GRID = np.linspace(-1.0, 1.0, 21).round(1)
V_L, V_R = (speeds.ravel() for speeds in np.meshgrid(GRID, GRID, indexing="ij"))


def perturbed(count, seed, share=0.5):
    """Track speeds and parameters within `share` of the published ones, physical ones only."""
    rng = np.random.default_rng(seed)
    factors = rng.uniform(1.0 - share, 1.0 + share, (8, count))
    parameters = PUBLISHED[:, None] * factors
    parameters[5] = np.maximum(parameters[5], 1.0)
    return (*rng.uniform(-1.0, 1.0, (2, count)), parameters)


def model(V_l, V_r, twist, parameters, form):
    """One pass from a twist through inertia and indices to a twist, from the paper's equations."""
    gauge, mass, x_CM, y_CM, *_ = VEHICLE
    if form == "smooth":
        indices = indices_at_signed_inertia(*signed_inertia(twist, mass, x_CM), parameters)
    else:
        force = inertial_force_magnitude(twist, mass, x_CM, y_CM)
        indices = indices_at_inertia(
            force, *symmetry_coordinates(V_l, V_r, parameters[0]), parameters
        )
    return direct(V_l, V_r, indices._replace(eta=np.maximum(indices.eta, 1.0)), gauge)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("V_l", "V_r", "parameters"),
    [(V_L, V_R, PUBLISHED), perturbed(20_000, 1), perturbed(20_000, 2, share=0.1)],
    ids=["paper grid", "within 50 %", "within 10 %"],
)
def test_solution_satisfies_the_papers_equations(form, V_l, V_r, parameters):
    motion = solve(V_l, V_r, parameters, VEHICLE, form=form)
    again = model(V_l, V_r, motion.twist, parameters, form)
    for found, expected in zip(motion.twist, again, strict=True):
        assert found == pytest.approx(expected, abs=1e-11)
    by_indices = direct(V_l, V_r, motion.indices, 0.42)
    assert np.array(by_indices) == pytest.approx(np.array(motion.twist), abs=1e-14)


def test_indices_of_a_robot_are_taken_as_they_are():
    assert solve(0.2, 0.7, ALPHA.indices, VEHICLE) == solve(0.2, 0.7, PUBLISHED, VEHICLE)


@pytest.mark.parametrize("form", FORMS)
def test_inertia_of_more_than_the_weight_does_not_move_the_indices(form):
    """Parameters from anywhere: there is a solution, and friction bounds the force in the indices."""
    V_l, V_r, _ = perturbed(20_000, 4)
    share = np.random.default_rng(5).uniform(-2.0, 3.0, (8, 20_000))
    parameters = share * PUBLISHED[:, None]
    parameters[5] = np.maximum(parameters[5], 1.0)
    motion = solve(V_l, V_r, parameters, VEHICLE, form=form)
    assert (np.abs(motion.force) <= WEIGHT).all()
    assert (np.abs(motion.u) > WEIGHT).any()
    forward = motion.twist.v_y + VEHICLE.x_CM * motion.twist.w
    right = motion.twist.v_x - VEHICLE.y_CM * motion.twist.w
    magnitude = np.hypot(forward, right) if form == "literal" else np.abs(forward)
    inertia = VEHICLE.mass * np.abs(motion.twist.w) * magnitude
    np.testing.assert_allclose(np.abs(motion.u), inertia, rtol=1e-9, atol=1e-8 * WEIGHT)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("V", [-1.0, -0.3, 0.0, 0.7])
def test_equal_tracks_drive_straight_whatever_the_parameters(form, V):
    _, _, parameters = perturbed(500, 5)
    motion = solve(np.full(500, V), np.full(500, V), parameters, VEHICLE, form=form)
    assert (motion.twist.w == 0.0).all()
    assert (motion.twist.v_x == 0.0).all()
    assert (motion.twist.v_y == V).all()
    assert (motion.u == 0.0).all()
