"""Relocation: align the estimated path with rejected position fixes.

When fixes are rejected in a row, the position or the heading may be wrong. If it is the heading, using
the next fix corrects the position for a moment only: the estimate drives away from the fixes again. But
the estimated path since then has the right shape. So it is aligned with the rejected fixes by the turn
and the shift of least squares (closed form in the plane: Umeyama, Least-squares estimation of
transformation parameters between two point patterns, IEEE Trans. PAMI 13, 1991). The result is used if
the residuals agree with the variances of the fixes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats

# Least number of rejected fixes, and most that are kept.
FEWEST, MOST = 5, 64
# Largest standard deviation of the turn [rad], and least turn, in such standard deviations; otherwise a
# shift is enough.
KNOWN_TURN, CLEAR_TURN = 0.3, 4.0
# Largest residuals: multiple of the variance of the fixes, and share of the path's extent, for its drift.
LEFT_OVER, WARPED = 4.0, 0.05


class RejectedFix(NamedTuple):
    """Position fix that was rejected, and its prediction.

    Attributes:
        x: measured [m].
        y: measured [m].
        variance: variance of each coordinate about those of the first one [m²].
        predicted_x: predicted [m].
        predicted_y: predicted [m].
    """

    x: float
    y: float
    variance: float
    predicted_x: float
    predicted_y: float


class Relocation(NamedTuple):
    """Alignment of the estimated path with the fixes.

    Attributes:
        turn: rotation about the path's middle, counter-clockwise [rad].
        turn_variance: its variance [rad²].
        middle: (2,) middle of the estimated path [m].
        moved_to: (2,) position of the middle after the alignment [m].
        variance: variance of each of its coordinates [m²].
    """

    turn: float
    turn_variance: float
    middle: Floats
    moved_to: Floats
    variance: float

    def pose(self, pose: Floats) -> tuple[Floats, Floats]:
        """Align an estimated pose (3,); return it with its covariance (3, 3)."""
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        away = np.array([[cos, -sin], [sin, cos]]) @ (pose[:2] - self.middle)
        by_turn = np.array([-away[1], away[0], 1.0])
        covariance = self.turn_variance * np.outer(by_turn, by_turn)
        covariance[[0, 1], [0, 1]] += self.variance
        return np.array([*(self.moved_to + away), pose[2] + self.turn]), covariance


def beside_wander(covariance: Floats, sigma: float) -> Floats:
    """Covariance (5, 5) of a pose from fixes, and of a new wander of zero.

    The pose is as far off as the fixes are: to its error the wander's is added, with the other sign.

    Args:
        covariance: (3, 3) covariance of the pose, of fixes that do not wander.
        sigma: standard deviation of the wander [m]; at 0 the covariance stays as it is.
    """
    if sigma == 0.0:
        return covariance
    joint = np.zeros((5, 5))
    joint[:3, :3] = covariance
    joint[[0, 1, 3, 4], [0, 1, 3, 4]] += sigma * sigma
    joint[[0, 1, 3, 4], [3, 4, 0, 1]] = -sigma * sigma
    return joint


def relocation(rejected: tuple[RejectedFix, ...]) -> Relocation | None:
    """Align the estimated path with rejected fixes; None if they do not fit.

    Args:
        rejected: fixes that were rejected in a row.
    """
    fit = laid_over(np.array(rejected), len(rejected))
    if not fit[0]:
        return None
    _, turn, turn_variance, x, y, to_x, to_y, variance = fit
    return Relocation(turn, turn_variance, np.array([x, y]), np.array([to_x, to_y]), variance)


def laid_over(rows: Any, count: int) -> Any:
    """Least-squares turn and shift; plain Python, for numba too.

    Args:
        rows: (n, 5) fixes that were rejected in a row, see `RejectedFix`.
        count: number of rows to use.

    Returns:
        True if it fits; the turn [rad] and its variance; the middle of the estimated path, and its
        position after the alignment [m]; the variance of each of its coordinates [m²].
    """
    none = (False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    to_x = to_y = x = y = variance = 0.0
    for k in range(count):
        to_x += rows[k, 0] / count
        to_y += rows[k, 1] / count
        variance = max(variance, rows[k, 2])
        x += rows[k, 3] / count
        y += rows[k, 4] / count
    extent = along = across = 0.0
    for k in range(count):
        p_x, p_y = rows[k, 3] - x, rows[k, 4] - y
        z_x, z_y = rows[k, 0] - to_x, rows[k, 1] - to_y
        extent += p_x * p_x + p_y * p_y
        along += p_x * z_x + p_y * z_y
        across += p_x * z_y - p_y * z_x
    if count < FEWEST or extent <= 0.0:
        return none
    turn = math.atan2(across, along)
    cos, sin = math.cos(turn), math.sin(turn)
    left = 0.0
    for k in range(count):
        p_x, p_y = rows[k, 3] - x, rows[k, 4] - y
        left_x = rows[k, 0] - to_x - (cos * p_x - sin * p_y)
        left_y = rows[k, 1] - to_y - (sin * p_x + cos * p_y)
        left += left_x * left_x + left_y * left_y
    left_variance = left / (2.0 * count - 3.0)
    if left_variance > LEFT_OVER * variance + WARPED * WARPED * extent / count:
        return none
    noise = max(variance, left_variance)
    turn_variance = noise / extent
    sigma = math.sqrt(turn_variance)
    if sigma > KNOWN_TURN or abs(turn) < CLEAR_TURN * sigma:
        return none
    return (True, turn, turn_variance, x, y, to_x, to_y, noise)
