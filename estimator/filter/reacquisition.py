"""Where the path is that refused fixes tell of: a turn and a shift of what the filter believes.

When position fixes are refused time and again, the filter may have lost its place, or its heading. If it
is the heading, believing the next fix brings the place back for a moment only, and the robot drives away
from the fixes again. But the path that was reckoned meanwhile is right in itself. So it is laid over the
refused fixes by the turn and the shift that fit best (least squares in closed form, as Umeyama,
Least-squares estimation of transformation parameters between two point patterns, IEEE Trans. PAMI 13,
1991, in the plane), and believed there if it fits as well as the fixes' variances allow.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats

# So few refused fixes lay nothing over anything.
FEWEST = 5
# The turn must be known at least so well [rad], and be this many times as large as that; otherwise a
# shift will do.
KNOWN_TURN, CLEAR_TURN = 0.3, 4.0
# The fit may leave this many times the variance of the fixes, and this share of the path's extent, by
# which reckoning may go wrong on the way.
LEFT_OVER, WARPED = 4.0, 0.05


class RefusedFix(NamedTuple):
    """A position fix that was refused, and where the filter thought to be.

    Attributes:
        x: as measured [m].
        y: as measured [m].
        variance: of each [m²].
        believed_x: as the filter had it [m].
        believed_y: as the filter had it [m].
    """

    x: float
    y: float
    variance: float
    believed_x: float
    believed_y: float


class Relocation(NamedTuple):
    """How to lay the believed path over the fixes.

    Attributes:
        turn: about the path's middle, counter-clockwise [rad].
        turn_variance: [rad²].
        middle: (2,) of the believed path [m].
        moved_to: (2,) where that belongs [m].
        variance: of each coordinate at the middle [m²].
    """

    turn: float
    turn_variance: float
    middle: Floats
    moved_to: Floats
    variance: float

    def pose(self, pose: Floats) -> tuple[Floats, Floats]:
        """A believed pose (3,) laid over, and its covariance (3, 3)."""
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        away = np.array([[cos, -sin], [sin, cos]]) @ (pose[:2] - self.middle)
        by_turn = np.array([-away[1], away[0], 1.0])
        covariance = self.turn_variance * np.outer(by_turn, by_turn)
        covariance[[0, 1], [0, 1]] += self.variance
        return np.array([*(self.moved_to + away), pose[2] + self.turn]), covariance


def relocation(refused: tuple[RefusedFix, ...]) -> Relocation | None:
    """The turn and shift that lay the believed path over refused fixes; None where they do not fit.

    Args:
        refused: fixes in a row.
    """
    fit = laid_over(np.array(refused), len(refused))
    if not fit[0]:
        return None
    _, turn, turn_variance, x, y, to_x, to_y, variance = fit
    return Relocation(turn, turn_variance, np.array([x, y]), np.array([to_x, to_y]), variance)


def laid_over(rows: Any, count: int) -> Any:
    """The fit itself, in plain numbers, for numba too.

    Args:
        rows: (n, 5) refused fixes in a row.
        count: how many of the rows count.

    Returns:
        Whether it fits; the turn [rad] and its variance; the middle of the believed path, and where
        that belongs [m]; the variance of each coordinate there [m²].
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
