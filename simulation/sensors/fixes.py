"""Position fixes of a true motion: noise, wander, outliers, latency, outages.

Every parameter has its own random numbers, so that changing one changes no other error.
"""

import msgspec
import numpy as np
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.series import FixSeries
from icreckon.simulation.base.sampling import to_stamps
from icreckon.simulation.truth.true_motion import gauss_markov

# Least sigma that a fix states, even without error: a log allows no variance of zero [m, rad].
SMALLEST_FIX_SIGMA = 1e-3


class FixErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of position fixes.

    Attributes:
        sigma: standard deviation of each coordinate [m].
        heading_sigma: standard deviation of yaw [rad], or None for fixes without heading.
        outlier_share: share of fixes that are outliers [-].
        outlier_sigma: standard deviation of the additional error of an outlier, in each coordinate
            [m]. The log states the variance of an ordinary fix for it.
        latency: age of the measured pose when the fix arrives and is stamped [s].
        wander_sigma: standard deviation of the error that wanders, in each coordinate: a first-order
            Gauss-Markov process, in addition to `sigma` [m].
        wander_time: its correlation time [s].
    """

    sigma: float = 0.05
    heading_sigma: float | None = None
    outlier_share: float = 0.0
    outlier_sigma: float = 2.0
    latency: float = 0.0
    wander_sigma: float = 0.0
    wander_time: float = 60.0


def measured_pose_times(times: Floats, errors: FixErrors) -> Floats:
    """Times (n,) of the poses measured by fixes that arrive at `times` (n,) [s].

    A fix of a pose before the run measures the pose at its start, where the robot stood.
    """
    return np.maximum(times - errors.latency, 0.0)


def with_fix_errors(
    poses: Floats,
    times: Floats,
    errors: FixErrors,
    outages: tuple[tuple[float, float], ...],
    rng: Generator,
) -> FixSeries:
    """Position fixes, with heading if its sigma is given, and none in an outage.

    `poses` (n, 3) are the true ones at `measured_pose_times`, `times` (n,) those of arrival, evenly
    spaced [s]. Outages include their start and end [s]; errors of fixes lost in one are drawn, too.
    """
    outlier_rng, size_rng, wander_rng = rng.spawn(3)
    sigmas = np.array([errors.sigma, errors.sigma, errors.heading_sigma or 0.0])
    poses = poses + sigmas * rng.standard_normal(poses.shape)
    is_outlier = outlier_rng.random(len(times)) < errors.outlier_share
    excess = errors.outlier_sigma * size_rng.standard_normal((len(times), 2))
    poses[:, :2] += np.where(is_outlier[:, None], excess, 0.0)
    if errors.wander_sigma > 0.0 and len(times):
        step = float(times[1] - times[0]) if len(times) > 1 else 1.0  # any, for a single fix
        unit = gauss_markov(len(times), step, errors.wander_time, wander_rng)
        poses[:, :2] += errors.wander_sigma * unit[:, :2]
    if errors.heading_sigma is None:
        poses[:, 2] = np.nan
    # One for both coordinates and one for yaw, of outliers too.
    stated_variances = np.maximum(sigmas[1:], SMALLEST_FIX_SIGMA) ** 2
    is_received = np.ones(len(times), dtype=bool)
    for start, end in outages:
        is_received &= (times < start) | (times > end)
    stamps = to_stamps(times)[is_received]
    return FixSeries(stamps, poses[is_received], np.tile(stated_variances, (len(stamps), 1)))
