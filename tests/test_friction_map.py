"""The table of the friction solution: errors, limits, symmetries, seams, derivatives."""

import copy
import pickle
from dataclasses import replace

import msgspec
import numpy as np
import pytest

import estimator.friction_map
from estimator.contact import Body, Contact, Soil, equally_spaced
from estimator.errors import EstimatorError
from estimator.friction_map import AT_REST, EDGE, REACH, FrictionMap, friction_map
from estimator.kinematics import PaperTwist
from estimator.robot import load_robot
from estimator.steady import solve_steady

ALPHA = load_robot("auriga-alpha").contact
WHEELS = Contact(
    Soil(0.9, rolling_resistance=0.05), equally_spaced(0.55, 0.256, 2), Body(50.0, 0.01, 0.03, 0.3)
)
TRACKS = equally_spaced(0.42, 0.4, 5)
LOWER = Body(258.0, -0.015, 0.04, 0.5)
SHEAR = Contact(Soil(0.9, rolling_resistance=0.05, shear_modulus=0.02), TRACKS, LOWER)
OPPOSING = Contact(Soil(0.9, rolling_resistance=0.05, resistance_opposes="track"), TRACKS, LOWER)
SYMMETRIC = Contact(Soil(0.9, rolling_resistance=0.05), TRACKS, Body(258.0, 0.0, 0.04, 0.5))
CONTACTS = {
    "auriga-alpha": ALPHA,
    "wheels": WHEELS,
    "shear": SHEAR,
    "resistance opposes the track": OPPOSING,
}


def twist_of(V_l, V_r, contact):
    """(3, ...) the twist that the table gives."""
    zeta, epsilon, eta = friction_map(contact, 1.0).at(V_l, V_r).indices
    w = (V_r - V_l) / (contact.geometry.gauge * eta)
    return np.array([w * zeta, 0.5 * (V_l + V_r) - w * epsilon, w])


def speeds(count, seed, top=1.0):
    return np.random.default_rng(seed).uniform(-top, top, (2, count))


def sharp(contact, regularising_speed):
    soil = msgspec.structs.replace(contact.soil, regularising_speed=regularising_speed)
    return replace(contact, soil=soil)


@pytest.mark.parametrize("name", CONTACTS)
def test_between_the_nodes_it_is_the_friction_solution(name):
    V = speeds(4000, 1)
    expected = np.array(solve_steady(*V, CONTACTS[name]).twist)
    error = twist_of(*V, CONTACTS[name]) - expected
    size = np.sqrt(np.mean(expected**2, axis=1))
    assert (np.sqrt(np.mean(error**2, axis=1)) < 1e-3 * size).all()
    # The largest errors are at kinks, and on the spot at full speed, where a motion turns into another.
    assert (np.abs(error).max(axis=1) < 0.06 * size).all()


def test_without_kinks_it_is_much_closer():
    contact = load_robot("warthog").contact
    V = speeds(4000, 2, 2.6)
    point = friction_map(contact, 2.6).at(*V)
    zeta, epsilon, eta = point.indices
    expected = solve_steady(*V, contact).twist
    w = (V[1] - V[0]) / (contact.geometry.gauge * eta)
    np.testing.assert_allclose(w, expected.w, atol=1e-4)
    np.testing.assert_allclose(w * zeta, expected.v_x, atol=1e-4)
    np.testing.assert_allclose(V.mean(axis=0) - w * epsilon, expected.v_y, atol=1e-4)


@pytest.mark.parametrize("V", [-0.9, -0.5, -0.02, 0.02, 0.5, 0.9])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_both_sides_of_straight_motion_have_their_own_converged_limits(V, side):
    # A tenth of EDGE away, with a regularising speed far below.
    half = 0.1 * EDGE * side * abs(V)
    motion = solve_steady(V - half, V + half, sharp(ALPHA, 1e-9 * abs(V)))
    eta = 2.0 * half / (0.42 * motion.twist.w)
    found = friction_map(ALPHA, 1.0).at(V - 1e-9 * side, V + 1e-9 * side).indices
    assert found.zeta == pytest.approx(motion.twist.v_x / motion.twist.w, abs=1e-3)
    assert found.epsilon == pytest.approx((V - motion.twist.v_y) / motion.twist.w, abs=1e-3)
    assert found.eta == pytest.approx(eta, abs=3e-3)


