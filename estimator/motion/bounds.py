"""Bounds of index parameters: eta0 >= 1 and x_ICRl < 0 < x_ICRr.

Bounds of parameters p are rows of a (9,) and b in a p >= b.
"""

from collections.abc import Sequence

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats

BOUND_MARGIN = 1e-3  # least distance of x_ICRl and x_ICRr from zero [m]
BOUND_ROUNDS = 50  # moving to one bound may cross another; a few rounds converge
ROUNDING = 1e-12
ETA0, EPSILON0 = s.ETA0 - s.PARAMETERS.start, s.EPSILON0 - s.PARAMETERS.start


def index_bounds(gauge: float) -> Floats:
    """Bounds (3, 10) of eta0, x_ICRl and x_ICRr, for a track gauge L [m]."""
    half = 0.5 * gauge
    rows = np.zeros((3, s.PARAMETER_COUNT + 1))
    rows[0, [ETA0, -1]] = 1.0, 1.0
    rows[1, [ETA0, EPSILON0, -1]] = half, 1.0, BOUND_MARGIN
    rows[2, [ETA0, EPSILON0, -1]] = half, -1.0, BOUND_MARGIN
    return rows


def inside(x: Floats, P: Floats, bounds: Floats, fixed: Sequence[int]) -> Floats:
    """Project a state (n,) of covariance P to the bounds (k, 10) of its parameters.

    The state moves along the covariance to the nearest point of the violated bound, but `fixed` states
    stay. The covariance stays, which is conservative (Simon, Optimal State Estimation, section 7.5). A
    state inside the bounds is returned itself.
    """
    stays = list(fixed)
    for _ in range(BOUND_ROUNDS):
        before = x
        for bound in bounds:
            direction = np.zeros(len(x))
            direction[s.PARAMETERS] = bound[:-1]
            violation = float(bound[-1] - direction.dot(x))
            direction[stays] = 0.0
            cross = P.dot(direction)
            cross[stays] = 0.0
            variance = float(direction.dot(cross))
            if violation > ROUNDING and variance > 0.0:
                x = x + cross * (violation / variance)
        if x is before:
            break
    return x
