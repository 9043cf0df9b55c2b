"""Fit of a model by Gauss-Newton steps with re-estimated noise and weights.

Observability is determined by the information with all parameters free. A parameter is unobservable
("not shown") if its standard error exceeds a threshold. As long as there is one, that of the highest rank
is held at its start (the robot file); the others are then estimated on that condition.

Standard errors are the larger of two: by the likelihood, and by a jackknife over blocks linearised at
the fit. The jackknife is valid for any correlation of residuals within a block (Efron and Stein, The
jackknife estimate of variance, Annals of Statistics 9, 1981). Standard errors of few blocks are inflated,
so that 1.96 of them are a 95 % interval.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Flags, Floats
from icreckon.estimator.base.lag_search import jackknife_sigma
from icreckon.estimator.calibration import noise as noise_model
from icreckon.estimator.calibration.noise import Noise, information, refined
from icreckon.estimator.calibration.residuals import Problem, middle_of

ROUNDS = 12  # largest number of Gauss-Newton steps
NOISE_ROUNDS = 5  # number of first steps that re-estimate the noise
SETTLED = 0.01  # the search ends with a step below this share of all standard errors
SOFT_BOUND = 10.0  # soft bound of unobservable parameters about their start, in threshold errors
CHANCE = 0.01  # level of significance of differences from the start [-]
LEAST_INFORMATION = 1e-10  # least information, in units of the threshold errors; less is zero


@dataclass(frozen=True)
class Fit:
    """Fitted model."""

    problem: Problem  # the problem that was fitted
    values: Floats  # (p,) estimates; held parameters are at their start
    free: Flags  # (p,) mask of parameters that are not held
    shown: Flags  # (p,) mask of parameters that the logs determine with all free
    sigmas: Floats  # (p,) standard errors; infinite for held parameters
    covariance: Floats  # (p, p) of the free parameters by the likelihood; zero elsewhere
    noise: Noise  # noise of the residuals
    residuals: Floats  # (n, ROWS) residuals
    jacobian: Floats  # (n, ROWS, p) derivatives of the residuals
    fisher: Floats  # (blocks, p, p) information of each block
    score: Floats  # (blocks, p) score of each block

    def value(self, name: str) -> float:
        """Value of a parameter."""
        return float(self.values[self.problem.place(name)])

    def sigma(self, name: str) -> float:
        """Standard error of a parameter."""
        return float(self.sigmas[self.problem.place(name)])

    @property
    def by_name(self) -> dict[str, float]:
        """Values of all parameters, by their names."""
        return dict(zip(self.problem.names, self.values.tolist(), strict=True))

    def is_free(self, name: str) -> bool:
        """Return True if a parameter was estimated, not held."""
        return bool(self.free[self.problem.place(name)])

    def not_contradicted(self, names: Iterable[str]) -> frozenset[str]:
        """Find parameters whose start, the robot file's value, the logs do not contradict.

        Parameters are dropped, the one that is the most standard errors off first, until the differences
        of the others are within chance, each alone and all together (Wald's test at 1 %).
        """
        from scipy.special import chdtri

        places = [self.problem.place(name) for name in names if self.is_free(name)]
        # Differences (p,) from the start in standard errors; 0 for held parameters.
        errors_off = (self.values - self.problem.start) / self.sigmas
        places.sort(key=lambda place: abs(errors_off[place]))
        while places:
            size = np.sqrt(np.diag(self.covariance)[places])
            correlation = self.covariance[np.ix_(places, places)] / np.outer(size, size)
            offsets = errors_off[places]
            wald = offsets @ np.linalg.pinv(correlation, hermitian=True) @ offsets
            largest = offsets[-1] ** 2
            if wald <= chdtri(len(places), CHANCE) and largest <= chdtri(1, CHANCE):
                break
            places.pop()
        return frozenset(self.problem.names[place] for place in places)

    def with_start_of(self, names: Iterable[str]) -> Fit:
        """Copy in which some parameters have their start values."""
        values, places = self.values.copy(), [self.problem.place(name) for name in names]
        values[places] = self.problem.start[places]
        return replace(self, values=values)

    def without(self, blocks: Flags) -> Floats:
        """Estimates (p,) without the blocks of a mask (blocks,), by one Gauss-Newton step."""
        free = np.flatnonzero(self.free)
        threshold = _thresholds(self.problem)
        scaled = _scaled(self.fisher[~blocks].sum(axis=0), free, threshold)
        gradient = threshold[free] * self.score[~blocks].sum(axis=0)[free]
        moved = self.values.copy()
        moved[free] -= threshold[free] * _solve(scaled, gradient)
        return self.problem.inside(moved)


def fit(
    problem: Problem, *, initial: dict[str, float] | None = None, held: frozenset[str] = frozenset()
) -> Fit:
    """Fit a model: with all parameters free, then with the unobservable ones held.

    Args:
        problem: the problem.
        initial: initial values of the search, by name; by default the parameters' own start.
        held: names of parameters held at their initial values from the outset.
    """
    values, anchor = problem.start, problem.start  # two copies; parameters are held at the anchor
    threshold = _thresholds(problem)
    free = np.array([p.threshold > 0.0 and p.name not in held for p in problem.parameters], bool)
    for name, value in (initial or {}).items():
        if name in held:
            anchor[problem.place(name)] = values[problem.place(name)] = value
        elif name in problem.names and free[problem.place(name)]:
            values[problem.place(name)] = value
    values, noise = _search(problem, values, free, loose=True)
    _, total = _parts_of_fit(problem, values, noise)
    sigmas_all_free = _sigmas(total, free, threshold)
    shown = free & (sigmas_all_free <= threshold)
    # Hold unobservable parameters, one by one, until the rest is observable.
    ranks = np.array([parameter.rank for parameter in problem.parameters])
    while (unobservable := free & (_sigmas(total, free, threshold) > threshold)).any():
        worst = int(np.flatnonzero(unobservable)[ranks[unobservable].argmax()])
        free[worst] = False
        values[worst] = anchor[worst]
    values, noise = _search(problem, values, free, loose=False, noise=noise)
    residuals_to_score, total = _parts_of_fit(problem, values, noise)
    if (without_effect := free & (np.diag(total) <= 0.0)).any():
        # At a bound, as eta = 1, no residual depends on these parameters: they are held.
        names = {problem.names[place] for place in np.flatnonzero(without_effect)}
        rest = {name: value for name, value in (initial or {}).items() if name not in names}
        return fit(problem, initial=rest, held=held | names)
    places = np.flatnonzero(free)
    covariance = np.zeros((len(values), len(values)))
    inverse = np.linalg.inv(_scaled(total, places, threshold))
    covariance[np.ix_(places, places)] = inverse * np.outer(threshold[places], threshold[places])
    all_held = np.full(len(values), np.inf)  # standard errors, until they follow from the fit below
    parts = all_held, covariance, noise, *residuals_to_score
    result = Fit(problem, values, free, shown & free, *parts)
    sigmas, blocks = np.sqrt(np.diag(covariance)), np.arange(len(result.fisher))
    if len(blocks) >= 3:
        without = [result.without(blocks == number) for number in blocks]
        sigmas = np.maximum(sigmas, jackknife_sigma(np.array(without)))
    sigmas = sigmas * few_blocks(_effective_blocks(result))
    sigmas = np.where(shown, np.maximum(sigmas, sigmas_all_free), sigmas)
    return replace(result, sigmas=np.where(free, sigmas, np.inf))


def _parts_of_fit(
    problem: Problem, values: Floats, noise: Noise
) -> tuple[tuple[Floats, Floats, Floats, Floats], Floats]:
    """Last fields of a `Fit`, `residuals` to `score`, and total information (p, p).

    The total, unlike that of each block, is corrected for the weights against outliers.
    """
    residuals, jacobian = problem.linearised(values)
    fisher, score = information(noise, residuals, jacobian, problem.recording.block)
    total = fisher.sum(axis=0) * noise_model.flattening(noise, residuals)
    return (residuals, jacobian, fisher, score), total


def _search(
    problem: Problem, values: Floats, free: Flags, *, loose: bool, noise: Noise | None = None
) -> tuple[Floats, Noise]:
    """Fit the `free` ones of values (p,), and the noise, by Gauss-Newton steps.

    `loose` adds soft bounds about the initial values (`SOFT_BOUND`). A noise of None is estimated first.
    """
    places, ridge = np.flatnonzero(free), SOFT_BOUND**-2.0 if loose else 0.0
    unit = _thresholds(problem)[places]
    search = _Search(problem, places, unit, values.copy(), ridge)
    residuals, jacobian = problem.linearised(values)
    if noise is None:
        heading, _ = problem.heading(values)
        channels = noise_model.channels_of(problem, middle_of(heading))
        noise = noise_model.first_noise(channels, residuals)
    for number in range(ROUNDS):
        is_noise_settled = number >= NOISE_ROUNDS
        noise = refined(noise, residuals, components_too=not is_noise_settled)
        of_blocks = information(noise, residuals, jacobian, problem.recording.block)
        fisher, score = (part.sum(axis=0) for part in of_blocks)
        scaled = _scaled(fisher, places, _thresholds(problem)) + ridge * np.eye(len(places))
        gradient = unit * score[places] + ridge * (values - search.start)[places] / unit
        step = search.step(values, scaled, gradient)
        moved = search.moved(values, step, noise, search.cost(values, residuals, noise))
        if moved is None:
            # No step reduces the cost; after the noise has been estimated again, one may.
            if is_noise_settled:
                break
            continue
        change = np.abs((moved - values)[places] / unit)
        values = moved
        residuals, jacobian = problem.linearised(values)
        sigma = np.sqrt(1.0 / np.maximum(np.diag(scaled), 1e-12))
        if number >= NOISE_ROUNDS - 1 and np.all(change <= SETTLED * sigma):
            break
    return values, refined(noise, residuals)


class _Search(NamedTuple):
    """Search for the values of the free parameters of a problem."""

    problem: Problem
    places: NDArray[np.intp]  # (a,) places of the free parameters
    unit: Floats  # (a,) their threshold errors
    start: Floats  # (p,) initial values
    ridge: float  # information of soft bounds about `start`, with parameters in threshold errors

    def cost(self, values: Floats, residuals: Floats, noise: Noise) -> float:
        """Cost of the residuals, and of the distance of the values from the initial ones."""
        off_start = (values - self.start)[self.places] / self.unit
        return noise_model.cost(noise, residuals) + float((self.ridge * off_start**2).sum())

    def moved(self, values: Floats, step: Floats, noise: Noise, before: float) -> Floats | None:
        """Values after the longest part of a step (1 to 0.01) that adds no cost, or None."""
        share = 1.0
        for _ in range(6):
            moved = values.copy()
            moved[self.places] += share * self.unit * step
            moved = self.problem.inside(moved)
            after = self.cost(moved, self.problem.rows(moved), noise)
            if np.isfinite(after) and after <= before + 1e-9:
                return moved
            share *= 0.4
        return None

    def step(self, values: Floats, scaled: Floats, gradient: Floats) -> Floats:
        """Gauss-Newton step (a,), in threshold errors, within bounds.

        A parameter at a bound that a small part of the step would violate does not move.

        Args:
            values: present values (p,).
            scaled: information (a, a), with parameters in threshold errors.
            gradient: derivative (a,) of half the cost by parameters in threshold errors.
        """
        moves = np.ones(len(self.places), dtype=bool)
        for _ in range(len(self.places)):
            step = np.zeros(len(self.places))
            step[moves] = -_solve(scaled[np.ix_(moves, moves)], gradient[moves])
            moved = values.copy()
            moved[self.places] += 1e-6 * self.unit * step
            is_outward = moves & (self.problem.inside(moved) != moved)[self.places]
            if not is_outward.any():
                break
            moves &= ~is_outward
        return step


def _thresholds(problem: Problem) -> Floats:
    """Threshold errors (p,): units in which parameters are of order one; 1 if held."""
    return np.array([p.threshold if p.threshold > 0.0 else 1.0 for p in problem.parameters])


def _scaled(fisher: Floats, places: NDArray[np.intp], threshold: Floats) -> Floats:
    """Information (a, a) of the parameters at some places, these in threshold errors."""
    scales = np.outer(threshold[places], threshold[places])
    return np.asarray(fisher[np.ix_(places, places)] * scales)


def _sigmas(fisher: Floats, free: Flags, threshold: Floats) -> Floats:
    """Standard errors (p,) by the likelihood; infinite if held, huge if unobservable."""
    places = np.flatnonzero(free)
    values, vectors = np.linalg.eigh(_scaled(fisher, places, threshold))
    variances = (vectors**2 / np.maximum(values, LEAST_INFORMATION)).sum(axis=1)
    result = np.full(len(threshold), np.inf)
    result[places] = threshold[places] * np.sqrt(variances)
    return result


def _solve(matrix: Floats, vector: Floats) -> Floats:
    """Solve a symmetric system; zero along directions without information."""
    values, vectors = np.linalg.eigh(matrix)
    along = vectors.T @ vector
    least = LEAST_INFORMATION * max(1.0, float(values.max(initial=0.0)) * 1e-4)
    is_known = values > least
    return np.asarray(vectors @ np.where(is_known, along / np.where(is_known, values, 1.0), 0.0))


def few_blocks(blocks: Floats | float) -> Floats:
    """Factor from 1.96 standard errors to a 95 % interval of few blocks (Student's t)."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.maximum(np.asarray(blocks) - 1.0, 2.0), 0.975) / 1.96)


def _effective_blocks(result: Fit) -> Floats:
    """Effective number (p,) of blocks that determine each parameter (Satterthwaite)."""
    places, threshold = np.flatnonzero(result.free), _thresholds(result.problem)
    scaled = np.array([_scaled(fisher, places, threshold) for fisher in result.fisher])
    inverse = np.linalg.pinv(scaled.sum(axis=0), hermitian=True)
    # Contribution (blocks, a) of each block to the variance of each free parameter.
    shares = np.einsum("ij,bjk,ki->bi", inverse, scaled, inverse)
    effective = np.ones(len(result.values))
    effective[places] = shares.sum(axis=0) ** 2 / np.maximum((shares**2).sum(axis=0), 1e-300)
    return effective
