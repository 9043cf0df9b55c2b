"""The fit of a model: Gauss-Newton steps with noise and weights that follow, and what it shows.

What the logs show is told by the information with everything free. A parameter whose standard error is
beyond what tells anything is not shown; as long as there is one, that of the highest rank is held at its
start (the robot file), and what can then be told is told on that condition.

Standard errors are the largest of those of the likelihood and of a jackknife over blocks, which holds
whatever the residuals' correlation within a block (Efron and Stein, The jackknife estimate of variance,
Annals of Statistics 9, 1981), linearised at the fit, and grown so that 1.96 of them are a 95 % interval
although there are few blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
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
"""Gauss-Newton steps at most."""
NOISE_ROUNDS = 5
"""In so many of the first, the noise is fitted anew."""
SETTLED = 0.01
"""A step that is less than this share of the standard error of everything ends the search."""
LOOSE = 10.0
"""While fitting, what is not shown is kept within about so many of its telling errors of its start."""
NEVER = 1e-10
"""Information below this, in units of the telling error, is none."""


@dataclass(frozen=True)
class Fit:
    """A model fitted.

    Attributes:
        problem: what was fitted.
        values: (p,) found; what is held is at its start.
        free: (p,) what is not held.
        shown: (p,) what the logs show with everything free.
        sigmas: (p,) standard errors; infinite where held.
        covariance: (p, p) by the likelihood, of what is free; zero elsewhere.
        noise: of the residuals.
        residuals: (n, ROWS).
        jacobian: (n, ROWS, p).
        fisher: (blocks, p, p) information of each block.
        score: (blocks, p).
    """

    problem: Problem
    values: Floats
    free: NDArray[np.bool_]
    shown: NDArray[np.bool_]
    sigmas: Floats
    covariance: Floats
    noise: Noise
    residuals: Floats
    jacobian: Floats
    fisher: Floats
    score: Floats

    def value(self, name: str) -> float:
        """Of a parameter."""
        return float(self.values[self.problem.place(name)])

    def sigma(self, name: str) -> float:
        """Its standard error."""
        return float(self.sigmas[self.problem.place(name)])

    def is_free(self, name: str) -> bool:
        """Whether it was found, and not held."""
        return bool(self.free[self.problem.place(name)])

    def without(self, blocks: NDArray[np.bool_]) -> Floats:
        """(p,) values that the other blocks give, by one step."""
        at = np.flatnonzero(self.free)
        fisher = self.fisher[~blocks].sum(axis=0)[np.ix_(at, at)]
        score = self.score[~blocks].sum(axis=0)[at]
        telling = _telling(self.problem)[at]
        moved = self.values.copy()
        moved[at] -= telling * _solve(fisher * np.outer(telling, telling), telling * score)
        return self.problem.inside(moved)


def fit(
    problem: Problem,
    *,
    initial: dict[str, float] | None = None,
    held: frozenset[str] = frozenset(),
) -> Fit:
    """Fit a model.

    Args:
        problem: what to find.
        initial: where to start the search, by name; the parameters' own start where left out.
        held: names that are held at that from the outset.
    """
    values, anchor = problem.start, problem.start
    telling = _telling(problem)
    free = np.array(
        [one.telling > 0.0 and one.name not in held for one in problem.parameters], dtype=bool
    )
    for name, value in (initial or {}).items():
        if name in held:
            anchor[problem.place(name)] = values[problem.place(name)] = value
        elif name in problem.names and free[problem.place(name)]:
            values[problem.place(name)] = value
    values, noise = _search(problem, values, free, loose=True)
    residuals, jacobian = problem.linearised(values)
    fisher, _ = information(noise, residuals, jacobian, problem.recording.block)
    every = _sigmas(fisher.sum(axis=0) * _flat(noise, residuals), free, telling)
    shown = free & (every <= telling)
    # Hold what is not shown, one by one, until the rest can be told.
    ranks = np.array([one.rank for one in problem.parameters])
    total = fisher.sum(axis=0) * _flat(noise, residuals)
    while True:
        sigmas = _sigmas(total, free, telling)
        untold = free & (sigmas > telling)
        if not untold.any():
            break
        worst = int(np.flatnonzero(untold)[ranks[untold].argmax()])
        free[worst] = False
        values[worst] = anchor[worst]
    values, noise = _search(problem, values, free, loose=False, noise=noise)
    residuals, jacobian = problem.linearised(values)
    fisher, score = information(noise, residuals, jacobian, problem.recording.block)
    total = fisher.sum(axis=0) * _flat(noise, residuals)
    at = np.flatnonzero(free)
    covariance = np.zeros((len(values), len(values)))
    scaled = total[np.ix_(at, at)] * np.outer(telling[at], telling[at])
    covariance[np.ix_(at, at)] = np.linalg.inv(scaled) * np.outer(telling[at], telling[at])
    result = Fit(
        problem,
        values,
        free,
        shown & free,
        np.full(len(values), np.inf),
        covariance,
        noise,
        residuals,
        jacobian,
        fisher,
        score,
    )
    by_likelihood = np.sqrt(np.diag(covariance))
    largest = np.maximum(by_likelihood, _jackknife(result)) * few_blocks(_telling_blocks(result))
    largest = np.where(shown, np.maximum(largest, every), largest)
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
    """Gauss-Newton steps, halved where they do not help."""
    telling, block = _telling(problem), problem.recording.block
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
        scaled = fisher.sum(axis=0)[np.ix_(at, at)] * np.outer(telling[at], telling[at])
        scaled += np.diag(ridge)
        slope = telling[at] * score.sum(axis=0)[at]
        slope = slope + ridge * (values[at] - start[at]) / telling[at]
        step = _step(problem, values, at, telling, scaled, slope)
        before = cost(noise, residuals) + _pull(values, start, at, telling, ridge)
        size = 1.0
        for _ in range(6):
            moved = values.copy()
            moved[at] += size * telling[at] * step
            moved = problem.inside(moved)
            found = problem.rows(moved)
            after = cost(noise, found) + _pull(moved, start, at, telling, ridge)
            if np.isfinite(after) and after <= before + 1e-9:
                break
            size *= 0.4
        else:
            if number >= NOISE_ROUNDS:
                break
            continue
        taken = moved - values
        values = moved
        residuals, jacobian = problem.linearised(values)
        sigma = np.sqrt(1.0 / np.maximum(np.diag(scaled), 1e-12))
        if number >= NOISE_ROUNDS - 1 and np.all(
            np.abs(taken[at] / telling[at]) <= SETTLED * sigma
        ):
            break
    return values, refined(noise, residuals)


def _step(
    problem: Problem,
    values: Floats,
    at: NDArray[np.intp],
    telling: Floats,
    scaled: Floats,
    slope: Floats,
) -> Floats:
    """(a,) Gauss-Newton step of what is free, in units of the telling errors; along bounds at them."""
    within = np.ones(len(at), dtype=bool)
    for _ in range(len(at)):
        step = np.zeros(len(at))
        step[within] = -_solve(scaled[np.ix_(within, within)], slope[within])
        moved = values.copy()
        moved[at] += 1e-6 * telling[at] * step
        outward = within & (problem.inside(moved) != moved)[at]
        if not outward.any():
            break
        within &= ~outward
    return step


def _pull(
    values: Floats, start: Floats, at: NDArray[np.intp], telling: Floats, ridge: Floats
) -> float:
    return float((ridge * ((values[at] - start[at]) / telling[at]) ** 2).sum())


def _telling(problem: Problem) -> Floats:
    """(p,) units in which parameters are of order one; 1 for what is given."""
    return np.array([one.telling if one.telling > 0.0 else 1.0 for one in problem.parameters])


def _flat(noise: Noise, residuals: Floats) -> float:
    """One figure for all channels: the smallest of what is left of the information."""
    return float(flattening(noise, residuals).min())


def _sigmas(fisher: Floats, free: NDArray[np.bool_], telling: Floats) -> Floats:
    """(p,) standard errors by the likelihood; infinite where held, huge where nothing is told."""
    result = np.full(len(telling), np.inf)
    at = np.flatnonzero(free)
    scaled = fisher[np.ix_(at, at)] * np.outer(telling[at], telling[at])
    values, vectors = np.linalg.eigh(scaled)
    variances = (vectors**2 / np.maximum(values, NEVER)).sum(axis=1)
    result[at] = telling[at] * np.sqrt(variances)
    return result


def _solve(matrix: Floats, vector: Floats) -> Floats:
    """Symmetric solution; along directions of no information nothing."""
    values, vectors = np.linalg.eigh(matrix)
    along = vectors.T @ vector
    told = values > NEVER * max(1.0, float(values.max(initial=0.0)) * 1e-4)
    return np.asarray(vectors @ np.where(told, along / np.where(told, values, 1.0), 0.0))


def few_blocks(blocks: Floats | float) -> Floats:
    """By how much 1.96 standard errors from so few blocks fall short of a 95 % interval (Student's t)."""
    from scipy.special import stdtrit  # type: ignore[import-untyped]

    return np.asarray(stdtrit(np.maximum(np.asarray(blocks) - 1.0, 2.0), 0.975) / 1.96)


def _telling_blocks(result: Fit) -> Floats:
    """(p,) how many equal blocks would tell as much: those that tell more of a parameter count for more.

    Satterthwaite's degrees of freedom, of each block's share in a parameter's variance.
    """
    at = np.flatnonzero(result.free)
    telling = _telling(result.problem)[at]
    scaled = result.fisher[:, at][:, :, at] * np.outer(telling, telling)
    inverse = np.linalg.pinv(scaled.sum(axis=0), hermitian=True)
    shares = np.einsum("ij,bjk,ki->bi", inverse, scaled, inverse)
    many = np.ones(len(result.values))
    many[at] = shares.sum(axis=0) ** 2 / np.maximum((shares**2).sum(axis=0), 1e-300)
    return many


def _jackknife(result: Fit) -> Floats:
    """(p,) standard errors by leaving out one block after the other."""
    blocks = len(result.fisher)
    if blocks < 3:
        return np.zeros(len(result.values))
    left = np.array([result.without(np.arange(blocks) == number) for number in range(blocks)])
    apart = left - left.mean(axis=0)
    return np.asarray(np.sqrt((blocks - 1) / blocks * (apart**2).sum(axis=0)))
