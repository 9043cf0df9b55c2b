"""Equations (1) to (30) of the paper: numbers worked out by hand, and identities."""

import numpy as np
import pytest

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
