"""Search for the contact and soil that reproduce the paper's numbers best.

Parameters that the paper leaves open are identified in two stages: a seeded search (`search`) maps random
contacts and applies every reading to each map, then least squares refine the best ones (`refine`). Both
use the relative deviations d of all numbers. The objective is Cauchy's, the sum of
ln(1 + (d / 10 %)²) / 2, so that a number that cannot be matched does not distort the others.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args

import msgspec
import numpy as np
from contacts import ContactParameters, PaperContact, make_contact
from numpy.random import Generator, default_rng
from readings import Fit, Means, Reading, read_numbers
from scipy.optimize import least_squares

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import IcreckonError
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.paper.published import PUBLISHED
from icreckon.simulation.paper.reproduction import INERTIAS, paper_map

Progress = Callable[[float], None]

# Scale of Cauchy's loss: larger deviations count less; the best candidate has most numbers within it.
SCALE = 0.1
# Deviation of a number that a guess does not give.
HOPELESS = 9.0
SAMPLES = 600
STARTS = 18
# Share of random contacts in which an optional refinement of the model is off.
PLAIN_SHARE = 0.6
DIFFERENCE_STEP = 3e-4
LARGEST_EVALUATIONS = 25
# Share of the search in the time of `identify`.
SEARCH_SHARE = 0.6


class Range(NamedTuple):
    """Bounds of a contact parameter, and the value that disables it (None: always on)."""

    low: float
    high: float
    off: float | None = None


RANGES: dict[str, Range] = {
    "half_length": Range(0.30, 0.50),
    "friction": Range(0.5, 1.4),
    "rolling_resistance": Range(0.0, 0.15),
    "z_CM": Range(0.2, 1.2),
    "friction_ratio": Range(0.9, 1.1, off=1.0),
    "end_weight": Range(0.5, 2.5, off=1.0),
    "tread_width": Range(0.0, 0.2, off=0.0),
    "shear_modulus": Range(0.0, 0.002, off=0.0),
}
POINTS = (3, 4, 5, 6, 8, 12)
OPPOSES = ("travel", "track")
# Limit of |F| in readings without motions under large inertia [N].
GENTLE = 120.0
READINGS: tuple[Reading, ...] = tuple(
    Reading(means=means, fit=fit, inertia=inertia, largest_inertia=largest)
    for means, fit, inertia, largest in itertools.product(
        get_args(Means), get_args(Fit), INERTIAS[:2], (None, GENTLE)
    )
)
PUBLISHED_TARGETS: dict[str, float] = {number.name: number.value for number in PUBLISHED}


class Candidate(NamedTuple):
    """Candidate of the identification.

    Attributes:
        far: number of values more than 10 % off; candidates are ranked by it, then by cost.
        cost: Cauchy's sum of the deviations.
        guess: contact and reading.
    """

    far: int
    cost: float
    guess: PaperContact

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key of candidates, best first."""
        return self.far, self.cost


@dataclass(frozen=True)
class Identified:
    """Result of an identification.

    Attributes:
        best: the candidate with most numbers within 10 %, and of those the one with the lowest cost.
        refined: all candidates after least squares, best first.
        seed: seed of the search.
        samples: number of random contacts.
        failed: number of contacts that gave no numbers (no stationary motion, no valid ICRs).
    """

    best: Candidate
    refined: tuple[Candidate, ...]
    seed: int
    samples: int
    failed: int


def deviations(
    guess: PaperContact, targets: Mapping[str, float] = PUBLISHED_TARGETS, *, count: int = 21
) -> Floats:
    """Relative deviations (n,) of all targets; `HOPELESS` if there are no numbers.

    Args:
        guess: contact and reading.
        targets: values to reproduce, by the names of `icreckon.simulation.paper.published`.
        count: track speeds per track of the map.
    """
    try:
        values = read_numbers(paper_map(make_contact(guess.contact), count=count), guess.reading)
    except IcreckonError:
        return np.full(len(targets), HOPELESS)
    return _relative(values, targets)


def cauchy(deviation: Floats) -> float:
    """Objective: sum of ln(1 + (d / 10 %)²) / 2, Cauchy's loss.

    It is the scaled cost of `scipy.optimize.least_squares`.

    Args:
        deviation: (n,) relative deviations.
    """
    return float(0.5 * np.log1p((deviation / SCALE) ** 2).sum())


