"""Loads and forces at the contact points: balances, bounds, derivatives, and cases known by hand."""

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forces_of_tracks import steady_balance, steady_inertia, track_forces, vertical_loads
from icreckon.estimator.motion.icr import PaperTwist
from icreckon.estimator.robot.soil import Soil
from icreckon.simulation.contact.contact import (
    Body,
    Contact,
    ContactGeometry,
    equally_spaced,
    ground,
)

GEOMETRY = equally_spaced(0.42, 0.39, 5)
UNEVEN = ContactGeometry(0.42, (-0.4, -0.1, 0.3), (1.0, 2.0, 1.5), (-0.05, 0.05))
BODY = Body(258.0, -0.015, 0.04, 0.79)
CONTACTS = {
    "paper": Contact(Soil(0.9, rolling_resistance=0.074), GEOMETRY, BODY),
    "anisotropic": Contact(Soil(0.5, 0.9, rolling_resistance=0.1), GEOMETRY, BODY),
    "shear": Contact(Soil(0.7, rolling_resistance=0.05, shear_modulus=0.01), GEOMETRY, BODY),
    "uneven": Contact(Soil(0.9, 0.6, 0.05, 0.02, resistance_opposes="track"), UNEVEN, BODY),
    "soft": Contact(Soil(0.9, rolling_resistance=0.1, regularising_speed=0.1), UNEVEN, BODY),
}


@pytest.fixture(params=CONTACTS)
def contact(request) -> Contact:
    return CONTACTS[request.param]


def draw(size: float) -> tuple[np.ndarray, np.ndarray]:
    """Random twists (3, 200) and track speeds (2, 200)."""
    rng = np.random.default_rng(1)
    return size * rng.normal(size=(3, 200)), rng.uniform(-1.0, 1.0, (2, 200))


