"""Inverse identification: on numbers whose contact is known, and what it does with hopeless guesses."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.paper.ablation import Choice, ablate, count_close
from icreckon.simulation.paper.contact import ContactParameters, PaperContact
from icreckon.simulation.paper.readings import Reading
from icreckon.simulation.paper.reproduction import numbers, paper_map
from icreckon.simulation.paper.search import (
    HOPELESS,
    PUBLISHED_TARGETS,
    RANGES,
    cauchy,
    deviations,
    identify,
    random_contact,
    refine,
    search,
)

KNOWN = ContactParameters(half_length=0.42, z_CM=0.6, friction=0.8, rolling_resistance=0.05)
COUNT = 7


@pytest.fixture(scope="module")
def targets() -> dict[str, float]:
    """The numbers of the known contact."""
    values = numbers(paper_map(KNOWN, count=COUNT), Reading())[0]
    return {name: values[name] for name in PUBLISHED_TARGETS}


def test_a_known_contact_has_no_deviations(targets: dict[str, float]) -> None:
    assert cauchy(deviations(PaperContact(contact=KNOWN), targets, count=COUNT)) < 1e-20


def test_least_squares_recovers_a_known_contact(targets: dict[str, float]) -> None:
    found = refine(
        PaperContact(contact=ContactParameters(half_length=0.40, z_CM=0.7, friction=0.9)),
        ["half_length", "z_CM", "friction", "rolling_resistance"],
        targets,
        count=COUNT,
    )
    assert found.cost < 1e-6
    for name in ("half_length", "z_CM", "friction", "rolling_resistance"):
        assert getattr(found.guess.contact, name) == pytest.approx(getattr(KNOWN, name), rel=1e-3)


def test_search_and_least_squares_recover_a_known_contact(targets: dict[str, float]) -> None:
    told: list[float] = []
    found = identify(
        seed=3,
        samples=60,
        starts=3,
        targets=targets,
        readings=(Reading(),),
        count=COUNT,
        progress=told.append,
    )
    assert told[-1] == pytest.approx(1.0)
    assert told == sorted(told)
    assert found.samples == 60
    assert [one.rank for one in found.refined] == sorted(one.rank for one in found.refined)
    assert found.best == found.refined[0]
    deviation = deviations(found.best.guess, targets, count=COUNT)
    assert np.sum(np.abs(deviation) < 0.1) >= 15
    contact = found.best.guess.contact
    assert contact.half_length == pytest.approx(KNOWN.half_length, rel=0.15)
    assert contact.friction == pytest.approx(KNOWN.friction, rel=0.15)


def test_a_seed_gives_the_same_again(targets: dict[str, float]) -> None:
    def run(seed: int) -> PaperContact:
        readings = (Reading(), Reading(means="median"))
        found = search(np.random.default_rng(seed), 8, targets, readings, count=COUNT)
        return found[0][0].guess

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_random_contacts_stay_in_their_ranges() -> None:
    rng = np.random.default_rng(0)
    drawn = [random_contact(rng) for _ in range(200)]
    for name, (low, high, off) in RANGES.items():
        values = [getattr(contact, name) for contact in drawn]
        assert all(low <= value <= high or value == off for value in values)
        assert off is None or 80 < sum(value == off for value in values) < 160
    assert {contact.resistance_opposes for contact in drawn} == {"travel", "track"}


def test_what_gives_no_numbers_is_hopeless_but_no_end() -> None:
    nowhere = PaperContact(contact=ContactParameters(half_length=0.01))
    assert (deviations(nowhere) == HOPELESS).all()
    assert count_close(nowhere).worst == ""
    with pytest.raises(SimulationError, match="none of 2 random contacts"):
        identify(seed=0, samples=2, targets=PUBLISHED_TARGETS, count=2)


def test_cauchy_counts_small_deviations_squared_and_large_ones_little() -> None:
    assert cauchy(np.array([0.01])) == pytest.approx(0.005, rel=0.01)
    assert cauchy(np.array([9.0])) < 9.0 * cauchy(np.array([0.1])) * 2.0


def test_ablation_makes_one_choice_at_a_time() -> None:
    guess = PaperContact()
    choices = (
        Choice(name="as it is"),
        Choice(name="the same", contact={"points": guess.contact.points}),
        Choice(name="high", contact={"z_CM": 0.5}),
        Choice(name="median", reading={"means": "median"}),
    )
    as_it_is, high, median = ablate(guess, choices, evaluations=1)
    assert as_it_is.guess == guess
    assert as_it_is.unchanged == as_it_is.refitted == count_close(guess)
    assert high.guess.contact.z_CM == 0.5
    assert median.guess.reading.means == "median"
    median_as_it_is = msgspec.structs.replace(guess, reading=Reading(means="median"))
    assert median.unchanged == count_close(median_as_it_is)
    for row in (as_it_is, high, median):
        count = row.unchanged
        assert count.within_5_percent <= count.within_10_percent <= count.within_20_percent <= 17
