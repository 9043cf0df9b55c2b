"""Wander of position fixes: slow part of their error, against odometry.

The path by gyro and tracks has the right shape over a window of two minutes, but for its scale, its
heading, the gyro's bias, and the place of the antenna (or of the centre of turning). These are fitted to
the fixes in each window. What is left is the error of the fixes, as far as the fit has not taken it:
white noise, and a Gauss-Markov process of one standard deviation and one correlation time for all
windows. Both are found by restricted maximum likelihood, which accounts for the fit (Patterson and
Thompson, Biometrika 58, 1971). Errors of odometry look like wander, too: a wander that is not clearly
larger is not proposed, unless the fixes state it: a receiver that states 0.8 m, and whose fixes scatter
by 2 cm, has slow errors of the stated size.

Places are complex numbers x + i y. So turn and scale are one factor, and both axes have one likelihood.
The same fit over shorter windows gives the place of the antenna.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import are_within, pieces
from icreckon.estimator.log.series import running_integral
from icreckon.replay.estimates.imu_mounting import YawRates

WINDOW = 120.0  # length of a window [s]
LEAST_WINDOWS = 2  # least number of windows
ANTENNA_WINDOW = 30.0  # length of a window for the place of the antenna [s]
ANTENNA_WINDOWS, ANTENNA_ROUNDS = 3, 2  # least number of these; rounds to linearise the gyro's bias
LEAST_LEVER = 0.3  # a robot turns about a point up to this far from its middle [m]
LEAST_LAG, LAG_OBSERVABLE = 0.15, 0.05
"""Least lag of fixes that is not the lag of the robot behind its tracks, and largest error of one [s]."""
ANTENNA_SIGMAS = 5.0  # standard errors from which a place differs, in two axes and few windows
MOST_IN_WINDOW, FEWEST_IN_WINDOW = 100, 20
"""Fixes of a window that are used: no more than this, evenly thinned, and no fewer than that."""
LARGEST_HOLE = 1.0  # windows with a longer gap in the track speeds or the IMU are omitted [s]
TIMES = (4.0, 8.0, 15.0, 30.0, 60.0, 120.0, 240.0)  # candidate correlation times [s]
RATIOS = tuple(float(ratio) for ratio in np.logspace(-2.0, 2.0, 17))
"""Candidate ratios of the white noise to the wander, of their standard deviations [-]."""
CLEAR = 25.0  # least 2x gain of log likelihood over white noise of a clear wander
AS_GOOD = 4.0  # largest 2x loss of log likelihood of a correlation time that fits as well
STATED, STATED_AT_MOST = 3.0, 5.0
"""Stated standard deviation over that of the white part from which on the rest is slow, and the largest
wander over the stated one of which that is evidence [-]."""
ODOMETRY_ERROR = 0.03  # odometry error that looks like wander, as a share of distance [-]
SLOWEST_SLIP = 30.0  # least time over which errors of odometry are counted [s]
OUTLYING = 8.0  # least distance of outliers from the median of five, in median distances [-]


class FixWanderEstimate(NamedTuple):
    """Error of the fixes of a log."""

    white: float  # standard deviation of the white part along each axis [m]
    sigma: float  # standard deviation of the wander along each axis [m]
    time: float  # its correlation time [s]
    times: tuple[float, float]  # shortest and longest candidate time that fits as well [s]
    reason: str  # reason not to propose it, empty if there is none
    stated: float | None = None  # stated sigma, if it alone shows that the fixes wander [m]

    @property
    def text(self) -> str:
        """Finding on the error of the fixes, as a sentence for people."""
        white = f"white noise of {self.white:.2g} m"
        if not self.sigma:
            return f"{white}; {self.reason}, no wander is proposed"
        shortest, longest = self.times
        slow = (
            f"{self.sigma:.2g} m over {self.time:g} s ({shortest:g} to {longest:g} s fit as well)"
        )
        if self.reason:
            return f"{white}, and a slow part of {slow}; {self.reason}: no wander is proposed"
        text = f"their error wanders, by {slow}, besides {white}"
        if self.stated is not None:
            text += (
                f": that is less than the {self.stated:.2g} m that they state, so the rest changes "
            )
            text += "slowly (some of it may be odometry's)"
        return text


class _Window(NamedTuple):
    """Fixes of a window, and the path by odometry at their times, as complex numbers."""

    seconds: Floats  # (n,) times [s]
    positions: Floats  # (n,) fixes [m]
    columns: Floats  # (n, 4) regressors: 1, path by odometry, its change by a gyro bias, heading
    velocity: Floats  # (n,) velocity by odometry
    design: Floats  # (n, k) orthonormal regressors that span the columns


class _ErrorFit(NamedTuple):
    """Fit of an error model of the fixes to all windows."""

    likelihood: float  # logarithm of the restricted likelihood, less a constant
    variance: float  # variance of the wander along each axis [m²], of the white noise without one


def estimate_wander(
    log: Log, yaw_rates: YawRates | None, *, states_sigma: bool = True
) -> FixWanderEstimate | str:
    """Estimate white noise and wander of a log's fixes, or the reason why that fails.

    Track speeds may have any unit. The variances of the fixes count only if `states_sigma`.
    """
    if log.fixes is None or not len(log.fixes.stamps):
        return "there are no fixes"
    if yaw_rates is None or len(log.tracks.stamps) < 2:
        return "there is no gyro, or no track speeds, to compare them with"
    windows = _cut_windows(log, yaw_rates, WINDOW)
    if len(windows) < LEAST_WINDOWS:
        return (
            f"it takes {LEAST_WINDOWS} spans of {WINDOW:.0f} s with {FEWEST_IN_WINDOW} fixes, tracks and "
            f"IMU, found {len(windows)}"
        )
    white_fit = _fit_errors(windows, None)
    fits = {model: _fit_errors(windows, model) for model in product(TIMES, RATIOS)}
    time, ratio = max(fits, key=lambda model: fits[model].likelihood)
    best_fit = fits[time, ratio]
    least = best_fit.likelihood - 0.5 * AS_GOOD  # likelihood of models that fit as well
    as_good = [t for t in TIMES if any(fits[t, r].likelihood >= least for r in RATIOS)]
    times = as_good[0], as_good[-1]
    if ratio == RATIOS[0]:
        # White noise below the steps of the wander is not observable: the largest that fits as well.
        ratio = max(r for r in RATIOS if fits[time, r].likelihood >= least)
        best_fit = fits[time, ratio]
    if 2.0 * (best_fit.likelihood - white_fit.likelihood) < CLEAR:
        white = float(np.sqrt(white_fit.variance))
        return FixWanderEstimate(white, 0.0, time, times, "white noise alone explains them")
    sigma = float(np.sqrt(best_fit.variance))
    white = ratio * sigma
    stated = float(np.sqrt(np.median(log.fixes.variances[:, 0])))
    is_stated = states_sigma and STATED * white < stated and sigma < STATED_AT_MOST * stated
    driven = _distance_driven(windows, max(time, SLOWEST_SLIP))
    exceeds_odometry = sigma >= ODOMETRY_ERROR * driven
    reason = ""  # not to propose the wander, which may be odometry's
    if times[0] > 0.5 * WINDOW:
        reason = f"it changes too slowly for spans of {WINDOW:.0f} s, as errors of odometry do"
    elif not (exceeds_odometry or is_stated):
        reason = f"odometry may be off by as much over {driven:.0f} m of driving"
    is_only_stated = not reason and not exceeds_odometry
    return FixWanderEstimate(white, sigma, time, times, reason, stated if is_only_stated else None)


class FixFit(NamedTuple):
    """Place of the antenna, lag of the fixes and scale of the tracks, by the fixes."""

    place: Floats  # (2,) of the antenna, forward and left [m]
    sigma: float  # its standard error on each axis [m]
    scatter: float  # RMS distance of fixes from odometry in a window, all this included [m]
    scale: float  # distance by the fixes over that of the tracks
    scale_sigma: float  # its standard error
    lag: float  # of the fixes behind the tracks [s]; zero if it is not observable
    lag_sigma: float  # its standard error [s]

    def differs(self, place: Floats) -> bool:
        """True if the antenna is off a place (2,) [m] by more than odometry explains."""
        shift = float(np.hypot(*(self.place - place)))
        return shift >= max(LEAST_LEVER, ANTENNA_SIGMAS * self.sigma, 2.0 * self.scatter)

    @property
    def is_late(self) -> bool:
        """True if the fixes clearly lag."""
        return abs(self.lag) >= max(LEAST_LAG, ANTENNA_SIGMAS * self.lag_sigma)


def fit_fixes(log: Log, yaw_rates: YawRates | None) -> FixFit | None:
    """Fit place, lag and scale in each window; track speeds may have any unit.

    None if three windows do not show them: the robot has to turn. A lag takes changes of speed.
    """
    if yaw_rates is None or len(log.tracks.stamps) < 2:
        return None
    bias, windows, fits = 0.0, list[_Window](), list[_WindowFit]()
    for _ in range(ANTENNA_ROUNDS):
        corrected = yaw_rates._replace(rates=yaw_rates.rates + bias)
        windows = _cut_windows(log, corrected, ANTENNA_WINDOW)
        windows = [window for window in windows if window.design.shape == window.columns.shape]
        if len(windows) < ANTENNA_WINDOWS:
            return None
        fits = [_fit_window(window, with_lag=False) for window in windows]
        bias += float(np.median([fit.bias for fit in fits]))
    without_lag = _mean_fit(fits)
    with_lag = _mean_fit([_fit_window(window, with_lag=True) for window in windows])
    return with_lag if with_lag.lag_sigma < LAG_OBSERVABLE else without_lag


class _WindowFit(NamedTuple):
    """Fit of one window."""

    # (3,) complex: place of the antenna, forward + i left [m]; scale [-] and lag [s], which are real
    values: NDArray[np.complex128]
    weights: Floats  # (3,) inverse variances of the values
    bias: float  # error of the gyro's bias [rad/s]
    scatter: float  # RMS distance of the fixes from the fitted path [m]


def _fit_window(window: _Window, *, with_lag: bool) -> _WindowFit:
    """Fit the path by odometry to the fixes of a window, by linear least squares."""
    columns = window.columns
    if with_lag:
        columns = np.column_stack([columns, window.velocity])
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    inverse = np.linalg.pinv(columns / size) / size[:, None]
    factors = inverse @ window.positions
    _, by_path, by_bias, by_heading = factors[:4]
    residual = window.positions - columns @ factors
    scatter = max(float(np.sqrt(np.mean(np.abs(residual) ** 2))), 1e-6)
    weights = (scatter * np.linalg.norm(inverse, axis=1)) ** -2.0
    # The angle of the path's factor is the heading of odometry.
    place = by_heading * np.exp(-1j * np.angle(by_path))
    lag, lag_weight = 0.0, 1.0
    if with_lag:
        lag, lag_weight = -(factors[4] / by_path).real, weights[4] * abs(by_path) ** 2
    values = np.array([place, abs(by_path), lag])
    bias = float((by_bias / by_path).real)
    return _WindowFit(values, np.array([weights[3], weights[1], lag_weight]), bias, scatter)


def _mean_fit(fits: list[_WindowFit]) -> FixFit:
    """Means over windows, and standard errors by their spread: odometry errs more."""
    weights = np.array([fit.weights for fit in fits])
    values = np.array([fit.values for fit in fits])
    means = (weights * values).sum(axis=0) / weights.sum(axis=0)
    sigmas = np.sqrt((weights**2 * np.abs(values - means) ** 2).sum(axis=0)) / weights.sum(axis=0)
    sigmas *= np.sqrt(len(fits) / (len(fits) - 1.0))
    place_sigma, scale_sigma, lag_sigma = sigmas.tolist()
    _, scale, lag = means.real.tolist()
    return FixFit(
        place=np.array([means[0].real, means[0].imag]),
        sigma=place_sigma / math.sqrt(2.0),
        scatter=float(np.median([fit.scatter for fit in fits])),
        scale=scale,
        scale_sigma=scale_sigma,
        lag=lag,
        lag_sigma=lag_sigma,
    )


def _cut_windows(log: Log, yaw_rates: YawRates, length: float) -> list[_Window]:
    """Cut the fixes into windows of a length [s], with the path by odometry.

    Windows with holes or too few fixes are left out.
    """
    fixes, stamps = log.fixes, yaw_rates.stamps
    if fixes is None or len(stamps) < 2:
        return []
    origin = stamps[0]
    seconds = (stamps - origin) * NANOSECOND
    speed = np.interp(stamps, log.tracks.stamps, log.tracks.speeds.mean(axis=1))
    heading = np.exp(1j * running_integral(*yaw_rates))
    velocity = speed * heading
    path = running_integral(stamps, velocity)
    # Change of the path by a bias of the gyro.
    bias_path = running_integral(stamps, velocity * 1j * seconds)
    curves = (path, bias_path, heading, velocity)

    first, last = max(origin, log.tracks.stamps[0]), min(stamps[-1], log.tracks.stamps[-1])
    inside = (fixes.stamps >= first) & (fixes.stamps <= last)
    times = (fixes.stamps[inside] - origin) * NANOSECOND
    positions = fixes.poses[inside, 0] + 1j * fixes.poses[inside, 1]
    if not len(times):
        return []
    numbers = np.unique((times - times[0]) // length)[:-1]  # the last one is incomplete
    begins = times[0] + numbers * length
    ends, is_covered = begins + length, np.ones(len(begins), dtype=bool)
    for known in (stamps, log.tracks.stamps):
        known_seconds = (known - origin) * NANOSECOND
        is_covered &= are_within(pieces(known, LARGEST_HOLE), known_seconds, begins, ends)
    windows = []
    for begin, end in zip(begins[is_covered], ends[is_covered], strict=True):
        rows = np.flatnonzero((times >= begin) & (times < end))
        rows = rows[~_are_outliers(positions[rows])]
        rows = rows[:: max(1, math.ceil(len(rows) / MOST_IN_WINDOW))]
        if len(rows) < FEWEST_IN_WINDOW:
            continue
        place, bias_change, turn, moving = (np.interp(times[rows], seconds, c) for c in curves)
        # A bias turns the path about the heading at the middle of the window.
        bias_change = bias_change - 0.5j * (begin + end) * place
        columns = np.column_stack([np.ones(len(rows)), place, bias_change, turn])
        windows.append(_Window(times[rows], positions[rows], columns, moving, _basis(columns)))
    return windows


def _basis(columns: Floats) -> Floats:
    """Orthonormal columns (n, k) that span the complex columns (n, m)."""
    from scipy.linalg import orth

    scale = np.linalg.norm(columns, axis=0)
    basis: Floats = orth(columns / np.where(scale > 0.0, scale, 1.0), rcond=1e-6)
    return basis


def _are_outliers(positions: Floats) -> Flags:
    """Mask (n,) of the fixes that are far from the median of five, in x and in y."""
    from scipy.ndimage import median_filter

    if len(positions) < 5:
        return np.zeros(len(positions), dtype=bool)
    x, y = (median_filter(axis, 5, mode="mirror") for axis in (positions.real, positions.imag))
    distance = np.abs(positions - (x + 1j * y))
    return np.asarray(distance > OUTLYING * np.median(distance) + 1e-6)


def _fit_errors(windows: list[_Window], model: tuple[float, float] | None) -> _ErrorFit:
    """Fit the variance of an error model, by restricted maximum likelihood.

    `model` is the correlation time [s] and the ratio of the white noise to the wander; None: no wander.
    """
    freedom, squares, log_determinants = 0, 0.0, 0.0
    for window in windows:
        fixes, regressors = window.design.shape
        covariance = np.eye(fixes)  # over the variance that is fitted
        if model is not None:
            time, ratio = model
            lags = np.abs(window.seconds[:, None] - window.seconds)
            covariance = np.exp(-lags / time) + ratio * ratio * covariance
        factor = np.linalg.cholesky(covariance)
        whitened = np.linalg.solve(factor, np.column_stack([window.design, window.positions]))
        design, positions = whitened[:, :regressors], whitened[:, regressors]
        Q, R = np.linalg.qr(design)
        residual = positions - Q @ (Q.conj().T @ positions)
        squares += float(np.vdot(residual, residual).real)
        # Logarithms of the determinants of the covariance, and of the fit's information.
        log_covariance, log_fit = np.log(factor.diagonal()), np.log(np.abs(R.diagonal()))
        log_determinants += 2.0 * float(log_covariance.sum() + log_fit.sum())
        freedom += fixes - regressors
    # Both axes: the variance of a complex number is twice that of each.
    variance = squares / freedom
    return _ErrorFit(-freedom * float(np.log(variance)) - log_determinants, 0.5 * variance)


def _distance_driven(windows: list[_Window], time: float) -> float:
    """Mean distance driven in a time [s], by odometry at the scale of the fixes [m]."""
    speeds = []
    for window in windows:
        (_offset, factor), *_ = np.linalg.lstsq(window.columns[:, :2], window.positions, rcond=None)
        distance = np.abs(factor) * float(np.abs(np.diff(window.columns[:, 1])).sum())
        speeds.append(distance / float(window.seconds[-1] - window.seconds[0]))
    return float(np.mean(speeds)) * min(time, WINDOW)
