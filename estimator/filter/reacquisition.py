"""Relocation: align the estimated path with rejected position fixes.

When fixes are rejected in a row, the position or the heading may be wrong. If it is the heading, using
the next fix corrects the position for a moment only: the estimate drives away from the fixes again. But
the estimated path since then has the right shape. So it is aligned with the rejected fixes by the turn
and the shift of least squares (closed form in the plane: Umeyama, Least-squares estimation of
transformation parameters between two point patterns, IEEE Trans. PAMI 13, 1991). The result is used if
the residuals agree with the variances of the fixes. Functions are plain Python, also for numba.
"""

import math
from typing import Annotated, NamedTuple

import msgspec

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.records import zeros
from icreckon.estimator.log.measurements import Vector3

FEWEST_REJECTED, MOST_KEPT = 5, 64  # least number of rejected fixes, and most that are kept
# Largest standard deviation of the turn [rad], and least turn, in such standard deviations; otherwise a
# shift is enough.
LARGEST_TURN_SIGMA, LEAST_TURN_SIGMAS = 0.3, 4.0
# Largest mean square of the residuals: multiple of the variance of the fixes, plus the square of a share
# of the path's extent, for its drift.
LARGEST_VARIANCE_FACTOR, LARGEST_WARP = 4.0, 0.05
OfRejected = Annotated[list[float], msgspec.Meta(min_length=MOST_KEPT, max_length=MOST_KEPT)]


class RejectedRecord(msgspec.Struct):
    """Position fixes that were rejected since one was used, oldest first."""

    count: Annotated[int, msgspec.Meta(ge=0, le=MOST_KEPT)] = 0  # their number
    x: OfRejected = zeros(MOST_KEPT)  # measured [m]
    y: OfRejected = zeros(MOST_KEPT)  # measured [m]
    variance: OfRejected = zeros(MOST_KEPT)  # of each coordinate, relative to the first fix [m²]
    predicted_x: OfRejected = zeros(MOST_KEPT)  # predicted [m]
    predicted_y: OfRejected = zeros(MOST_KEPT)  # predicted [m]


def add_rejected(
    rejected: RejectedRecord, fix: Vector3, predicted: Vector3, wandered: float
) -> None:
    """Add a position fix: x, y [m], variance [m²]; keep the newest `MOST_KEPT`.

    `predicted` is its x and y by the filter [m], `wandered` the variance that the wander has gained since
    the fix before [m²].
    """
    if rejected.count == MOST_KEPT:
        for k in range(MOST_KEPT - 1):
            rejected.x[k], rejected.y[k] = rejected.x[k + 1], rejected.y[k + 1]
            rejected.variance[k] = rejected.variance[k + 1]
            rejected.predicted_x[k] = rejected.predicted_x[k + 1]
            rejected.predicted_y[k] = rejected.predicted_y[k + 1]
        rejected.count -= 1
    k = rejected.count
    added = rejected.variance[k - 1] + wandered if k > 0 else 0.0
    rejected.x[k], rejected.y[k] = fix[0], fix[1]
    rejected.variance[k] = max(fix[2], added)
    rejected.predicted_x[k], rejected.predicted_y[k] = predicted[0], predicted[1]
    rejected.count = k + 1


def relocate(
    rejected: RejectedRecord, pose: Floats, covariance: Floats, wander_sigma: float
) -> bool:
    """Align a pose (3,) with the rejected fixes; return False if they do not fit.

    The pose [m, m, rad] is changed in place. The covariance (5, 5) of pose and wander of the fixes is
    overwritten; the wander restarts at zero, with `wander_sigma` [m]. A fix is the position plus the
    wander, so their errors are opposite: the position gets the wander's variance, and minus that with it.
    """
    fit = aligned_path(rejected)
    if not fit.fits:
        return False
    cos, sin = math.cos(fit.turn), math.sin(fit.turn)
    # Position relative to the path's middle, before and after the turn.
    x, y = pose[0] - fit.x, pose[1] - fit.y
    turned_x, turned_y = cos * x - sin * y, sin * x + cos * y
    pose[0], pose[1], pose[2] = fit.to_x + turned_x, fit.to_y + turned_y, pose[2] + fit.turn
    # Derivative of the pose by the turn.
    by_turn, wander_variance = (-turned_y, turned_x, 1.0), wander_sigma * wander_sigma
    covariance[:] = 0.0
    for i in range(3):
        for j in range(3):
            covariance[i, j] = fit.turn_variance * by_turn[i] * by_turn[j]
    for axis in range(2):
        covariance[axis, axis] += fit.variance + wander_variance
        covariance[3 + axis, 3 + axis] = wander_variance
        covariance[axis, 3 + axis] = covariance[3 + axis, axis] = -wander_variance
    return True


class Alignment(NamedTuple):
    """Alignment of the estimated path with the fixes."""

    fits: bool  # the residuals agree with the variances of the fixes
    turn: float  # rotation about the path's middle, counter-clockwise [rad]
    turn_variance: float  # its variance [rad²]
    x: float  # middle of the estimated path [m]
    y: float  # see above [m]
    to_x: float  # position of the middle after the alignment [m]
    to_y: float  # see above [m]
    variance: float  # variance of each of its coordinates [m²]


def aligned_path(rejected: RejectedRecord) -> Alignment:
    """Align the estimated path with the rejected fixes by least squares.

    The path does not fit with too few fixes, large residuals, or an uncertain or insignificant turn.
    """
    no_fit = Alignment(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    to_x = to_y = x = y = variance = 0.0
    count = rejected.count
    for k in range(count):
        to_x += rejected.x[k] / count
        to_y += rejected.y[k] / count
        variance = max(variance, rejected.variance[k])
        x += rejected.predicted_x[k] / count
        y += rejected.predicted_y[k] / count
    extent = along = across = 0.0
    for k in range(count):
        path_x, path_y = rejected.predicted_x[k] - x, rejected.predicted_y[k] - y
        fix_x, fix_y = rejected.x[k] - to_x, rejected.y[k] - to_y
        extent += path_x * path_x + path_y * path_y
        along += path_x * fix_x + path_y * fix_y
        across += path_x * fix_y - path_y * fix_x
    if count < FEWEST_REJECTED or extent <= 0.0:
        return no_fit
    turn = math.atan2(across, along)
    cos, sin = math.cos(turn), math.sin(turn)
    squares = 0.0
    for k in range(count):
        path_x, path_y = rejected.predicted_x[k] - x, rejected.predicted_y[k] - y
        residual_x = rejected.x[k] - to_x - (cos * path_x - sin * path_y)
        residual_y = rejected.y[k] - to_y - (sin * path_x + cos * path_y)
        squares += residual_x * residual_x + residual_y * residual_y
    residual_variance = squares / (2.0 * count - 3.0)
    warp_variance = LARGEST_WARP * LARGEST_WARP * extent / count
    if residual_variance > LARGEST_VARIANCE_FACTOR * variance + warp_variance:
        return no_fit
    noise = max(variance, residual_variance)
    turn_variance = noise / extent
    sigma = math.sqrt(turn_variance)
    if sigma > LARGEST_TURN_SIGMA or abs(turn) < LEAST_TURN_SIGMAS * sigma:
        return no_fit
    return Alignment(True, turn, turn_variance, x, y, to_x, to_y, noise)
