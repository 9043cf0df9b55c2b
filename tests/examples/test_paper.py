"""Identification of the paper's contact, in little: on numbers whose contact is known."""

import json
import tomllib
from pathlib import Path

import msgspec
import pytest
from ablation import Choice, ablate, count_close
from identify import HERE, as_table, as_toml
from search import HOPELESS, PUBLISHED_TARGETS, deviations, identify

from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.paper.contact import (
    BEST_FILE,
    ContactParameters,
    PaperContact,
    load_paper_contact,
)
from icreckon.simulation.paper.readings import Reading
from icreckon.simulation.paper.reproduction import numbers, paper_map

KNOWN = ContactParameters(half_length=0.42, z_CM=0.6, friction=0.8, rolling_resistance=0.05)
COUNT = 7


def test_search_and_least_squares_recover_a_known_contact() -> None:
    values = numbers(paper_map(KNOWN, count=COUNT), Reading())[0]
    targets = {name: values[name] for name in PUBLISHED_TARGETS}
    found = identify(
        seed=3, samples=60, starts=3, targets=targets, readings=(Reading(),), count=COUNT
    )
    assert (abs(deviations(found.best.guess, targets, count=COUNT)) < 0.1).sum() >= 15
    contact = found.best.guess.contact
    assert contact.half_length == pytest.approx(KNOWN.half_length, rel=0.15)
    assert contact.friction == pytest.approx(KNOWN.friction, rel=0.15)


def test_a_contact_without_numbers_is_hopeless_but_no_end() -> None:
    nowhere = PaperContact(contact=ContactParameters(half_length=0.01))
    assert (deviations(nowhere) == HOPELESS).all()
    assert count_close(nowhere).worst == ""


def test_ablation_makes_one_choice_at_a_time() -> None:
    guess = PaperContact()
    same = Choice(name="the same", contact={"points": guess.contact.points})
    median = Choice(name="median of |F|", reading={"means": "median"})
    (row,) = ablate(guess, (same, median), evaluations=1)
    assert row.guess.reading.means == "median"
    changed = msgspec.structs.replace(guess, reading=Reading(means="median"))
    assert row.unchanged == count_close(changed)
    assert "| median of \\|F\\| |" in as_table([row])


def test_the_stored_results_are_the_contact_that_ships(tmp_path: Path) -> None:
    path = tmp_path / "contact.toml"
    path.write_text(as_toml(load_paper_contact(), "a contact"), encoding="utf-8")
    assert load_paper_contact(path) == load_paper_contact()
    best = json.loads((HERE / "identification.json").read_text(encoding="utf-8"))["candidates"][0]
    shipped = tomllib.loads(BEST_FILE.read_text(encoding="utf-8"))
    assert best["guess"]["reading"] == shipped["reading"]
    for name, value in shipped["contact"].items():
        found = best["guess"]["contact"][name]
        assert found == (pytest.approx(value, rel=1e-5) if isinstance(value, float) else value)


def test_a_contact_without_stationary_motions_is_hopeless_too(monkeypatch):
    def unsolved(*_: object, **__: object) -> None:
        raise SimulationError("no stationary motion found for 1 of 441 pairs")

    monkeypatch.setattr("icreckon.simulation.paper.reproduction.solve_steady", unsolved)
    assert count_close(PaperContact()).worst == ""