def test_eccentricity_jumps_with_the_side_but_the_twist_does_not():
    left, right = (
        friction_map(ALPHA, 1.0).at(0.5 - step, 0.5 + step).indices.epsilon
        for step in (1e-9, -1e-9)
    )
    assert left - right > 0.1
    between = friction_map(ALPHA, 1.0).at(0.5, 0.5).indices.epsilon
    assert between == pytest.approx(0.5 * (left + right))
    for V in (-0.7, 0.1, 0.5):
        steps = np.array([-1e-9, 0.0, 1e-9])
        twists = twist_of(V - steps, V + steps, ALPHA)
        assert np.abs(twists - twists[:, 1:2]).max() < 1e-8
        assert twists[:, 1].tolist() == [0.0, V, 0.0]


# Pairs on both sides of every seam: opposed tracks, a resting track, and the end of the table.
FAR = np.array([0.4, 1.0])
TABLE_END = FAR * REACH * (2.0**0.25 / (0.4**8 + 1.0) ** 0.25) ** 0.5
SEAMS = {
    "opposed tracks": (np.array([-0.6, 0.6]), np.array([1.0, 1.0])),
    "left track rests": (np.array([0.0, 0.6]), np.array([1.0, 0.0])),
    "right track rests": (np.array([-0.6, 0.0]), np.array([0.0, 1.0])),
    "end of the table": (TABLE_END, TABLE_END),
    "a node of t": (np.array([-0.2, 0.6]), np.array([1.0, 0.0])),
}


@pytest.mark.parametrize("contact", [ALPHA, WHEELS], ids=["auriga-alpha", "wheels"])
@pytest.mark.parametrize("seam", SEAMS)
def test_no_seam_shows(seam, contact):
    at, across = SEAMS[seam]
    near, far = (friction_map(contact, 1.0).at(*(at + side * across)) for side in (-1e-9, 1e-9))
    assert np.abs(np.subtract(near.indices, far.indices)).max() < 1e-6
    if seam != "end of the table":
        assert np.abs(np.subtract(near.by_D, far.by_D)).max() < 1e-4
        assert np.abs(np.subtract(near.by_V_m, far.by_V_m)).max() < 1e-4


def test_beyond_the_table_the_indices_stay_and_the_twist_grows_with_the_speeds():
    at = friction_map(ALPHA, 1.0).at
    assert at(*(1.5 * TABLE_END)).indices == pytest.approx(at(*TABLE_END).indices, abs=1e-9)
    assert at(*(100.0 * TABLE_END)).indices == pytest.approx(at(*TABLE_END).indices, abs=1e-9)


@pytest.mark.parametrize("contact", [SHEAR, OPPOSING], ids=["shear", "opposing"])
def test_where_forces_jump_as_a_track_stops_both_sides_are_right(contact):
    V_l = np.array([-0.01, 0.01])
    expected = np.array(solve_steady(V_l, 0.6, contact).twist)
    found = twist_of(V_l, 0.6, contact)
    assert np.abs(found - expected).max() < 1e-5
    assert np.abs(expected[:, 1] - expected[:, 0]).max() > 0.01


def test_a_symmetric_vehicle_is_exactly_symmetric():
    V_l, V_r = speeds(2000, 3)
    a, b = twist_of(V_l, V_r, SYMMETRIC), twist_of(V_r, V_l, SYMMETRIC)
    assert (b == a * np.array([-1.0, 1.0, -1.0])[:, None]).all()
    assert friction_map(SYMMETRIC, 1.0).reference.epsilon == 0.0


def test_a_mirrored_vehicle_has_the_mirrored_table():
    mirrored = replace(ALPHA, body=msgspec.structs.replace(ALPHA.body, x_CM=0.015))
    V_l, V_r = speeds(2000, 4)
    a, b = friction_map(ALPHA, 1.0), friction_map(mirrored, 1.0)
    assert (twist_of(V_r, V_l, mirrored)[2] == -twist_of(V_l, V_r, ALPHA)[2]).all()
    one, other = a.at(V_l, V_r), b.at(V_r, V_l)
    for i, sign in enumerate((1.0, -1.0, 1.0)):
        assert (other.indices[i] == sign * one.indices[i]).all()
        assert (other.by_D[i] == -sign * one.by_D[i]).all()
        assert (other.by_V_m[i] == sign * one.by_V_m[i]).all()
        assert b.reference[i] == sign * a.reference[i]


def test_slow_motions_know_the_direction_only():
    V = speeds(500, 5, 0.02)
    slow, slower = (friction_map(ALPHA, 1.0).at(*(share * V)) for share in (1.0, 1e-3))
    # Inertia at 0.02 m/s is 4e-4 of that at full speed.
    assert np.abs(np.subtract(slow.indices, slower.indices)).max() < 5e-3
    slowest = friction_map(ALPHA, 1.0).at(*(1e-6 * V))
    assert np.abs(np.subtract(slowest.indices, slower.indices)).max() < 1e-7


