"""The stationary twist: balance, symmetry, limits, and agreement with scipy."""

import msgspec
import numpy as np
import pytest
from scipy.optimize import root

from forces_of_tracks import steady_balance
from icreckon import SimulationError, Soil, load_robot
from icreckon.estimator.motion.icr import GRAVITY, PaperTwist
from icreckon.estimator.robot.variants import coulomb_gains
from icreckon.simulation.contact import steady_state
from icreckon.simulation.contact.contact import Body, Contact, ContactGeometry, equally_spaced
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.contact.steady_state import CONVERGED, solve_steady, track_speed_grid

GEOMETRY = equally_spaced(0.42, 0.39, 5)
BODY = Body(258.0, -0.015, 0.04, 0.79)
SOIL = Soil(0.9, rolling_resistance=0.074)
PAPER = Contact(SOIL, GEOMETRY, BODY)
SYMMETRIC = Contact(SOIL, GEOMETRY, Body(258.0, 0.0, 0.0, 0.5))


def changed(**soil: object) -> Contact:
    return Contact(msgspec.structs.replace(SOIL, **soil), GEOMETRY, BODY)


CONTACTS = {
    "paper": PAPER,
    "no resistance": changed(rolling_resistance=0.0),
    "resistance of the track": changed(resistance_opposes="track"),
    "high resistance": changed(rolling_resistance=0.2),
    "slippery": changed(friction=0.1, rolling_resistance=0.05),
    "laterally slippery": changed(friction=0.5, longitudinal_friction=0.9),
    "shear": changed(shear_modulus=0.01),
    "soft": changed(regularising_speed=1e-2),
    "top-heavy": Contact(SOIL, GEOMETRY, Body(258.0, -0.015, 0.04, 3.0)),
    "uneven": Contact(
        SOIL,
        ContactGeometry(0.42, (-0.4, -0.3, -0.05, 0.2, 0.39), (1, 2, 1, 2, 1), (-0.08, 0.08)),
        BODY,
    ),
}


@pytest.mark.parametrize("name", CONTACTS)
def test_all_pairs_of_the_paper_converge(name):
    motion = solve_steady(*track_speed_grid(), CONTACTS[name])
    assert motion.converged.shape == (21, 21)
    assert motion.converged.all()
    assert motion.residual.max() <= 1e-10
    # The residual is the true one: recomputed from the twists.
    flat = PaperTwist(*(part.ravel() for part in motion.twist))
    left = steady_balance(flat, motion.V_l.ravel(), motion.V_r.ravel(), CONTACTS[name]).values
    assert np.abs(left[:2]).max() <= 1e-10 * BODY.weight
    assert np.abs(left[2]).max() <= 1e-10 * BODY.weight * 0.21


def test_both_tracks_at_rest_are_rest():
    motion = solve_steady(0.0, 0.0, PAPER)
    assert motion.twist == PaperTwist(0.0, 0.0, 0.0)
    assert motion.residual == 0.0


@pytest.mark.parametrize("speed", [-1.0, -0.3, 0.1, 0.7])
def test_equal_speeds_are_straight_without_lateral_force(speed):
    motion = solve_steady(speed, speed, PAPER)
    assert motion.twist.w == pytest.approx(0.0, abs=1e-12)
    assert motion.twist.v_x == pytest.approx(0.0, abs=1e-12)
    # Friction that carries the rolling resistance needs a creep v / sqrt(v² + d²) = f_r / mu.
    creep = 1e-4 * 0.074 / np.sqrt(0.9**2 - 0.074**2)
    assert speed - motion.twist.v_y == pytest.approx(np.sign(speed) * creep, rel=1e-6)


@pytest.mark.parametrize("speed", [-0.8, 0.1, 1.0])
def test_a_symmetric_vehicle_spins_on_the_spot(speed):
    motion = solve_steady(-speed, speed, SYMMETRIC)
    assert motion.twist.v_x == pytest.approx(0.0, abs=1e-12)
    assert motion.twist.v_y == pytest.approx(0.0, abs=1e-12)
    assert np.sign(motion.twist.w) == np.sign(speed)
    assert abs(motion.twist.w) < abs(speed) / 0.21


def test_rolling_resistance_parts_left_from_right_turns():
    # Design, section 3: at 0.5 m/s the eccentricity jumps with the sign of a gentle turn.
    motion = solve_steady(0.5 + np.array([0.01, -0.01]), 0.5 - np.array([0.01, -0.01]), PAPER)
    epsilon = (0.5 - motion.twist.v_y) / motion.twist.w
    assert epsilon[0] < 0.0 < epsilon[1]


def test_pairs_that_do_not_converge_are_an_error_unless_the_caller_is_not_strict(monkeypatch):
    monkeypatch.setattr(steady_state, "DIRECT_STEPS", 1)
    monkeypatch.setattr(steady_state, "FINAL_STEPS", 1)
    monkeypatch.setattr(steady_state, "SPEED_STEPS", (2,))
    monkeypatch.setattr(steady_state, "YAW_SHARES", (0.4,))
    monkeypatch.setattr(steady_state, "FORWARD_SHARES", (0.0,))
    with pytest.raises(SimulationError, match=r"of 441 pairs .* worst at V_l = "):
        solve_steady(*track_speed_grid(), PAPER)
    motion = solve_steady(*track_speed_grid(), PAPER, strict=False)
    assert not motion.converged.all()
    np.testing.assert_array_equal(motion.converged, motion.residual <= CONVERGED)
    assert np.isfinite(np.stack(motion.twist)).all()


ALPHA = load_robot("auriga-alpha")


def test_epsilon_F_is_what_the_contact_loses_uphill() -> None:
    """A robot without height or offsets, slowly turning uphill."""
    changes = {"centre_of_mass": (0.0, 0.0, 0.01), "contact_points": 40}
    vehicle = msgspec.structs.replace(ALPHA.vehicle, **changes)
    soil = msgspec.structs.replace(ALPHA.soil, rolling_resistance=0.0)
    robot = msgspec.structs.replace(ALPHA, vehicle=vehicle, soil=soil)
    contact, (left, right) = contact_of(robot), (0.10, 0.18)
    twists = {}
    for gravity in (0.0, -0.5):

        def off(twist: np.ndarray, gravity: float = gravity) -> np.ndarray:
            found = steady_balance(PaperTwist(*twist), left, right, contact).values[:, 0]
            return np.asarray(found) + np.array([0.0, vehicle.mass * gravity, 0.0])

        found = root(off, [0.0, 0.14, 0.1], tol=1e-10)
        assert found.success
        twists[gravity] = PaperTwist(*found.x)
    level, uphill = twists[0.0], twists[-0.5]
    eta = (right - left) / (vehicle.track_gauge * level.w)
    indices = msgspec.structs.replace(robot.indices, eta0=float(eta))
    robot = msgspec.structs.replace(robot, indices=indices, constant_icr=None)
    lost = level.v_y - uphill.v_y
    assert lost == pytest.approx(level.w * coulomb_gains(robot).epsilon_F * 0.5 / GRAVITY, rel=0.1)
