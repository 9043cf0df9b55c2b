"""Bias of a gyro by standstills, headings of a truth, or the tracks."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.lag_search import BLOCKS
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault
from icreckon.estimator.log.scores import are_within, even_grid, pieces
from icreckon.estimator.log.series import running_integral
from icreckon.replay.inspection import imu_mounting
from icreckon.replay.inspection.wheels import jackknifed

WINDOW = 5.0  # time over which the turning by gyro and by truth or tracks is compared [s]
LARGEST_HOLE = 1.0  # windows with a longer gap between samples are left out [s]
SURE = 3.0  # standard errors beyond which a bias while driving is significant
UNSEEN_BIAS_SIGMA = 0.1  # standard error of a bias that a log does not show [rad/s]
LEAST_BY_TRACKS = 0.005  # least bias that tracks show [rad/s]: 0.001 for healthy gyros


class GyroBias(NamedTuple):
    """Bias of the rate about the vertical."""

    value: float  # the bias [rad/s]
    sigma: float  # its standard error [rad/s]
    source: str  # "standstill", "truth" or "tracks"

    def differs(self, expected: float, sigma: float = 0.0) -> bool:
        """Return True if the bias is significantly not the expected one ± sigma [rad/s]."""
        least = LEAST_BY_TRACKS if self.source == "tracks" else 0.0
        return abs(self.value - expected) > max(least, SURE * float(np.hypot(sigma, self.sigma)))


def gyro_bias(log: Log, vertical: Floats, noise_density: float = 0.0) -> GyroBias | None:
    """Estimate the bias of the gyro; None if the log does not show it.

    A standstill is preferred, then the headings of a truth, then the tracks, whose speeds may be rates.
    `vertical` (n,) is the rate about the vertical at the IMU's stamps [rad/s], the noise density its
    noise, for the error at standstill [rad/s/√Hz].
    """
    if log.imu is None or len(log.imu.stamps) < 2:
        return None
    is_still = imu_mounting.standstill(log.tracks, log.imu.stamps)
    seconds = float(is_still.sum()) * float(np.median(np.diff(log.imu.stamps))) * NANOSECOND
    if seconds >= imu_mounting.ENOUGH_STILL:
        sigma = noise_density / float(np.sqrt(seconds))
        return GyroBias(float(vertical[is_still].mean()), sigma, "standstill")
    return bias_while_driving(log, vertical)


def bias_while_driving(log: Log, vertical: Floats) -> GyroBias | None:
    """Estimate the bias of the gyro by the headings of a truth, or else by the tracks.

    Turning by the gyro in windows is fitted by a bias times the window, plus a factor times each
    reference. Arguments and result are those of `gyro_bias`.
    """
    tracks, imu = log.tracks, log.imu
    if imu is None or not imu_mounting.are_usable(tracks):
        return None
    if log.truth is not None and log.truth.headings and heading_fault(log.truth) is None:
        source, stamps = "truth", log.truth.poses.stamps
        references = [np.unwrap(log.truth.poses.poses[:, 2])]
    else:
        source, stamps = "tracks", tracks.stamps
        left, right = tracks.speeds.T
        # Unequal radii turn the robot by a share of the distance.
        references = [running_integral(stamps, speeds) for speeds in (right - left, right + left)]
    step = round(WINDOW / NANOSECOND)
    edges = even_grid(max(stamps[0], imu.stamps[0]), min(stamps[-1], imu.stamps[-1]), step, stamps)
    if len(edges) < 2 * BLOCKS:
        return None
    is_whole = np.diff(edges) == step
    for times in (stamps, imu.stamps):
        is_whole &= are_within(pieces(times, LARGEST_HOLE), times, edges[:-1], edges[1:])
    if is_whole.sum() < 2 * BLOCKS:
        return None
    turned = np.interp(edges, imu.stamps, running_integral(imu.stamps, vertical))
    turning = np.diff(turned)[is_whole]
    changes = [np.diff(np.interp(edges, stamps, column))[is_whole] for column in references]
    if source == "tracks":
        correlation = np.corrcoef(changes[0], turning)[0, 1]
        if abs(correlation) < imu_mounting.CLEAR_TURNING:
            return None
    design = np.column_stack([np.full(len(turning), WINDOW), *changes])

    def fitted_bias(rows: NDArray[np.int_]) -> float:
        (bias, *_factors), *_ = np.linalg.lstsq(design[rows], turning[rows], rcond=None)
        return float(bias)

    bias, sigma = jackknifed(fitted_bias, len(design))
    return GyroBias(bias, sigma, source) if sigma < UNSEEN_BIAS_SIGMA else None
