"""Identification of the paper's contact, in little: on numbers whose contact is known."""

import json
from pathlib import Path

import msgspec
import pytest
from contacts import ContactParameters, load_paper_contact, make_contact
from identify import HERE, as_toml
from readings import Reading, read_errors, read_means, read_numbers, read_parameters
from search import PUBLISHED_TARGETS, deviations, identify

from icreckon.simulation.paper.reproduction import CONTACT, paper_map, reproduce

KNOWN = ContactParameters(half_length=0.42, z_CM=0.6, friction=0.8, rolling_resistance=0.05)
COUNT = 7


def test_search_and_least_squares_recover_a_known_contact() -> None:
    values = read_numbers(paper_map(make_contact(KNOWN), count=COUNT), Reading())
    targets = {name: values[name] for name in PUBLISHED_TARGETS}
    found = identify(
        seed=3, samples=60, starts=3, targets=targets, readings=(Reading(),), count=COUNT
    )
    assert (abs(deviations(found.best.guess, targets, count=COUNT)) < 0.1).sum() >= 15
    contact = found.best.guess.contact
    assert contact.half_length == pytest.approx(KNOWN.half_length, rel=0.15)
    assert contact.friction == pytest.approx(KNOWN.friction, rel=0.15)


def test_the_stored_results_are_the_contact_that_ships(tmp_path: Path) -> None:
    stored = load_paper_contact()
    path = tmp_path / "contact.toml"
    path.write_text(as_toml(stored, "a contact"), encoding="utf-8")
    assert load_paper_contact(path) == stored
    best = json.loads((HERE / "identification.json").read_text(encoding="utf-8"))["candidates"][0]
    assert best["guess"] == msgspec.to_builtins(stored)
    made = make_contact(stored.contact)
    assert made.soil.friction == pytest.approx(CONTACT.soil.friction, rel=1e-5)
    assert made.soil.rolling_resistance == pytest.approx(CONTACT.soil.rolling_resistance, rel=1e-5)
    assert made.geometry.positions == pytest.approx(CONTACT.geometry.positions, rel=1e-5)
    assert made.body.z_CM == pytest.approx(CONTACT.body.z_CM, rel=1e-5)
    values = read_numbers(paper_map(), stored.reading)
    assert all(values[row.name] == row.reproduced for row in reproduce().rows)


def test_figures_of_the_identified_soil() -> None:
    """Motions of the paper as written, on the first ground that was found."""
    mapped, plain = paper_map(make_contact(ContactParameters())), Reading()
    # The identification's friction and height are known to two digits: half a unit of the last one
    # moves eta2 by 3 %, epsilon1 and eta1 by 2 %, the others by less than 1 %.
    icrs, fitted = read_means(mapped, plain), read_parameters(mapped, plain)
    means = icrs.x_ICRl, icrs.x_ICRr, icrs.y_ICR
    assert means == pytest.approx((-0.455, 0.657, 0.0481), rel=5e-3)
    found = fitted.zeta0, fitted.zeta1, fitted.epsilon0, fitted.eta0
    assert found == pytest.approx((0.0481, 2.39e-4, 0.086, 2.49), rel=5e-3)
    assert (fitted.epsilon1, fitted.eta1) == pytest.approx((8.5e-4, 1.77e-3), rel=0.025)
    assert fitted.eta2 == pytest.approx(2.4e-5, rel=0.05)
    errors = read_errors(mapped, fitted, icrs, plain)
    assert errors.inertia_based == pytest.approx((0.0034, 0.046, 0.051), rel=0.02)
    assert errors.constant == pytest.approx((0.017, 0.077, 0.110), rel=0.02)
