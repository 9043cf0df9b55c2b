"""Fit of a model by Gauss-Newton steps with re-estimated noise and weights.

Observability is determined by the information with all parameters free. A parameter is unobservable
("not shown") if its standard error exceeds a threshold. As long as there is one, that of the highest rank
is held at its start (the robot file); the others are then estimated on that condition.

Standard errors are the largest of those of the likelihood and of a jackknife over blocks, linearised at
the fit. The jackknife is valid for any correlation of residuals within a block (Efron and Stein, The
jackknife estimate of variance, Annals of Statistics 9, 1981). They are inflated for few blocks, so that
1.96 of them are a 95 % interval.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.lag_search import jackknife_sigma
from icreckon.estimator.calibration.noise import (
    Noise,
    channels_of,
    cost,
    first_noise,
    flattening,
    information,
    refined,
)
from icreckon.estimator.calibration.residuals import Problem

ROUNDS = 12
"""Largest number of Gauss-Newton steps."""
NOISE_ROUNDS = 5
"""Number of first steps that re-estimate the noise."""
SETTLED = 0.01
"""The search ends with a step below this share of all standard errors."""
LOOSE = 10.0
"""Soft bound of unobservable parameters about their start while fitting, in threshold errors."""
CHANCE = 0.01
"""Probability below which chance does not explain how far values are off."""
NEVER = 1e-10
"""Least information, in units of the threshold errors; below it counts as zero."""


@dataclass(frozen=True)
class Fit:
    """Fitted model."""

    problem: Problem  # the problem that was fitted
    values: Floats  # (p,) estimates; held parameters are at their start
    free: NDArray[np.bool_]  # (p,) mask of parameters that are not held
    shown: NDArray[np.bool_]  # (p,) mask of parameters that the logs determine with all free
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

    def is_free(self, name: str) -> bool:
        """Return True if a parameter was estimated, not held."""
        return bool(self.free[self.problem.place(name)])

    def not_contradicted(self, names: Iterable[str]) -> frozenset[str]:
        """Find parameters whose start, the robot file's value, the logs do not contradict.

        Beginning with the one that is the most standard errors off, parameters are left out until chance
        explains how far the others are off, each alone and all together (Wald's test at 1 %).

        Args:
            names: names of parameters; held ones do not count.
        """
        from scipy.special import chdtri

        start = self.problem.start
        places = [place for name in names if self.free[place := self.problem.place(name)]]
        off = {place: (self.values[place] - start[place]) / self.sigmas[place] for place in places}
        places.sort(key=lambda place: abs(off[place]))
        while places:
            size = np.sqrt(np.diag(self.covariance)[places])
            correlation = self.covariance[np.ix_(places, places)] / np.outer(size, size)
            offsets = np.array([off[place] for place in places])
            wald = offsets @ np.linalg.pinv(correlation, hermitian=True) @ offsets
            largest = offsets[-1] ** 2
            if wald <= chdtri(len(places), CHANCE) and largest <= chdtri(1, CHANCE):
                break
            places.pop()
        return frozenset(self.problem.names[place] for place in places)

    def with_start_of(self, names: Iterable[str]) -> Fit:
        """Copy whose values of some parameters are their starts."""
        values = self.values.copy()
        for name in names:
            place = self.problem.place(name)
            values[place] = self.problem.start[place]
        return replace(self, values=values)

    def without(self, blocks: NDArray[np.bool_]) -> Floats:
        """Estimates (p,) without the blocks of a mask (blocks,), by one step."""
        at = np.flatnonzero(self.free)
        fisher = self.fisher[~blocks].sum(axis=0)[np.ix_(at, at)]
        score = self.score[~blocks].sum(axis=0)[at]
        threshold = _thresholds(self.problem)[at]
        moved = self.values.copy()
        moved[at] -= threshold * _solve(fisher * np.outer(threshold, threshold), threshold * score)
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
    # Held parameters are at the values of the anchor.
    values, anchor = problem.start, problem.start
    threshold = _thresholds(problem)
    free = np.array([p.threshold > 0.0 and p.name not in held for p in problem.parameters], bool)
    for name, value in (initial or {}).items():
        if name in held:
            anchor[problem.place(name)] = values[problem.place(name)] = value
        elif name in problem.names and free[problem.place(name)]:
            values[problem.place(name)] = value
    values, noise = _search(problem, values, free, loose=True)
    residuals, jacobian = problem.linearised(values)
    fisher, _ = information(noise, residuals, jacobian, problem.recording.block)
    total = fisher.sum(axis=0) * flattening(noise, residuals)
    with_all_free = _sigmas(total, free, threshold)
    shown = free & (with_all_free <= threshold)
    # Hold unobservable parameters, one by one, until the rest is observable.
    ranks = np.array([parameter.rank for parameter in problem.parameters])
    while (unobservable := free & (_sigmas(total, free, threshold) > threshold)).any():
        worst = int(np.flatnonzero(unobservable)[ranks[unobservable].argmax()])
        free[worst] = False
        values[worst] = anchor[worst]
    values, noise = _search(problem, values, free, loose=False, noise=noise)
    residuals, jacobian = problem.linearised(values)
    fisher, score = information(noise, residuals, jacobian, problem.recording.block)
    total = fisher.sum(axis=0) * flattening(noise, residuals)
    if (without_effect := free & (np.diag(total) <= 0.0)).any():
        # At a bound, as eta = 1, no residual depends on these parameters: they are held.
        names = {problem.names[place] for place in np.flatnonzero(without_effect)}
        rest = {name: value for name, value in (initial or {}).items() if name not in names}
        return fit(problem, initial=rest, held=held | names)
    at = np.flatnonzero(free)
    covariance = np.zeros((len(values), len(values)))
    scaled = total[np.ix_(at, at)] * np.outer(threshold[at], threshold[at])
    covariance[np.ix_(at, at)] = np.linalg.inv(scaled) * np.outer(threshold[at], threshold[at])
    result = Fit(
        problem=problem,
        values=values,
        free=free,
        shown=shown & free,
        sigmas=np.full(len(values), np.inf),
        covariance=covariance,
        noise=noise,
        residuals=residuals,
        jacobian=jacobian,
        fisher=fisher,
        score=score,
    )
    by_likelihood = np.sqrt(np.diag(covariance))
    largest = np.maximum(by_likelihood, _jackknife(result)) * few_blocks(_effective_blocks(result))
    largest = np.where(shown, np.maximum(largest, with_all_free), largest)
    result.sigmas[free] = largest[free]
    return result


def _search(
    problem: Problem,
    values: Floats,
    free: NDArray[np.bool_],
    *,
    loose: bool,
    noise: Noise | None = None,
) -> tuple[Floats, Noise]:
    """Search by Gauss-Newton steps, shortened if they do not reduce the cost.

    Args:
        problem: the problem.
        values: (p,) initial values.
        free: (p,) mask of parameters that may change.
        loose: True to bind them softly to their initial values, see `LOOSE`.
        noise: initial noise; None to estimate it.

    Returns:
        Values (p,) and noise.
    """
    threshold, block = _thresholds(problem), problem.recording.block
    at = np.flatnonzero(free)
    start = values.copy()
    ridge = np.full(len(at), LOOSE**-2.0 if loose else 0.0)
    residuals, jacobian = problem.linearised(values)
    if noise is None:
        heading = problem.heading(values)[0]
        noise = first_noise(channels_of(problem, 0.5 * (heading[:, 0] + heading[:, -1])), residuals)
    for number in range(ROUNDS):
        noise = refined(noise, residuals, components_too=number < NOISE_ROUNDS)
        fisher, score = information(noise, residuals, jacobian, block)
        scaled = fisher.sum(axis=0)[np.ix_(at, at)] * np.outer(threshold[at], threshold[at])
        scaled += np.diag(ridge)
        slope = threshold[at] * score.sum(axis=0)[at]
        slope = slope + ridge * (values[at] - start[at]) / threshold[at]
        step = _step(problem, values, at, threshold, scaled, slope)
        before = cost(noise, residuals) + _pull(values, start, at, threshold, ridge)
        size = 1.0
        for _ in range(6):
            moved = values.copy()
            moved[at] += size * threshold[at] * step
            moved = problem.inside(moved)
            after = cost(noise, problem.rows(moved)) + _pull(moved, start, at, threshold, ridge)
            if np.isfinite(after) and after <= before + 1e-9:
                break
            size *= 0.4
        else:
            # No shorter step helps; with noise that is estimated again the next one may.
            if number >= NOISE_ROUNDS:
                break
            continue
        taken = moved - values
        values = moved
        residuals, jacobian = problem.linearised(values)
        sigma = np.sqrt(1.0 / np.maximum(np.diag(scaled), 1e-12))
        if number >= NOISE_ROUNDS - 1 and np.all(
            np.abs(taken[at] / threshold[at]) <= SETTLED * sigma
        ):
            break
    return values, refined(noise, residuals)


def _step(
    problem: Problem,
    values: Floats,
    at: NDArray[np.intp],
    threshold: Floats,
    scaled: Floats,
    slope: Floats,
) -> Floats:
    """Gauss-Newton step (a,) of free parameters, in threshold errors, within bounds."""
    within = np.ones(len(at), dtype=bool)
    for _ in range(len(at)):
        step = np.zeros(len(at))
        step[within] = -_solve(scaled[np.ix_(within, within)], slope[within])
        moved = values.copy()
        moved[at] += 1e-6 * threshold[at] * step
        outward = within & (problem.inside(moved) != moved)[at]
        if not outward.any():
            break
        within &= ~outward
    return step


def _pull(
    values: Floats, start: Floats, at: NDArray[np.intp], threshold: Floats, ridge: Floats
) -> float:
    """Cost of the distance from the initial values, by the soft bounds."""
    return float((ridge * ((values[at] - start[at]) / threshold[at]) ** 2).sum())


def _thresholds(problem: Problem) -> Floats:
    """Threshold errors (p,): units in which parameters are of order one; 1 if held."""
    return np.array([p.threshold if p.threshold > 0.0 else 1.0 for p in problem.parameters])


def _sigmas(fisher: Floats, free: NDArray[np.bool_], threshold: Floats) -> Floats:
    """Standard errors (p,) by the likelihood; infinite if held, huge if unobservable."""
    result = np.full(len(threshold), np.inf)
    at = np.flatnonzero(free)
    scaled = fisher[np.ix_(at, at)] * np.outer(threshold[at], threshold[at])
    values, vectors = np.linalg.eigh(scaled)
    variances = (vectors**2 / np.maximum(values, NEVER)).sum(axis=1)
    result[at] = threshold[at] * np.sqrt(variances)
    return result


def _solve(matrix: Floats, vector: Floats) -> Floats:
    """Solve a symmetric system; zero along directions without information."""
    values, vectors = np.linalg.eigh(matrix)
    along = vectors.T @ vector
    informative = values > NEVER * max(1.0, float(values.max(initial=0.0)) * 1e-4)
    return np.asarray(
        vectors @ np.where(informative, along / np.where(informative, values, 1.0), 0.0)
    )


def few_blocks(blocks: Floats | float) -> Floats:
    """Factor from 1.96 standard errors to a 95 % interval of few blocks (Student's t)."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.maximum(np.asarray(blocks) - 1.0, 2.0), 0.975) / 1.96)


def _effective_blocks(result: Fit) -> Floats:
    """Effective number (p,) of blocks for each parameter, weighted by information.

    Satterthwaite's degrees of freedom, of each block's share in a parameter's variance.
    """
    at = np.flatnonzero(result.free)
    threshold = _thresholds(result.problem)[at]
    scaled = result.fisher[:, at][:, :, at] * np.outer(threshold, threshold)
    inverse = np.linalg.pinv(scaled.sum(axis=0), hermitian=True)
    shares = np.einsum("ij,bjk,ki->bi", inverse, scaled, inverse)
    effective = np.ones(len(result.values))
    effective[at] = shares.sum(axis=0) ** 2 / np.maximum((shares**2).sum(axis=0), 1e-300)
    return effective


def _jackknife(result: Fit) -> Floats:
    """Jackknife standard errors (p,), by leaving out each block; 0 for too few blocks."""
    blocks = len(result.fisher)
    if blocks < 3:
        return np.zeros(len(result.values))
    without = [result.without(np.arange(blocks) == number) for number in range(blocks)]
    return jackknife_sigma(np.array(without))