def test_backward_is_not_forward_reversed_where_the_centre_of_mass_is_off_centre():
    forward, backward = twist_of(0.2, 0.9, ALPHA), twist_of(-0.2, -0.9, ALPHA)
    assert np.abs(forward + backward).max() > 0.02


def test_derivatives_are_the_complex_step_ones():
    at, step = friction_map(ALPHA, 1.0).at, 1e-30
    V = [*speeds(200, 6, 1.3).T.tolist(), [0.0, 0.5], [-0.4, 0.4], [0.5, 0.5 + 1e-9], [1e-7, -1e-8]]
    for V_l, V_r in V:
        point = at(V_l, V_r)
        h = 1j * step
        by_D = [part.imag / step for part in at(V_l - 0.5 * h, V_r + 0.5 * h).indices]
        by_V_m = [part.imag / step for part in at(V_l + h, V_r + h).indices]
        scale = 1e-9 * (1.0 + 1.0 / (abs(V_l) + abs(V_r)))
        assert point.by_D == pytest.approx(by_D, abs=scale), (V_l, V_r)
        assert point.by_V_m == pytest.approx(by_V_m, abs=scale), (V_l, V_r)


def test_floats_give_what_arrays_give():
    V_l, V_r = speeds(300, 7, 1.2)
    V_l[:3], V_r[:3] = (0.0, 0.5, -0.3), (0.0, 0.5, 0.3)
    many = friction_map(ALPHA, 1.0).at(V_l, V_r)
    for i in range(300):
        one = friction_map(ALPHA, 1.0).at(float(V_l[i]), float(V_r[i]))
        assert isinstance(one.indices.zeta, float)
        for found, expected in zip(one, many, strict=True):
            assert found == pytest.approx([part[i] for part in expected], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("V", [0.0, 1e-300, 0.1 * AT_REST])
def test_at_rest_nothing_is_infinite(V):
    for V_l, V_r in ((V, V), (-V, V), (V, -V), (0.0, V)):
        point = friction_map(ALPHA, 1.0).at(V_l, V_r)
        assert np.isfinite(point).all()
        assert not np.any(point.by_D)
        assert not np.any(point.by_V_m)


def test_reference_is_in_the_middle_of_the_slow_indices():
    angles = np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False)
    slow = friction_map(ALPHA, 1.0).at(1e-3 * np.cos(angles), 1e-3 * np.sin(angles)).indices
    for middle, values in zip(friction_map(ALPHA, 1.0).reference, slow, strict=True):
        assert values.min() < middle < values.max()
    # Near the published constant ICRs of this robot: 0.048, 0.086, 2.6.
    assert friction_map(ALPHA, 1.0).reference == pytest.approx((0.048, 0.08, 2.6), abs=0.05)


def test_of_several_motions_it_holds_the_one_reached_by_speeding_up():
    # Opposed tracks beyond full speed: a guess of a typical vehicle's motion ends on another branch.
    V = np.array([-0.806, 1.108])
    guess = None
    for step in range(1, 51):
        motion = solve_steady(*(step / 50 * V), ALPHA, guess=guess)
        guess = PaperTwist(*((step + 1) / step * part for part in motion.twist))
    assert twist_of(*V, ALPHA) == pytest.approx(np.array(motion.twist), abs=0.02)


def test_it_is_made_once_and_copies_are_the_same_table():
    table = friction_map(ALPHA, 1.0)
    same = Contact(ALPHA.soil, equally_spaced(0.42, 0.4, 5), ALPHA.body)
    assert friction_map(same, 1.0) is table
    assert copy.deepcopy(table) is table
    assert pickle.loads(pickle.dumps(table)) is table  # noqa: S301 - our own bytes
    assert len(pickle.dumps(table)) < 10_000


def test_what_has_no_stationary_motion_is_named(monkeypatch):
    def stuck(V_l, V_r, contact, **options):
        motion = solve_steady(V_l, V_r, contact, **options)
        return replace(motion, converged=motion.converged & (V_l < 0.9))

    monkeypatch.setattr(estimator.friction_map, "solve_steady", stuck)
    with pytest.raises(
        EstimatorError,
        match=r"no stationary motion found for \d+ of 321 .*\(0\.9.*check the centre",
    ):
        FrictionMap(ALPHA, 1.0)
