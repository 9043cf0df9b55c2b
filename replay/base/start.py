"""Start of a run in the frame of its fixes, of a replay and live."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.robot.settings import FixWander

CLEAR = 4.0  # standard deviations beyond which a fix contradicts the assumed start [-]
SOON = 5.0  # longest time between the start and a heading that is used for the initial yaw [s]
ANY_HEADING = 3.0  # standard deviation of an unknown yaw [rad]
KNOWN_HEADING = 0.3  # largest standard deviation at which a yaw from the path is used [rad]
DRIFT = 0.05  # error of dead reckoning over a short path: share of its length, and its direction [-, rad]


class Start(NamedTuple):
    """Initial pose: x, y [m], yaw [rad], and their standard deviations."""

    pose: tuple[float, float, float]
    sigma: tuple[float, float, float]

    @property
    def yaw_sigma(self) -> float:
        """Standard deviation of the yaw [rad]."""
        return self.sigma[2]


EXACT_ORIGIN = Start((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def align_path(
    path: Floats, fixes: Floats, white_sigma: float, wander: FixWander, place: ArrayLike = (0, 0)
) -> Start | None:
    """Fit a path rigidly to fixes; None if its yaw is not observable.

    The path (n, 2) is that of dead reckoning at the stamps of the fixes (n, 2) [m], whose white noise has
    the standard deviation `white_sigma` [m]. The result is the pose of the path's frame in that of the
    fixes; its sigmas are those at a place in the path's frame, x and y [m].
    """
    path_centre, fix_centre = path.mean(axis=0), fixes.mean(axis=0)
    path_offsets, fix_offsets = path - path_centre, fixes - fix_centre
    extent = math.sqrt(float((path_offsets**2).sum()))
    if extent == 0.0:
        return None
    (path_x, path_y), (fix_x, fix_y) = path_offsets.T, fix_offsets.T
    dot = float((path_offsets * fix_offsets).sum())
    yaw = math.atan2(float((path_x * fix_y - path_y * fix_x).sum()), dot)
    # The wander is common to all fixes: the mean over them does not reduce it.
    yaw_sigma = math.hypot(white_sigma, math.sqrt(len(fixes)) * wander.sigma) / extent + DRIFT
    if yaw_sigma > KNOWN_HEADING:
        return None
    x, y = (fix_centre - rotate(path_centre, yaw)).tolist()
    # An error of the yaw moves the place by its distance from the fixes.
    distance = float(np.hypot(*(place - path_centre)))
    position_sigma = wander.at_start(white_sigma) + yaw_sigma * distance
    return Start((x, y, yaw), (position_sigma, position_sigma, yaw_sigma))
