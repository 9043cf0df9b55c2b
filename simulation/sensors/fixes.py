"""Position fixes of a true motion: noise, outliers, latency, outages.

Every figure has its own random numbers, so that changing one changes no other error.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.series import FixSeries
from icreckon.simulation.base.sampling import to_stamps
from icreckon.simulation.truth.true_motion import TrueMotion

# A fix without error still says that it is good to a millimetre (a milliradian): a log has no room
# for a variance of zero.
SMALLEST_FIX_SIGMA = 1e-3


class FixErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of position fixes.

    Attributes:
        sigma: standard deviation of each coordinate [m].
        heading_sigma: standard deviation of yaw [rad], or None for fixes without heading.
        outlier_share: share of fixes that are outliers [-].
        outlier_sigma: standard deviation of what an outlier has more, in each coordinate [m]. The log
            states the variance of an ordinary fix for it.
        latency: a fix that arrives (and is stamped) now shows the pose of so long ago [s].
    """

    sigma: float = 0.05
    heading_sigma: float | None = None
    outlier_share: float = 0.0
    outlier_sigma: float = 2.0
    latency: float = 0.0


def read_fixes(
    motion: TrueMotion,
    times: Floats,
    errors: FixErrors,
    outages: tuple[tuple[float, float], ...],
    rng: Generator,
) -> FixSeries:
    """Position fixes, with heading where its sigma is given, and none in an outage.

    What is older than the run shows the pose at its start, where the robot stood.

    Args:
        motion: the true motion.
        times: (n,) when fixes arrive [s].
        errors: of the fixes.
        outages: start and end [s] of each time in which no fix arrives, both included.
        rng: draws the errors, those of fixes lost in an outage included.
    """
    poses = motion.poses_at(shown_times(times, errors))
    return with_fix_errors(poses, times, errors, outages, rng)


def shown_times(times: Floats, errors: FixErrors) -> Floats:
    """Of when (n,) fixes that arrive at these times (n,) show the pose [s]."""
    return np.maximum(times - errors.latency, 0.0)


def with_fix_errors(
    poses: Floats,
    times: Floats,
    errors: FixErrors,
    outages: tuple[tuple[float, float], ...],
    rng: Generator,
) -> FixSeries:
    """Fixes that show true poses (n, 3); other arguments as those of `read_fixes`."""
    choices, sizes = rng.spawn(2)
    sigmas = np.array([errors.sigma, errors.sigma, errors.heading_sigma or 0.0])
    poses = poses + sigmas * rng.standard_normal(poses.shape)
    outlying = choices.random(len(times)) < errors.outlier_share
    excess = errors.outlier_sigma * sizes.standard_normal((len(times), 2))
    poses[:, :2] += np.where(outlying[:, None], excess, 0.0)
    if errors.heading_sigma is None:
        poses[:, 2] = np.nan
    stated = np.maximum(sigmas[1:], SMALLEST_FIX_SIGMA) ** 2
    seen = np.ones(len(times), dtype=bool)
    for start, end in outages:
        seen &= (times < start) | (times > end)
    stamps = to_stamps(times)[seen]
    return FixSeries(stamps, poses[seen], np.tile(stated, (len(stamps), 1)))
