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
from typing import NamedTuple

import numpy as np

from estimator.frames import Floats

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
    if len(refused) < FEWEST:
        return None
    rows = np.array(refused)
    measured, believed, variance = rows[:, :2], rows[:, 3:], float(rows[:, 2].max())
    moved_to, middle = measured.mean(axis=0), believed.mean(axis=0)
    z, p = measured - moved_to, believed - middle
    extent = float((p * p).sum())
    if extent <= 0.0:
        return None
    turn = math.atan2(float((p[:, 0] * z[:, 1] - p[:, 1] * z[:, 0]).sum()), float((p * z).sum()))
    cos, sin = math.cos(turn), math.sin(turn)
    left = z - p @ np.array([[cos, sin], [-sin, cos]])
    left_variance = float((left * left).sum()) / (2.0 * len(rows) - 3.0)
    spread = extent / len(rows)
    if left_variance > LEFT_OVER * variance + WARPED**2 * spread:
        return None
    noise = max(variance, left_variance)
    turn_variance = noise / extent
    sigma = math.sqrt(turn_variance)
    if sigma > KNOWN_TURN or abs(turn) < CLEAR_TURN * sigma:
        return None
    return Relocation(turn, turn_variance, middle, moved_to, noise)
