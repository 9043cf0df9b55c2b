"""Bias of a gyro by standstills, headings of a truth, or the tracks."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.lag_search import BLOCKS
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault
from icreckon.estimator.log.scores import even_grid
from icreckon.estimator.log.series import running_integral
from icreckon.replay.inspection.imu_mounting import (
    CLEAR_TURNING,
    ENOUGH_STILL,
    are_usable,
    standstill,
)
from icreckon.replay.inspection.wheels import jackknifed

WINDOW = 5.0
"""Time over which the turning by gyro and by truth or tracks is compared [s]."""
LARGEST_HOLE = 1.0
"""Windows with a longer gap between samples are left out [s]."""
SURE = 3.0
"""Standard errors beyond which a bias while driving is significant."""
UNSEEN_BIAS_SIGMA = 0.1
"""Standard error of a bias that a log does not show [rad/s]."""
LEAST_BY_TRACKS = 0.005
"""Least bias that tracks show [rad/s]: on the sample logs, tracks of a healthy gyro show 0.001."""


class GyroBias(NamedTuple):
    """Bias of the rate about the vertical."""

    value: float  # the bias [rad/s]
    sigma: float  # its standard error [rad/s]
    source: str  # "standstill", "truth" or "tracks"

    def differs(self, expected: float, sigma: float = 0.0) -> bool:
        """True if the bias differs significantly from one with this sigma [rad/s]."""
        least = LEAST_BY_TRACKS if self.source == "tracks" else 0.0
        return abs(self.value - expected) > max(least, SURE * float(np.hypot(sigma, self.sigma)))


def gyro_bias(log: Log, vertical: Floats, noise_density: float = 0.0) -> GyroBias | None:
    """Estimate the bias of the gyro; None if it is not observable.

    Standstill is used if it is long enough, else the headings of the truth, else the tracks, whose
    speeds may be rates. `vertical` (n,) is the rate about the vertical at the IMU's stamps [rad/s], and
    `noise_density` [rad/s/√Hz] its noise, for the error at standstill.
    """
    if log.imu is None or len(log.imu.stamps) < 2:
        return None
    tracks, imu = log.tracks, log.imu
    still = standstill(tracks, imu.stamps)
    seconds = float(still.sum()) * float(np.median(np.diff(imu.stamps))) * NANOSECOND
    if seconds >= ENOUGH_STILL:
        sigma = noise_density / float(np.sqrt(seconds))
        return GyroBias(float(vertical[still].mean()), sigma, "standstill")
    if not are_usable(tracks):
        return None
    source, stamps = "tracks", tracks.stamps
    left, right = tracks.speeds.T
    reference = np.column_stack(
        [running_integral(stamps, rate) for rate in (right - left, right + left)]
    )
    if log.truth is not None and log.truth.headings and heading_fault(log.truth) is None:
        source, stamps = "truth", log.truth.poses.stamps
        reference = np.unwrap(log.truth.poses.poses[:, 2:], axis=0)
    step = round(WINDOW / NANOSECOND)
    edges = even_grid(max(stamps[0], imu.stamps[0]), min(stamps[-1], imu.stamps[-1]), step, stamps)
    if len(edges) < 2 * BLOCKS:
        return None
    whole = np.diff(edges) == step
    for one in (stamps, imu.stamps):
        gaps = np.flatnonzero(np.diff(one) * NANOSECOND > LARGEST_HOLE)
        for begin, end in zip(one[gaps], one[gaps + 1], strict=True):
            whole &= (edges[1:] <= begin) | (edges[:-1] >= end)
    if whole.sum() < 2 * BLOCKS:
        return None
    turned = np.diff(np.interp(edges, imu.stamps, running_integral(imu.stamps, vertical)))
    moved = [np.diff(np.interp(edges, stamps, column)) for column in reference.T]
    design = np.column_stack([np.full(len(turned), WINDOW), *moved])[whole]
    if source == "tracks" and abs(np.corrcoef(design[:, 1], turned[whole])[0, 1]) < CLEAR_TURNING:
        return None

    def fitted(rows: NDArray[np.int_]) -> float:
        return float(np.linalg.lstsq(design[rows], turned[whole][rows], rcond=None)[0][0])

    bias, sigma = jackknifed(fitted, len(design))
    return GyroBias(bias, sigma, source) if sigma < UNSEEN_BIAS_SIGMA else None
