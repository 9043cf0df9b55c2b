"""Bias of a gyro by standstills, headings of a truth, or the tracks."""

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Indexes, true_runs
from icreckon.estimator.base.lag_search import BLOCKS
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault
from icreckon.estimator.log.series import running_integral
from icreckon.replay.estimates import imu_mounting
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.wheels import jackknifed, windows

# Time over which the turning by gyro and by truth or tracks is compared, and least in a short log [s].
WINDOW, LEAST_WINDOW = 5.0, 1.0
SURE = 3.0  # standard errors beyond which a bias while driving is significant
# Standard error of a bias that a log does not show, and of one by a frozen gyro [rad/s].
UNSEEN_BIAS_SIGMA, FROZEN = 0.1, 1e-9
FEWEST_STOPS, LEAST_CHANGE = 4, 0.001  # stops that show a change of the bias, its size [rad/s]
LEAST_BY_TRACKS = 0.005  # least bias that tracks show [rad/s]: 0.001 for healthy gyros


class GyroBias(NamedTuple):
    """Bias of the rate about the vertical."""

    value: float  # the bias [rad/s]
    sigma: float  # its standard error [rad/s]
    source: str  # "standstill", "truth" or "tracks"
    walk: float = 0.0  # its random walk over the standstills; 0 if none is clear [rad/s/√s]

    @property
    def is_clear(self) -> bool:
        """True if it is measured at standstill, or significantly off zero."""
        return self.source == "standstill" or self.differs(0.0)

    def differs(self, expected: float, sigma: float = 0.0) -> bool:
        """Return True if the bias is significantly off the expected one ± sigma [rad/s]."""
        least = LEAST_BY_TRACKS if self.source == "tracks" else 0.0
        return abs(self.value - expected) > max(least, SURE * float(np.hypot(sigma, self.sigma)))


def gyro_bias(log: Log, yaw_rates: YawRates, noise_density: float = 0.0) -> GyroBias | None:
    """Estimate the bias of the gyro; None if the log does not show it.

    A standstill is preferred, then the headings of a truth, then the tracks, whose speeds may be rates.
    The noise density of the gyro [rad/s/√Hz] gives the standard error at standstill.
    """
    stamps, rates = yaw_rates
    if len(stamps) < 2:
        return None
    is_still = imu_mounting.standstill(log.tracks, stamps, rates)
    seconds = float(is_still.sum()) * float(np.median(np.diff(stamps))) * NANOSECOND
    if seconds >= imu_mounting.ENOUGH_STILL:
        sigma = noise_density / float(np.sqrt(seconds))
        mean, walk = float(rates[is_still].mean()), _walk(yaw_rates, is_still)
        return GyroBias(mean, sigma, "standstill", walk)
    return bias_while_driving(log, yaw_rates)


def _walk(yaw_rates: YawRates, is_still: Flags) -> float:
    """Random walk of the bias [rad/s/√s] by its change over the standstills (mask n).

    A line is fitted to their means, since a warm-up changes the bias steadily. 0 if no change is clear.
    """
    stamps, rates = yaw_rates
    stops = [slice(first, last + 1) for first, last in true_runs(is_still)]
    if len(stops) < FEWEST_STOPS:
        return 0.0
    times = np.array([float(stamps[stop].mean() - stamps[0]) for stop in stops]) * NANOSECOND
    means = np.array([rates[stop].mean() for stop in stops])
    weights = np.sqrt([stop.stop - stop.start for stop in stops])
    (slope, _), covariance = np.polyfit(times, means, 1, w=weights, cov=True)
    duration = float(np.ptp(times))
    change = abs(float(slope)) * duration
    is_clear = change > max(LEAST_CHANGE, SURE * float(np.sqrt(covariance[0, 0])) * duration)
    return change / float(np.sqrt(duration)) if is_clear else 0.0


def bias_while_driving(log: Log, yaw_rates: YawRates) -> GyroBias | None:
    """Estimate the bias of the gyro by the headings of a truth, or else by the tracks.

    Linear regression: the gyro's turning in a window is the bias times the window's length, plus a factor
    times the turning of each reference. None if the log does not show it.
    """
    tracks = log.tracks
    if not imu_mounting.are_usable(tracks):
        return None
    if log.truth is not None and log.truth.headings and heading_fault(log.truth) is None:
        source, stamps = "truth", log.truth.poses.stamps
        references = [np.unwrap(log.truth.poses.poses[:, 2])]
    else:
        source, stamps = "tracks", tracks.stamps
        left, right = tracks.speeds.T
        # The sum counts, too: unequal radii turn the robot by a share of the distance.
        references = [running_integral(stamps, speeds) for speeds in (right - left, right + left)]
    both = min(stamps[-1], yaw_rates.stamps[-1]) - max(stamps[0], yaw_rates.stamps[0])
    window = min(WINDOW, max(LEAST_WINDOW, float(both) * NANOSECOND / (2 * BLOCKS + 1)))
    edges, is_whole = windows(window, stamps, yaw_rates.stamps)
    if is_whole.sum() < 2 * BLOCKS:
        return None
    turned = np.interp(edges, yaw_rates.stamps, running_integral(*yaw_rates))
    turning = np.diff(turned)[is_whole]
    changes = [np.diff(np.interp(edges, stamps, column))[is_whole] for column in references]
    if source == "tracks":
        correlation = np.corrcoef(changes[0], turning)[0, 1]
        if abs(correlation) < imu_mounting.CLEAR_TURNING:
            return None
    design = np.column_stack([np.full(len(turning), window), *changes])

    def fitted_bias(rows: Indexes) -> float:
        (bias, *_factors), *_ = np.linalg.lstsq(design[rows], turning[rows], rcond=None)
        return float(bias)

    bias, sigma = jackknifed(fitted_bias, len(design))
    return GyroBias(bias, sigma, source) if FROZEN < sigma < UNSEEN_BIAS_SIGMA else None