def identify(
    *,
    seed: int,
    samples: int = SAMPLES,
    starts: int = STARTS,
    targets: Mapping[str, float] = PUBLISHED_TARGETS,
    readings: Iterable[Reading] = READINGS,
    count: int = 21,
    progress: Progress | None = None,
) -> Identified:
    """Identify contact and reading: search, then refine the best candidates.

    Args:
        seed: seed of the random contacts.
        samples: number of contacts to draw.
        starts: number of candidates to refine.
        targets: values to reproduce, by the names of `icreckon.simulation.paper.published`.
        readings: readings to apply to each map.
        count: track speeds per track of the map.
        progress: called with the share done.

    Raises:
        SimulationError: no random contact gives any numbers.
    """

    def advance(done: float) -> None:
        if progress:
            progress(done)

    found, failed = search(
        default_rng(seed),
        samples,
        targets,
        tuple(readings),
        count=count,
        progress=lambda done: advance(SEARCH_SHARE * done),
    )
    if not found:
        raise SimulationError(f"none of {samples} random contacts gives the numbers to compare")
    first = _spread_over_readings(found, starts)
    refined = []
    for done, candidate in enumerate(first):
        free = [name for name in RANGES if _is_on(candidate.guess.contact, name)]
        refined.append(refine(candidate.guess, free, targets, count=count))
        advance(SEARCH_SHARE + (1.0 - SEARCH_SHARE) * (done + 1) / len(first))
    refined.sort(key=lambda candidate: candidate.rank)
    return Identified(refined[0], tuple(refined), seed, samples, failed)


def search(
    rng: Generator,
    samples: int,
    targets: Mapping[str, float],
    readings: tuple[Reading, ...],
    *,
    count: int = 21,
    progress: Progress | None = None,
) -> tuple[list[Candidate], int]:
    """Evaluate the first identification's contact and random ones, with every reading.

    Args:
        rng: source of the contacts.
        samples: number of contacts.
        targets: values to reproduce.
        readings: readings to apply to each map.
        count: track speeds per track.
        progress: called with the share done.

    Returns:
        All candidates, the lowest cost first, and the number of contacts that gave no numbers.
    """
    found: list[Candidate] = []
    failed = 0
    for done in range(samples):
        contact = random_contact(rng) if done else ContactParameters()
        try:
            mapped = paper_map(make_contact(contact), count=count)
            found += [
                _candidate(
                    PaperContact(contact=contact, reading=reading),
                    _relative(read_numbers(mapped, reading), targets),
                )
                for reading in readings
            ]
        except IcreckonError:
            failed += 1
        if progress:
            progress((done + 1) / samples)
    found.sort(key=lambda candidate: candidate.cost)
    return found, failed


def random_contact(rng: Generator) -> ContactParameters:
    """Draw a contact uniformly from the ranges; refinements are mostly off."""
    values: dict[str, Any] = {}
    for name, (low, high, off) in RANGES.items():
        values[name] = float(rng.uniform(low, high))
        if off is not None and rng.random() < PLAIN_SHARE:
            values[name] = off
    values["points"] = int(rng.choice(POINTS))
    values["resistance_opposes"] = str(rng.choice(OPPOSES))
    return msgspec.convert(values, ContactParameters)


def refine(
    guess: PaperContact,
    free: Iterable[str],
    targets: Mapping[str, float] = PUBLISHED_TARGETS,
    *,
    count: int = 21,
    evaluations: int = LARGEST_EVALUATIONS,
) -> Candidate:
    """Refine some contact parameters of a guess by least squares (Cauchy's loss).

    Args:
        guess: initial guess; parameters that are not free stay fixed.
        free: names from `RANGES`.
        targets: values to reproduce.
        count: track speeds per track.
        evaluations: largest number of steps.
    """
    names = list(free)
    low = np.array([RANGES[name].low for name in names])
    high = np.array([RANGES[name].high for name in names])
    width = high - low

    def at(x: Floats) -> PaperContact:
        changed = dict(zip(names, x.tolist(), strict=True))
        return msgspec.structs.replace(
            guess, contact=msgspec.structs.replace(guess.contact, **changed)
        )

    start = np.array([getattr(guess.contact, name) for name in names])
    inside = np.clip(start, low + 1e-6 * width, high - 1e-6 * width)
    solution = least_squares(
        lambda x: deviations(at(x), targets, count=count),
        inside,
        bounds=(low, high),
        loss="cauchy",
        f_scale=SCALE,
        x_scale=width,
        diff_step=DIFFERENCE_STEP,
        max_nfev=evaluations,
    )
    return _candidate(at(solution.x), np.asarray(solution.fun, dtype=float))


def _candidate(guess: PaperContact, deviation: Floats) -> Candidate:
    return Candidate(int(np.sum(np.abs(deviation) > SCALE)), cauchy(deviation), guess)


def _relative(values: Mapping[str, float], targets: Mapping[str, float]) -> Floats:
    found = np.array([values[name] for name in targets])
    wanted = np.array(list(targets.values()))
    relative = np.clip(found / wanted - 1.0, -HOPELESS, HOPELESS)
    return np.where(np.isfinite(relative), relative, HOPELESS)


def _is_on(contact: ContactParameters, name: str) -> bool:
    return RANGES[name].off is None or getattr(contact, name) != RANGES[name].off


def _spread_over_readings(found: list[Candidate], starts: int) -> list[Candidate]:
    """Best candidates, of each reading at most its share, so that none dominates."""
    share = max(1, -(-starts // len({candidate.guess.reading for candidate in found})))
    taken: dict[Reading, int] = {}
    chosen = []
    for candidate in found:
        if taken.get(candidate.guess.reading, 0) < share:
            taken[candidate.guess.reading] = taken.get(candidate.guess.reading, 0) + 1
            chosen.append(candidate)
        if len(chosen) == starts:
            break
    return chosen
