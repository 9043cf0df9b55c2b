"""Factor on the slip, and scatter, by successive position fixes.

The innovations of a filter with the right slip are white: they are uncorrelated. If the slip is larger
than assumed, or the parameters are of other ground, successive innovations point to the same side of the
robot. Their weighted mean, the trend, indicates it long before the size of single ones does: an error of
2 cm/s is less than the noise of one fix, but more than the noise of a mean of five. Errors of fixes that
wander point to one side, too, but are no larger than stated, while slip makes innovations larger. So a
trend of small innovations counts less.

Calls for each position fix, in order:

1. Before the gate, `lasting_slip` inflates slip and position; for a pose fix, which has this part alone,
   it is `inflate_by_lasting_slip`.
2. If the gate admits it: `normalised`, `trend_after`, `present_factor_after`, `slip_factor_after`, each
   with the result of the one before. The last one is the factor of the next steps.
3. Unless the filter estimates wander, `follow_scatter`; `inflate_by_corrections` if it finds scatter.

Functions of plain numbers are written for plain Python, for numba and, traced, for lanes.
"""

import math
from typing import Any

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.faults.scattering_fixes import (
    ScatterRecord,
    TakenFix,
    add_fix,
    count_innovation,
)
from icreckon.estimator.filter.ekf import Ekf
from icreckon.estimator.filter.process_noise import lasting_slip, travel_speed

# Weight of a position fix in the trend, and in the size of the innovations.
TREND_WEIGHT, SIZE_WEIGHT = 0.2, 0.1
# Variance of the trend of white innovations, over that of a single innovation.
WHITE_TREND_VARIANCE = TREND_WEIGHT / (2.0 - TREND_WEIGHT)
FULL_SIZE = 0.8  # size of the innovations below which a trend counts less: it scatters by a quarter
# Weight of a position fix in the factor on the slip, at speeds above this [m/s].
FACTOR_WEIGHT, MOVING = 1.0 / 30.0, 0.1
MEMORY = 300.0  # number of fixes while moving in which the excess of the factor over 1 falls to 1/e
# Share of the variances that rounding may leave of a component that the other one determines.
ROUNDING = 1e-12
# Normalised square of a trend at which the factor does not change: 1 for white innovations, and a quarter
# more, since a factor that cannot fall below 1 would grow by chance alone.
EXPECTED_SQUARE = 1.25
LARGEST_SQUARE, LARGEST_FACTOR = 10.0, 6.0  # upper bounds of that square and of the factor
# Weighted mean of normalised innovations, to the front and to the left of the robot, and their size: the
# mean NIS of a degree of freedom.
Trend = tuple[Any, Any, Any]


def inflate_by_lasting_slip(ekf: Ekf, yaw: float, interval: float) -> None:
    """Inflate slip and position by a slip that may have lasted for an interval [s]."""
    errors = lasting_slip(ekf.x.item(s.SLIP_X), (math.cos(yaw), math.sin(yaw)), interval)
    ekf.inflate_jointly((s.X, s.Y, s.SLIP_X), np.outer(errors, errors), of_motion=True)


def normalised(
    z: tuple[Any, Any], S: tuple[Any, Any, Any], heading: tuple[Any, Any] = (1.0, 0.0)
) -> tuple[Any, Any]:
    """Normalised innovation of a position fix, to the front and to the left [-].

    Args:
        z: innovation in x and y [m].
        S: its covariance, xx, xy and yy [m²].
        heading: cosine and sine of the yaw; by default the axes are those of odom.
    """
    cos, sin = heading
    forward, left = cos * z[0] + sin * z[1], cos * z[1] - sin * z[0]
    xx, xy, yy = S
    least = ROUNDING * (xx + yy)
    variance = max(cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy, least)
    shared = cos * sin * (yy - xx) + (cos * cos - sin * sin) * xy
    # What is new in the left component, and its variance: Cholesky's factors of the covariance.
    rest = left - shared / variance * forward
    rest_variance = max((xx * yy - xy * xy) / variance, least)
    return forward / math.sqrt(variance), rest / math.sqrt(rest_variance)


def trend_after(trend: Trend, z_forward: Any, z_left: Any) -> Trend:
    """Trend with the innovation of a newer fix, see `normalised` [-]."""
    forward, left, size = trend
    return (
        forward + TREND_WEIGHT * (z_forward - forward),
        left + TREND_WEIGHT * (z_left - left),
        size + SIZE_WEIGHT * (0.5 * (z_forward * z_forward + z_left * z_left) - size),
    )


def present_factor_after(factor: Any, trend: Trend, left: Any, right: Any) -> Any:
    """Factor on the slip by the newest fixes, after one that the gate admitted.

    The normalised square of the trend is 1 in the mean if the innovations are white. The factor grows
    with more, so slowly that single fixes hardly count, and is at least 1: fixes whose noise is smaller
    than they state must not make the slip vanish. The trend is by `trend_after`; speeds are in m/s.
    """
    trend_forward, trend_left, trend_size = trend
    trend_square = trend_forward * trend_forward + trend_left * trend_left
    trend_square = trend_square / (2.0 * WHITE_TREND_VARIANCE)
    size = min(1.0, trend_size / FULL_SIZE)
    weight = FACTOR_WEIGHT * share_of_moving(left, right)
    excess = min(LARGEST_SQUARE, size * size * trend_square) - EXPECTED_SQUARE
    grown = math.sqrt(factor * factor * (1.0 + weight * excess))
    return min(LARGEST_FACTOR, max(1.0, grown))


def slip_factor_after(factor: Any, present: Any, left: Any, right: Any) -> Any:
    """Factor on the slip after a position fix that the gate admitted.

    Ground that has been met is met again: the factor is the largest recent one, which is forgotten
    slowly. `present` is by `present_factor_after`; speeds of the tracks are in m/s.
    """
    forgotten = share_of_moving(left, right) / MEMORY
    return max(present, factor - forgotten * (factor - 1.0))


def share_of_moving(left: Any, right: Any) -> Any:
    """Weight of the motion at track speeds [m/s]: from 0 at rest to 1 above `MOVING`."""
    return min(1.0, travel_speed(left, right) / MOVING)


def follow_scatter(scatter: ScatterRecord, fix: TakenFix, correction: Floats) -> bool:
    """Add a position fix to the scatter; True if scatter is newly found."""
    x, y = normalised(fix.z, fix.S)
    count_innovation(scatter, x, y)
    return add_fix(scatter, fix, correction)


def inflate_by_corrections(ekf: Ekf, scatter: ScatterRecord) -> None:
    """Inflate all states but the fast slip by their corrections by scattering fixes."""
    variances = np.square(scatter.moved)
    variances[[s.X, s.Y]] = variances[s.X] + variances[s.Y]
    variances[s.FAST_SLIP] = 0.0
    ekf.inflate_jointly(tuple(range(len(variances))), np.diag(variances))
