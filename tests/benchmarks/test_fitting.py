"""Index models fitted to known motions: each finds itself again, and too little is refused."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from analysis.fitting import KnownMotion, fit_constant, fit_inertia

from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.motion.icr import IndexValues, PaperTwist, direct
from icreckon.estimator.motion.index_model import VehicleConstants, solve
from icreckon.estimator.robot.robot_file import ConstantIcr, Robot, load_robot
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.contact.steady_state import solve_steady


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("auriga-alpha")


@pytest.fixture(scope="module")
def track_speeds() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    return rng.uniform(-0.8, 0.8, 400), rng.uniform(-0.8, 0.8, 400)


def test_constant_icrs_are_found_again(robot, track_speeds):
    true = ConstantIcr(-0.5, 0.7, 0.06)
    other = msgspec.structs.replace(robot, constant_icr=true)
    indices = other.constant_indices
    twist = direct(*track_speeds, IndexValues(indices.zeta0, indices.epsilon0, indices.eta0), 0.42)
    fitted = fit_constant(robot, KnownMotion(*track_speeds, twist)).constant_icr
    assert msgspec.structs.astuple(fitted) == pytest.approx(msgspec.structs.astuple(true))


def test_constant_icrs_are_the_least_squares_ones(robot, track_speeds):
    twist = solve_steady(*track_speeds, contact_of(robot)).twist
    motion = KnownMotion(*track_speeds, twist)
    best = fit_constant(robot, motion)

    def cost(candidate: Robot) -> float:
        i = candidate.constant_indices
        found = direct(*track_speeds, IndexValues(i.zeta0, i.epsilon0, i.eta0), 0.42)
        return sum(
            float(((a - b) ** 2).sum()) * scale
            for a, b, scale in zip(found, twist, (1.0, 1.0, 0.42**2), strict=True)
        )

    # Separate straight lines through the origin for v_x, v_y and w: each is at its own least.
    icr = best.constant_icr
    for change in (0.98, 1.02):
        eta_only = msgspec.structs.replace(
            best,
            constant_icr=ConstantIcr(change * icr.x_ICRl, change * icr.x_ICRr, change * icr.y_ICR),
        )
        assert cost(eta_only) > cost(best)


def test_inertia_based_parameters_are_found_again(robot, track_speeds):
    true = msgspec.structs.replace(
        robot.indices, zeta0=0.06, epsilon0=0.08, epsilon1=8e-4, eta0=2.4, eta1=1.5e-3
    )
    vehicle = VehicleConstants(0.42, 258.0, *robot.centre_of_mass_paper)
    twist = solve(*track_speeds, true.as_array(), vehicle).twist
    fitted = fit_inertia(robot, KnownMotion(*track_speeds, twist)).indices
    np.testing.assert_allclose(fitted.as_array(), true.as_array(), rtol=1e-4)


def test_straight_driving_shows_nothing(robot):
    speeds = np.linspace(0.0, 1.0, 100)
    zero = np.zeros(100)
    motion = KnownMotion(speeds, speeds, PaperTwist(zero, speeds, zero))
    for fit in (fit_constant, fit_inertia):
        with pytest.raises(EstimatorError, match="only 0 of 100 samples turn"):
            fit(robot, motion)


def test_values_that_are_no_numbers_are_refused(robot, track_speeds):
    V_l, V_r = track_speeds
    twist = PaperTwist(np.full_like(V_l, np.nan), V_l, V_r)
    with pytest.raises(EstimatorError, match="NaN or infinite"):
        fit_inertia(robot, KnownMotion(V_l, V_r, twist))


def test_a_motion_against_its_tracks_is_refused(robot, track_speeds):
    V_l, V_r = track_speeds
    backward = PaperTwist(0.0 * V_l, 0.5 * (V_l + V_r), (V_l - V_r) / 1.2)
    with pytest.raises(EstimatorError, match="turns against its tracks"):
        fit_constant(robot, KnownMotion(V_l, V_r, backward))
