"""How small the errors of any filter can be: the posterior Cramér-Rao bound, by Tichavský's recursion.

With M = [F; H] the derivative of the next state and of what is measured on the way by the state, and
Sigma the joint covariance of their noise, the information J of the best filter obeys

    J' = D22 - D12' (J + D11)^-1 D12 + E[h' R^-1 h]        D11 = E[M' Sigma^-1 M]
    D12 = -E[M' Sigma^-1 N]     D22 = E[N' Sigma^-1 N]     N = [1; 0]

(Tichavský, Muravchik, Nehorai, Posterior Cramér-Rao bounds for discrete-time nonlinear filtering, IEEE
Trans. Signal Processing 46(5), 1998, eq. 21, for noise of state and measurement that is correlated: the
fast slip moves the pose and shows in the gyro). Expectations are over true motions at the same track
speeds. No filter is better than this bound; but none need reach it either: what the information varies by
from one motion to another counts as if it were information about the state. The covariance along each
motion by itself, `analysis.linearised.stepped`, has no such surplus; its mean is what a filter could
reach that had the Jacobians of the truth.

Poses are in the axes of the robot: there the derivatives hardly depend on where it heads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.linearised import LinearisedStep
from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError

# What is added to the noise of a step, as a share of the standard deviation at the start: constants have
# none, and the recursion inverts it.
FLOOR = 1e-5


@dataclass(frozen=True)
class BoundTerms:
    """The terms of one motion, or sums of those of several.

    Attributes:
        states: (n,) which of the filter's states they are about.
        count: of how many motions this is the sum.
        before: (m, n, n) D11 of each step.
        across: (m, n, n) D12.
        after: (m, n, n) D22 and what is measured at the end of the step.
    """

    states: NDArray[np.int64]
    count: int
    before: Floats
    across: Floats
    after: Floats

    def __add__(self, other: BoundTerms) -> BoundTerms:
        """The sum over the motions of both."""
        if not np.array_equal(self.states, other.states) or self.before.shape != other.before.shape:
            raise EstimatorError("only terms of the same states and steps add up")
        return BoundTerms(
            self.states,
            self.count + other.count,
            self.before + other.before,
            self.across + other.across,
            self.after + other.after,
        )


def bound_terms(steps: list[LinearisedStep], yaws: Floats, sigmas: Floats) -> BoundTerms:
    """The terms of one motion.

    Args:
        steps: of the motion, linearised at its true states.
        yaws: (m + 1,) true yaw before each step and after the last [rad].
        sigmas: (SIZE,) standard deviations at the start; the states without any are left out, but for
            the slip.
    """
    states = np.flatnonzero(sigmas)
    states = np.union1d(states, np.arange(s.SLIP.start, s.SLIP.stop))
    floor = np.diag((FLOOR * np.where(sigmas > 0.0, sigmas, 1.0)) ** 2)
    before, across, after = [], [], []
    for step, yaw, next_yaw in zip(steps, yaws[:-1], yaws[1:], strict=True):
        from_body, to_body = _turn(float(yaw)), _turn(float(next_yaw)).T
        F = to_body @ step.transition @ from_body
        rows = np.array([one.row for one in step.during]).reshape(-1, s.SIZE) @ from_body
        M = np.vstack([F[states], rows])
        by_fast = M[:, s.FAST_SLIP]
        Sigma = by_fast @ step.fast_slip @ by_fast.T
        n = len(states)
        Q = to_body @ step.noise @ to_body.T + floor
        Sigma[:n, :n] += Q[np.ix_(states, states)]
        Sigma[n:, n:] += np.diag([one.variance for one in step.during])
        unit = np.sqrt(np.diagonal(Sigma))
        inverse = np.linalg.inv(Sigma / np.outer(unit, unit)) / np.outer(unit, unit)
        M = M[:, states]
        before.append(M.T @ inverse @ M)
        across.append(-M.T @ inverse[:, :n])
        ends = np.array([one.row for one in step.after]).reshape(-1, s.SIZE) @ to_body.T
        weights = np.array([1.0 / one.variance for one in step.after])
        # What is left of the fast slip is part of what is seen at the end of a step; as if it were
        # known, the bound is only the lower.
        ends = ends[:, states]
        after.append(inverse[:n, :n] + (ends.T * weights) @ ends)
    return BoundTerms(states, 1, np.array(before), np.array(across), np.array(after))


def posterior_bound(terms: BoundTerms, sigmas: Floats) -> Floats:
    """The bound on the covariance after each step.

    Args:
        terms: the sum over many true motions.
        sigmas: (SIZE,) standard deviations at the start; the slip starts from none.

    Returns:
        (m, n, n) in the order of `terms.states`, poses in the axes of the robot.
    """
    start = sigmas[terms.states]
    unit = np.where(start > 0.0, start, 1.0)
    scale = np.outer(unit, unit)
    J = np.diag(np.where(start > 0.0, 1.0, FLOOR**-2))
    bounds = []
    for before, across, after in zip(terms.before, terms.across, terms.after, strict=True):
        D11, D12, D22 = (term * scale / terms.count for term in (before, across, after))
        J = D22 - D12.T @ np.linalg.solve(J + D11, D12)
        J = 0.5 * (J + J.T)
        bounds.append(np.linalg.inv(J) * scale)
    return np.array(bounds)


def in_axes_of_robot(P: Floats, yaw: float) -> Floats:
    """A covariance (SIZE, SIZE) with the pose in the axes of a robot of this yaw [rad]."""
    turn = _turn(yaw)
    return np.asarray(turn.T @ P @ turn)


def _turn(yaw: float) -> Floats:
    """(SIZE, SIZE) from an error with the position in the axes of the robot to one in those of odom."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn: Floats = np.eye(s.SIZE)
    turn[s.POSITION, s.POSITION] = [[cos, -sin], [sin, cos]]
    return turn
