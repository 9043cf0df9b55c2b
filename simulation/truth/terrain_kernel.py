"""Ground under the tracks, compiled; see `icreckon.simulation.truth.terrain`.

A patch is a row: x from, x to, y from, y to [m], time from, to [s], width of its soft edge [m], length
of its soft beginning and end [s], coefficient of friction across and along [-], rolling resistance [-],
acceleration of gravity along the slope in x and y of odom [m/s²]. NaN leaves a property unchanged.
"""

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.tracing.jit_kernel import compiled

WIDTH = 13
X, Y, TIME, EDGE, ONSET, ACROSS, ALONG, ROLLING, SLOPE = 0, 2, 4, 6, 7, 8, 9, 10, 11


class TrackGround(NamedTuple):
    """Ground under the middle of the left and of the right track.

    Attributes:
        friction: (2, 2) coefficients of each track, across and along it [-].
        rolling: (2,) rolling resistance of each track [-].
    """

    friction: Floats
    rolling: Floats


@compiled
def look_up(
    patches: Floats,
    time: float,
    pose: tuple[float, float, float],
    half_gauge: float,
    outside: TrackGround,
    under: TrackGround,
    slope: Floats,
) -> None:
    """Look up friction, rolling resistance under each track, and slope at the origin.

    Args:
        patches: (k, WIDTH), later ones lie on top of earlier ones.
        time: time since the start of the run [s].
        pose: x, y [m], yaw [rad] of the vehicle in odom.
        half_gauge: L / 2 [m].
        outside: ground outside all patches.
        under: ground under the tracks, overwritten.
        slope: (2,) overwritten, at the origin [m/s²].
    """
    x, y, yaw = pose
    friction, rolling = under
    friction[:] = outside.friction
    rolling[:] = outside.rolling
    slope[:] = 0.0
    for patch in patches:
        for track in range(2):
            side = half_gauge if track else -half_gauge
            share = _cover(patch, time, x + side * np.sin(yaw), y - side * np.cos(yaw))
            friction[track, 0] = _blend(friction[track, 0], patch[ACROSS], share)
            friction[track, 1] = _blend(friction[track, 1], patch[ALONG], share)
            rolling[track] = _blend(rolling[track], patch[ROLLING], share)
        share = _cover(patch, time, x, y)
        slope[0] = _blend(slope[0], patch[SLOPE], share)
        slope[1] = _blend(slope[1], patch[SLOPE + 1], share)


@compiled
def slope_cover(patch: Floats, time: float, x: float, y: float) -> tuple[float, float, float]:
    """Weight of a patch's slope at a position and time, and the slope [m/s²].

    The weight is zero for a patch without a slope.
    """
    if np.isnan(patch[SLOPE]):
        return 0.0, 0.0, 0.0
    return _cover(patch, time, x, y), patch[SLOPE], patch[SLOPE + 1]


@compiled
def _cover(patch: Floats, time: float, x: float, y: float) -> float:
    """Weight of a patch at a position and time, from 0 to 1 across its soft edges."""
    return (
        _inside(x, patch[X], patch[X + 1], patch[EDGE])
        * _inside(y, patch[Y], patch[Y + 1], patch[EDGE])
        * _inside(time, patch[TIME], patch[TIME + 1], patch[ONSET])
    )


@compiled
def _inside(value: float, low: float, high: float, soft: float) -> float:
    """Weight 1 within [low, high], 0 outside; `soft` is the width of each edge."""
    inner = min(value - low, high - value)
    if soft <= 0.0:
        return 1.0 if inner >= 0.0 else 0.0
    share = min(max(inner / soft + 0.5, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


@compiled
def _blend(value: float, patch: float, share: float) -> float:
    return value if np.isnan(patch) else value + share * (patch - value)
