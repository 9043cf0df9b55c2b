"""Contact and soil that bring the simulated numbers of the paper closest to the published ones.

What the paper leaves open is found backwards: a seeded search over all of it (`search`), which maps
random contacts and reads each map in every way, then least squares from the best ones (`refine`). Both
use the relative deviations d of all numbers. A number that cannot be matched shall not drag the others
along, so the objective is Cauchy's, the sum of ln(1 + (d / 10 %)²) / 2.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args

import msgspec
import numpy as np
from numpy.random import Generator, default_rng
from scipy.optimize import least_squares  # type: ignore[import-untyped]

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import IcreckonError
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.paper.contact import ContactParameters, PaperContact
from icreckon.simulation.paper.published import PUBLISHED
from icreckon.simulation.paper.readings import Fit, Means, Reading
from icreckon.simulation.paper.reproduction import INERTIAS, numbers, paper_map

Progress = Callable[[float], None]

# A deviation of this size starts to count less; the best candidate has most numbers within it.
SCALE = 0.1
# A number that cannot be had at all counts as being off by this share.
HOPELESS = 9.0
SAMPLES = 600
STARTS = 18
# Share of the random contacts in which a refinement of the contact is switched off.
PLAIN_SHARE = 0.6
DIFFERENCE_STEP = 3e-4
LARGEST_EVALUATIONS = 25
# Of the time of `identify`, what its search takes.
SEARCH_SHARE = 0.6


class Range(NamedTuple):
    """Bounds of a contact parameter, and the value that switches it off (None: it is always on)."""

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
# Where motions under much inertia are left out, from here on [N].
GENTLE = 120.0
READINGS: tuple[Reading, ...] = tuple(
    Reading(means=means, fit=fit, inertia=inertia, largest_inertia=largest)
    for means, fit, inertia, largest in itertools.product(
        get_args(Means), get_args(Fit), INERTIAS[:2], (None, GENTLE)
    )
)
PUBLISHED_TARGETS: dict[str, float] = {number.name: number.value for number in PUBLISHED}


class Candidate(NamedTuple):
    """A guess.

    Attributes:
        far: how many numbers are more than 10 % off; candidates are ranked by it, then by cost.
        cost: Cauchy's sum of the deviations.
        guess: contact and reading.
    """

    far: int
    cost: float
    guess: PaperContact

    @property
    def rank(self) -> tuple[int, float]:
        """Sorts candidates, best first."""
        return self.far, self.cost


@dataclass(frozen=True)
class Identified:
    """The outcome of an identification.

    Attributes:
        best: the candidate with most numbers within 10 %, and of those the one with the lowest cost.
        refined: all candidates that least squares ended in, best first.
        seed: of the search.
        samples: contacts that were drawn.
        failed: how many of them gave no numbers (no stationary motion, no sensible ICRs).
    """

    best: Candidate
    refined: tuple[Candidate, ...]
    seed: int
    samples: int
    failed: int


def deviations(
    guess: PaperContact, targets: Mapping[str, float] = PUBLISHED_TARGETS, *, count: int = 21
) -> Floats:
    """Relative deviations (n,) of all targets; `HOPELESS` where the guess gives no numbers.

    Args:
        guess: contact and reading.
        targets: what to reproduce, by the names of `simulation.paper.published`.
        count: track speeds per track of the map.
    """
    try:
        values = numbers(paper_map(guess.contact, count=count), guess.reading)[0]
    except IcreckonError:
        return np.full(len(targets), HOPELESS)
    return _relative(values, targets)


def cauchy(deviation: Floats) -> float:
    """The objective: sum of ln(1 + (d / 10 %)²) / 2, as `scipy.optimize.least_squares` has it, scaled.

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
    """Search, then refine the best.

    Args:
        seed: of the random contacts.
        samples: contacts to draw.
        starts: candidates to refine.
        targets: what to reproduce, by the names of `simulation.paper.published`.
        readings: ways to read the numbers from a map.
        count: track speeds per track of the map.
        progress: is told the share done.

    Raises:
        SimulationError: no contact that was drawn gives any numbers.
    """

    def tell(done: float) -> None:
        if progress:
            progress(done)

    found, failed = search(
        default_rng(seed),
        samples,
        targets,
        tuple(readings),
        count=count,
        progress=lambda done: tell(SEARCH_SHARE * done),
    )
    if not found:
        raise SimulationError(f"none of {samples} random contacts gives the numbers to compare")
    first = _spread_over_readings(found, starts)
    refined = []
    for done, candidate in enumerate(first):
        free = [name for name in RANGES if _is_on(candidate.guess.contact, name)]
        refined.append(refine(candidate.guess, free, targets, count=count))
        tell(SEARCH_SHARE + (1.0 - SEARCH_SHARE) * (done + 1) / len(first))
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
    """The first identification's contact and random ones, each read in every way.

    Args:
        rng: source of the contacts.
        samples: how many.
        targets: what to reproduce.
        readings: ways to read a map.
        count: track speeds per track.
        progress: is told the share done.

    Returns:
        All candidates, the lowest cost first, and how many contacts gave no numbers.
    """
    found: list[Candidate] = []
    failed = 0
    for done in range(samples):
        contact = random_contact(rng) if done else ContactParameters()
        try:
            mapped = paper_map(contact, count=count)
            found += [
                _candidate(
                    PaperContact(contact=contact, reading=reading),
                    _relative(numbers(mapped, reading)[0], targets),
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
    """A contact drawn evenly from the ranges; refinements are off more often than not."""
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
    """Least squares (Cauchy's loss) from a guess over some of its contact parameters.

    Args:
        guess: where to start; what is not free stays as it is.
        free: names from `RANGES`.
        targets: what to reproduce.
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
    """The best candidates, but of each reading at most its share, so that none crowds out the rest."""
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
