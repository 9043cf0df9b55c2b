"""Ablation of the reproduction: published numbers with one changed choice each."""

from __future__ import annotations

from typing import Any

import msgspec
from contacts import PaperContact, make_contact
from readings import Reading, read_numbers
from search import RANGES, Progress, refine

from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.paper.reproduction import paper_map, published_rows, within

EVALUATIONS = 12


class Count(msgspec.Struct, frozen=True, kw_only=True):
    """Number of printed values that a guess reproduces, and its worst value.

    Attributes:
        within_5_percent: number of values that differ by at most 5 %.
        within_10_percent: number of values that differ by at most 10 %.
        within_20_percent: number of values that differ by at most 20 %.
        worst: name of the value that differs most; "" if the guess gives no numbers.
        worst_percent: its difference [%]; NaN if the guess gives no numbers.
    """

    within_5_percent: int
    within_10_percent: int
    within_20_percent: int
    worst: str
    worst_percent: float


class Ablation(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one changed choice.

    Attributes:
        choice: name of the choice.
        unchanged: with all else unchanged.
        refitted: with the free contact parameters refined again.
        guess: the refitted contact and reading.
    """

    choice: str
    unchanged: Count
    refitted: Count
    guess: PaperContact


class Choice(msgspec.Struct, frozen=True, kw_only=True):
    """Change of a guess: fields of its contact and of its reading."""

    name: str
    contact: dict[str, Any] = {}
    reading: dict[str, Any] = {}

    def applied_to(self, guess: PaperContact) -> PaperContact:
        """Apply the change to a guess."""
        return PaperContact(
            contact=msgspec.structs.replace(guess.contact, **self.contact),
            reading=msgspec.structs.replace(guess.reading, **self.reading),
        )


# The fields of a choice stay fixed while the rest of the contact is refitted.
CHOICES: tuple[Choice, ...] = (
    Choice(name="none: the best contact and reading"),
    Choice(name="no rolling resistance", contact={"rolling_resistance": 0.0}),
    Choice(name="rolling resistance opposes travel", contact={"resistance_opposes": "travel"}),
    Choice(name="rolling resistance opposes track", contact={"resistance_opposes": "track"}),
    Choice(name="no load transfer (z_CM = 0)", contact={"z_CM": 0.0}),
    Choice(name="z_CM = 0.4 m", contact={"z_CM": 0.4}),
    Choice(name="3 contact points", contact={"points": 3}),
    Choice(name="5 contact points", contact={"points": 5}),
    Choice(name="9 contact points", contact={"points": 9}),
    Choice(name="end points carry half", contact={"end_weight": 0.5}),
    Choice(name="end points carry double", contact={"end_weight": 2.0}),
    Choice(name="line contact", contact={"tread_width": 0.0}),
    Choice(name="tread 0.15 m wide", contact={"tread_width": 0.15}),
    Choice(name="5 % more friction along", contact={"friction_ratio": 1.05}),
    Choice(name="5 % less friction along", contact={"friction_ratio": 0.95}),
    Choice(name="shear modulus 1 mm", contact={"shear_modulus": 1e-3}),
    Choice(name="plain means", reading={"means": "plain"}),
    Choice(name="medians for means", reading={"means": "median"}),
    Choice(name="means that fit the velocity", reading={"means": "velocity"}),
    Choice(name="plain least squares", reading={"fit": "plain"}),
    Choice(name="least squares on the velocity", reading={"fit": "velocity"}),
    Choice(name="least absolute deviations", reading={"fit": "absolute"}),
    Choice(name="Table II with measured |F|", reading={"inertia": "measured"}),
    Choice(name="Table II with the model's |F|", reading={"inertia": "literal"}),
    Choice(name="Table II without straight motions", reading={"straight": False}),
    *(
        Choice(
            name=f"only |F| up to {limit:.0f} N in means and fits",
            reading={"largest_inertia": limit},
        )
        for limit in (80.0, 100.0, 120.0, 140.0)
    ),
    Choice(name="all |F| in means and fits", reading={"largest_inertia": None}),
    Choice(name="only |V_l - V_r| from 0.15 m/s", reading={"least_difference": 0.15}),
    Choice(
        name="the paper as written: plain means, plain least squares, measured |F|",
        reading=msgspec.to_builtins(Reading()),
    ),
)


def ablate(
    guess: PaperContact,
    choices: tuple[Choice, ...] = CHOICES,
    *,
    evaluations: int = EVALUATIONS,
    progress: Progress | None = None,
) -> list[Ablation]:
    """Reproduce the published numbers with each choice in turn.

    Choices that the guess makes already are skipped.

    Args:
        guess: initial contact and reading.
        choices: changes of the guess.
        evaluations: largest number of steps of each refinement.
        progress: called with the share done.
    """
    rows = []
    for done, choice in enumerate(choices):
        changed = choice.applied_to(guess)
        if choice.contact or choice.reading:
            if changed == guess:
                continue
            free = [name for name in RANGES if _is_free(name, changed, choice)]
            refitted = refine(changed, free, evaluations=evaluations).guess
        else:
            refitted = guess
        rows.append(
            Ablation(
                choice=choice.name,
                unchanged=count_close(changed),
                refitted=count_close(refitted),
                guess=refitted,
            )
        )
        if progress:
            progress((done + 1) / len(choices))
    return rows


def count_close(guess: PaperContact) -> Count:
    """Count the printed numbers that a guess reproduces closely.

    Args:
        guess: contact and reading.
    """
    try:
        values = read_numbers(paper_map(make_contact(guess.contact)), guess.reading)
    except SimulationError:
        return Count(
            within_5_percent=0,
            within_10_percent=0,
            within_20_percent=0,
            worst="",
            worst_percent=float("nan"),
        )
    rows = [row for row in published_rows(values) if not row.read_off]
    worst = max(rows, key=lambda row: abs(row.difference_percent))
    return Count(
        within_5_percent=within(rows, 5.0),
        within_10_percent=within(rows, 10.0),
        within_20_percent=within(rows, 20.0),
        worst=worst.name,
        worst_percent=worst.difference_percent,
    )


def _is_free(name: str, guess: PaperContact, choice: Choice) -> bool:
    if name in choice.contact:
        return False
    off = RANGES[name].off
    return off is None or getattr(guess.contact, name) != off
