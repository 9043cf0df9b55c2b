"""Where index parameters can be: eta0 >= 1 and x_ICRl < 0 < x_ICRr.

Bounds of parameters p are rows of a (8,) and b in a p >= b.
"""

from __future__ import annotations

import numpy as np

from estimator import state as s
from estimator.frames import Floats

# How much of x_ICRl and x_ICRr is kept away from zero [m].
BOUND_MARGIN = 1e-3
# Moving to one bound may cross another; a few rounds settle it.
BOUND_ROUNDS = 50
ROUNDING = 1e-12
ETA0, EPSILON0 = s.ETA0 - s.PARAMETERS.start, s.EPSILON0 - s.PARAMETERS.start


def index_bounds(gauge: float) -> Floats:
    """(3, 9) the bounds.

    Args:
        gauge: L [m].
    """
    rows = np.zeros((3, 9))
    rows[0, [ETA0, 8]] = 1.0, 1.0
    rows[1, [ETA0, EPSILON0, 8]] = 0.5 * gauge, 1.0, BOUND_MARGIN
    rows[2, [ETA0, EPSILON0, 8]] = 0.5 * gauge, -1.0, BOUND_MARGIN
    return rows