def relative_error(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Largest error (n,) of Jacobians (3, 3, n), as a share of the largest element of each."""
    return np.abs(found - expected).max(axis=(0, 1)) / np.abs(expected).max(axis=(0, 1))


def complex_step(twist: np.ndarray, V: np.ndarray, contact: Contact) -> np.ndarray:
    columns = []
    for axis in range(3):
        moved = twist.astype(complex)
        moved[axis] += 1e-40j
        columns.append(steady_balance(PaperTwist(*moved), V[0], V[1], contact).values.imag / 1e-40)
    return np.stack(columns, axis=1)


def test_the_jacobian_is_exact_while_all_points_touch(contact):
    twist, V = draw(0.3)
    inertia = steady_inertia(PaperTwist(*twist), contact.body)
    touch = (vertical_loads(contact, *inertia[:2]).values > 0.0).all(axis=0)
    twist, V = twist[:, touch], V[:, touch]
    assert twist.shape[1] > 150
    found = steady_balance(PaperTwist(*twist), V[0], V[1], contact).jacobian
    assert relative_error(found, complex_step(twist, V, contact)).max() < 1e-12


def test_the_jacobian_is_exact_where_points_lift(contact):
    rng = np.random.default_rng(3)
    V = np.stack([rng.uniform(0.4, 1.0, 400), rng.uniform(-1.0, 1.0, 400)])
    twist = np.stack([0.3 * rng.normal(size=400), V.mean(axis=0), rng.uniform(-3.0, 3.0, 400)])
    inertia = steady_inertia(PaperTwist(*twist), contact.body)
    loads = vertical_loads(contact, *inertia[:2])
    lifts = (loads.values == 0.0).any(axis=0) & ~loads.tipping
    assert lifts.sum() > 20
    twist, V = twist[:, lifts], V[:, lifts]

    def balance(moved):
        return steady_balance(PaperTwist(*moved), V[0], V[1], contact)

    steps = 1e-6 * np.eye(3)[:, :, None]
    columns = [(balance(twist + one).values - balance(twist - one).values) / 2e-6 for one in steps]
    # A central difference that straddles the lift of one more point is wrong; few do.
    error = relative_error(balance(twist).jacobian, np.stack(columns, axis=1))
    assert np.median(error) < 1e-7
    assert np.quantile(error, 0.9) < 1e-3


forces = st.floats(-1e5, 1e5)


@given(forces, forces, st.sampled_from([GEOMETRY, UNEVEN]))
def test_loads_are_never_negative_and_carry_the_weight(right, forward, geometry):
    contact = Contact(Soil(), geometry, BODY)
    loads, points = vertical_loads(contact, right, forward), ground(contact)
    values = loads.values[:, 0]
    assert (values >= 0.0).all()
    assert values.sum() == pytest.approx(BODY.weight, rel=1e-9)
    x = BODY.x_CM + BODY.z_CM * right / BODY.weight
    y = BODY.y_CM + BODY.z_CM * forward / BODY.weight
    least, most = (points.x.min(), points.y.min()), (points.x.max(), points.y.max())
    within = np.array([x - least[0], most[0] - x, y - least[1], most[1] - y])
    assert bool(loads.tipping[0]) == (within <= 0.0).any() or np.abs(within).min() < 1e-5
    at = points.x @ values / BODY.weight, points.y @ values / BODY.weight
    assert at == pytest.approx(np.clip((x, y), least, most), abs=2e-6)


@settings(max_examples=50)
@given(st.floats(-800.0, 800.0), st.floats(-1200.0, 1200.0))
def test_loads_solve_the_complementarity_problem(right, forward):
    contact = Contact(Soil(), GEOMETRY, BODY)
    loads = vertical_loads(contact, right, forward)
    if loads.tipping[0]:
        return
    points = ground(contact)
    pressure = loads.values[:, 0] / points.share
    touching = pressure > 1e-7
    plane = np.stack([np.ones_like(points.x), points.x, points.y], axis=1)
    fitted, *_ = np.linalg.lstsq(plane[touching], pressure[touching], rcond=None)
    scale = BODY.weight
    np.testing.assert_allclose(plane[touching] @ fitted, pressure[touching], atol=1e-8 * scale)
    if touching.sum() > 3:
        assert (plane[~touching] @ fitted <= 1e-6 * scale).all()


def test_friction_opposes_slip_and_stays_within_the_ellipse():
    geometry = ContactGeometry(0.42, (-1e-3, 1e-3))
    contact = Contact(Soil(0.5, 0.8, 0.0), geometry, Body(100.0))
    twist, _ = draw(1.0)
    twist[2] = 0.0
    zero = np.zeros(200)
    force, *_ = track_forces(PaperTwist(*twist), zero, zero, contact, vertical_loads(contact))
    right, forward = force.values[:2] / 981.0
    assert (right * twist[0] + forward * twist[1] < 0.0).all()
    np.testing.assert_allclose((right / 0.5) ** 2 + (forward / 0.8) ** 2, 1.0, rtol=1e-5)


def test_rolling_resistance_opposes_travel_or_the_track():
    zero = np.zeros(1)
    twist = PaperTwist(zero, zero + 0.5, zero)
    contact = CONTACTS["paper"]
    loads = vertical_loads(contact)
    without = msgspec.structs.replace(contact.soil, rolling_resistance=0.0)
    by_track = msgspec.structs.replace(contact.soil, resistance_opposes="track")

    def forward(soil: Soil, V: float) -> float:
        whole = Contact(soil, GEOMETRY, BODY)
        return track_forces(twist, zero + V, zero + V, whole, loads)[0].values[1, 0]

    resistance = 0.074 * BODY.weight
    for V in (-0.3, 0.3):
        free = forward(without, V)
        assert forward(contact.soil, V) - free == pytest.approx(-resistance, rel=1e-6)
        assert forward(by_track, V) - free == pytest.approx(-np.sign(V) * resistance, rel=1e-6)


def test_shear_displacement_builds_friction_up_from_the_entry():
    K, slip, V = 0.02, 0.1, 0.5
    contact = Contact(
        Soil(0.6, rolling_resistance=0.0, shear_modulus=K, regularising_speed=1e-7),
        GEOMETRY,
        Body(100.0),
    )
    at = np.ones(1)
    twist = PaperTwist(0.0 * at, (V - slip) * at, 0.0 * at)
    force, *_ = track_forces(twist, V * at, V * at, contact, vertical_loads(contact))
    behind = 0.39 - np.array(GEOMETRY.positions)
    share = np.mean(1.0 - np.exp(-slip * behind / V / K))
    assert force.values[1, 0] == pytest.approx(0.6 * 981.0 * share, rel=1e-6)
    backward, *_ = track_forces(
        PaperTwist(*(-part for part in twist)), -V * at, -V * at, contact, vertical_loads(contact)
    )
    assert backward.values[1, 0] == pytest.approx(-force.values[1, 0], rel=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ContactGeometry(0.4, (0.1, -0.1)), "two or more, rising"),
        (lambda: ContactGeometry(0.4, (-0.1, 0.1), across=(0.3,)), "less than half the gauge"),
        (lambda: Body(1.0, z_CM=-0.1), "not below the ground"),
        (lambda: Contact(Soil(), GEOMETRY, Body(1.0, x_CM=0.3)), "lies outside the contact"),
        (lambda: Contact(Soil(), GEOMETRY, Body(1.0, z_CM=300.0)), "above the ground, and beyond"),
    ],
)
def test_nonsense_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
