"""Start of a run in the frame of its fixes, of a replay and live."""

import math
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import rotate

CLEAR = 4.0
"""Standard deviations beyond which a fix and the assumed start contradict each other [-]."""
SOON = 5.0
"""Longest time between the start and a heading that is used for the initial yaw [s]."""
ANY_HEADING = 3.0
"""Standard deviation of an unknown yaw [rad]."""
KNOWN_HEADING = 0.3
"""Largest standard deviation at which a yaw from the path is used [rad]."""
DRIFT = 0.05
"""Error of dead reckoning over a short path: share of its length, and its direction [-, rad]."""


class Start(NamedTuple):
    """Initial pose: x, y [m], yaw [rad], and their standard deviations."""

    pose: tuple[float, float, float]
    sigma: tuple[float, float, float]


def laid_over(path: Floats, places: Floats, sigma: float) -> Start | None:
    """Fit a path rigidly to fixes; None if its yaw is not observable.

    Args:
        path: (n, 2) positions by dead reckoning at the stamps of the fixes [m].
        places: (n, 2) the fixes [m].
        sigma: their standard deviation [m].

    Returns:
        Pose of the path's frame in that of the fixes.
    """
    middle, centre = path.mean(axis=0), places.mean(axis=0)
    a, b = path - middle, places - centre
    extent = math.sqrt(float((a**2).sum()))
    if extent == 0.0:
        return None
    yaw = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    yaw_sigma = sigma / extent + DRIFT
    if yaw_sigma > KNOWN_HEADING:
        return None
    x, y = (centre - rotate(middle, yaw)).tolist()
    wide = sigma + yaw_sigma * float(np.hypot(*middle))
    return Start((x, y, yaw), (wide, wide, yaw_sigma))
