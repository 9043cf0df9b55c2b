"""Equations (1) to (30) of the paper: numbers worked out by hand, and identities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from icreckon import IndexValues, load_robot
from icreckon.estimator.motion.icr import (
    Icrs,
    PaperTwist,
    direct,
    icrs_from_indices,
    icrs_from_twist,
    indices_at_inertia,
    indices_from_icrs,
    inertial_force,
    inverse,
    symmetry_coordinates,
    velocity_of_centre_of_mass,
)
from smooth_inertia import inertial_force_magnitude, signed_inertia

# A vehicle with L eta = 1 m, so that everything can be worked out by hand.
GAUGE = 0.5
INDICES = IndexValues(zeta=0.04, epsilon=0.1, eta=2.0)
ICRS = Icrs(x_ICRl=-0.4, x_ICRr=0.6, y_ICR=0.04)
V_L, V_R = 0.2, 0.7
TWIST = PaperTwist(v_x=0.02, v_y=0.4, w=0.5)
MASS, X_CM, Y_CM = 200.0, -0.1, 0.2

# zeta0, zeta1, epsilon0, epsilon1, eta0, eta1, eta2 of Auriga-alpha, section III-C.
PUBLISHED = (0.67134, 0.048, 0.0002424, 0.106, 0.0011, 2.62, 0.0019, 0.00001)

speeds = st.floats(-3.0, 3.0)
indices = st.builds(IndexValues, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(1.0, 8.0))
twists = st.builds(PaperTwist, speeds, speeds, speeds)


def test_motion_icrs_and_indices_by_hand():
    assert icrs_from_twist(V_L, V_R, TWIST) == pytest.approx(ICRS, rel=1e-14)
    assert indices_from_icrs(ICRS, GAUGE) == pytest.approx(INDICES, rel=1e-14)
    assert icrs_from_indices(INDICES, GAUGE) == pytest.approx(ICRS, rel=1e-14)
    assert direct(V_L, V_R, INDICES, GAUGE) == pytest.approx(TWIST, rel=1e-14)
    assert inverse(TWIST.v_y, TWIST.w, INDICES, GAUGE) == pytest.approx((V_L, V_R), rel=1e-14)
    assert symmetry_coordinates(0.2, 0.7, 0.6) == pytest.approx((-0.5, 0.62))


def test_inertia_by_hand():
    assert velocity_of_centre_of_mass(TWIST, X_CM, Y_CM) == pytest.approx((-0.08, 0.35))
    assert inertial_force(TWIST, MASS, X_CM, Y_CM) == pytest.approx((35.0, 8.0))
    assert inertial_force_magnitude(TWIST, MASS, X_CM, Y_CM) == pytest.approx(np.sqrt(1289.0))
    assert signed_inertia(TWIST, MASS, X_CM) == pytest.approx((-35.0, 35.0))


@pytest.mark.parametrize(
    ("x_1", "x_2", "zeta", "epsilon", "eta"),
    [
        (0.3, 0.9, 0.07224, 0.216, 2.91),
        (-0.3, 0.9, 0.07224, -0.004, 2.53),
        (0.3, -0.9, 0.02376, -0.004, 2.53),
        (-0.3, -0.9, 0.02376, 0.216, 2.91),
        (0.0, 0.9, 0.07224, 0.106, 2.72),
        (0.3, 0.0, 0.048, 0.106, 2.72),
    ],
)
def test_literal_polynomials_at_100_newton(x_1, x_2, zeta, epsilon, eta):
    values = indices_at_inertia(100.0, x_1, x_2, PUBLISHED)
    assert values == pytest.approx((zeta, epsilon, eta), rel=1e-14)


@given(V_l=speeds, V_r=speeds, values=indices, gauge=st.floats(0.2, 2.0))
def test_inverse_undoes_direct(V_l, V_r, values, gauge):
    twist = direct(V_l, V_r, values, gauge)
    back = inverse(twist.v_y, twist.w, values, gauge)
    assert back == pytest.approx((V_l, V_r), abs=1e-13)


@given(V_l=speeds, difference=st.floats(0.01, 3.0), values=indices, gauge=st.floats(0.2, 2.0))
def test_indices_of_a_motion_are_those_it_was_made_with(V_l, difference, values, gauge):
    V_r = V_l + difference
    twist = direct(V_l, V_r, values, gauge)
    found = indices_from_icrs(icrs_from_twist(V_l, V_r, twist), gauge)
    assert found == pytest.approx(values, abs=1e-10)


@given(V_l=speeds, V_r=speeds, values=indices)
def test_each_track_touches_the_ground_without_slip_at_its_icr(V_l, V_r, values):
    twist = direct(V_l, V_r, values, GAUGE)
    left, right, y = icrs_from_indices(values, GAUGE)
    # Velocity of the track's material at a point: that of the vehicle there, less the track's own.
    for x, speed in ((left, V_l), (right, V_r)):
        assert twist.v_y + twist.w * x == pytest.approx(speed, abs=1e-13)
        assert twist.v_x - twist.w * y == pytest.approx(0.0, abs=1e-13)


@given(twist=twists, mass=st.floats(1.0, 500.0), x_CM=speeds, y_CM=speeds, z_CM=speeds)
def test_inertia_is_minus_mass_times_w_cross_v_of_the_centre_of_mass(twist, mass, x_CM, y_CM, z_CM):
    w = np.array([0.0, 0.0, twist.w])
    v_CM = np.array([twist.v_x, twist.v_y, 0.0]) + np.cross(w, [x_CM, y_CM, z_CM])
    force = -mass * np.cross(w, v_CM)
    rounding = 1e-12 * mass
    assert (*inertial_force(twist, mass, x_CM, y_CM), 0.0) == pytest.approx(force, abs=rounding)
    assert inertial_force_magnitude(twist, mass, x_CM, y_CM) == pytest.approx(
        np.linalg.norm(force), abs=rounding
    )


def test_icrs_of_straight_motion_are_at_infinity():
    straight = PaperTwist(0.0, 0.5, 0.0)
    with pytest.raises(ZeroDivisionError):
        icrs_from_twist(0.5, 0.6, straight)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = icrs_from_twist(
            np.array([0.4]), np.array([0.6]), PaperTwist(*map(np.array, straight))
        )
    assert found.x_ICRl[0] == -np.inf
    assert found.x_ICRr[0] == np.inf


def test_robot_speaks_the_papers_language():
    robot = load_robot("auriga-alpha")
    assert robot.centre_of_mass_paper == pytest.approx((-0.015, 0.04))
    assert tuple(robot.indices.as_array()) == (*PUBLISHED, 0.0)
    constant = robot.constant_indices
    # 0.086 = (0.630 - 0.458) / 2 and 2.59048 = 1.088 / 0.42.
    assert (constant.zeta0, constant.epsilon0) == pytest.approx((0.0482, 0.086))
    assert constant.eta0 == pytest.approx(2.5904762, abs=1e-7)
    assert constant.as_array()[[2, 4, 6, 7, 8]].tolist() == [0.0, 0.0, 0.0, 0.0, 0.0]
