"""Wander of position fixes: slow part of their error, against odometry.

The path by gyro and tracks has the right shape over a window of two minutes, but for its scale, its
heading, and the gyro's bias. These are fitted to the fixes in each window. What is left is the error of
the fixes, as far as the fit has not taken it: white noise, and a Gauss-Markov process of one standard
deviation and one correlation time for all windows. They are found by restricted maximum likelihood, which
accounts for the fit (Patterson and Thompson, Biometrika 58, 1971). Errors of odometry look like wander,
too: one that is not clearly larger than these is not proposed, unless the fixes state it themselves: a
receiver that states 0.8 m, and whose fixes scatter by 2 cm, has slow errors of the size that it states.

Places are complex numbers x + i y. So turn and scale are one factor, and both axes have one likelihood.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import pieces
from icreckon.estimator.log.series import running_integral

WINDOW = 120.0
"""Length of a window [s]."""
LEAST_WINDOWS = 2
"""Least number of windows."""
MOST_IN_WINDOW, FEWEST_IN_WINDOW = 100, 20
"""Fixes of a window that are used: no more than this, evenly thinned, and no fewer than that."""
LARGEST_HOLE = 1.0
"""Windows with a longer gap in the track speeds or the IMU are omitted [s]."""
TIMES = (4.0, 8.0, 15.0, 30.0, 60.0, 120.0, 240.0)
"""Candidate correlation times [s]."""
RATIOS = tuple(float(ratio) for ratio in np.logspace(-2.0, 2.0, 17))
"""Candidate ratios of the white noise to the wander, of their standard deviations [-]."""
CLEAR = 25.0
"""Twice the gain of the log likelihood over white noise alone from which a wander is clear."""
AS_GOOD = 4.0
"""Twice the loss of the log likelihood up to which another correlation time fits as well."""
STATED, STATED_AT_MOST = 3.0, 5.0
"""Stated standard deviation over that of the white part from which on the rest is slow, and the largest
wander over the stated one of which that is evidence [-]."""
ODOMETRY_ERROR = 0.03
"""Error of odometry that looks like wander, as a share of the way driven in its time [-]."""
SLOWEST_SLIP = 30.0
"""Least time over which errors of odometry are counted [s]."""
OUTLYING = 8.0
"""Distance from the median of five fixes, in median distances, beyond which a fix is left out [-]."""


class FixWanderEstimate(NamedTuple):
    """Error of the fixes of a log."""

    white: float  # standard deviation of the white part along each axis [m]
    sigma: float  # standard deviation of the wander along each axis [m]
    time: float  # its correlation time [s]
    times: tuple[float, float]  # shortest and longest candidate time that fits as well [s]
    reason: str  # reason not to propose it, empty if there is none
    # standard deviation that the fixes state, if this alone shows that they wander [m]
    stated: float | None = None

    @property
    def text(self) -> str:
        """Finding for people."""
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
        if self.stated is None:
            return text
        return (
            f"{text}: that is less than the {self.stated:.2g} m that they state, so the rest changes "
            "slowly (some of it may be odometry's)"
        )


class _Window(NamedTuple):
    """Fixes of a window."""

    seconds: Floats  # (n,) times [s]
    places: Floats  # (n,) fixes [m]
    design: Floats  # (n, k) orthonormal columns of the fit
    path: Floats  # (n,) path by odometry, in units of the tracks


class _Fit(NamedTuple):
    """Restricted likelihood of an error model."""

    likelihood: float
    variance: float


def estimate_wander(log: Log, vertical: Floats | None) -> FixWanderEstimate | str:
    """Estimate white noise and wander of a log's position fixes.

    Track speeds may have any unit; `vertical` (n,) is the IMU's rate about the vertical [rad/s].
    Returns the estimate, or the reason why there is none.
    """
    if log.fixes is None or not len(log.fixes.stamps):
        return "there are no fixes"
    if vertical is None or log.imu is None or len(log.tracks.stamps) < 2:
        return "there is no gyro, or no track speeds, to compare them with"
    windows = _windows(log, log.imu.stamps, vertical)
    if len(windows) < LEAST_WINDOWS:
        return (
            f"it takes {LEAST_WINDOWS} spans of {WINDOW:.0f} s with {FEWEST_IN_WINDOW} fixes, tracks and "
            f"IMU, found {len(windows)}"
        )
    white = _fit(windows, None)
    fits = {(time, ratio): _fit(windows, (time, ratio)) for time in TIMES for ratio in RATIOS}
    time, ratio = max(fits, key=lambda key: fits[key].likelihood)
    best = fits[time, ratio]
    sigma = float(np.sqrt(best.variance))
    by_time = {one: max(fits[one, ratio].likelihood for ratio in RATIOS) for one in TIMES}
    alike = [one for one in TIMES if 2.0 * (best.likelihood - by_time[one]) <= AS_GOOD]
    gain = 2.0 * (best.likelihood - white.likelihood)
    driven = _driven(windows, max(time, SLOWEST_SLIP))
    reason, stated = "", float(np.sqrt(np.median(log.fixes.variances[:, 0])))
    states_it = STATED * ratio * sigma < stated and sigma < STATED_AT_MOST * stated
    shown_by_odometry = sigma >= ODOMETRY_ERROR * driven
    if gain < CLEAR:
        reason = "white noise alone explains them"
    elif alike[0] > 0.5 * WINDOW:
        reason = f"it changes too slowly for spans of {WINDOW:.0f} s, as errors of odometry do"
    elif not (shown_by_odometry or states_it):
        reason = f"odometry may be off by as much over {driven:.0f} m of driving"
    if gain < CLEAR:
        sigma, white_sigma = 0.0, float(np.sqrt(white.variance))
    else:
        white_sigma = ratio * sigma
    only_by_stated = None if reason or shown_by_odometry else stated
    return FixWanderEstimate(
        white_sigma, sigma, time, (alike[0], alike[-1]), reason, only_by_stated
    )


def _windows(log: Log, stamps: Stamps, vertical: Floats) -> list[_Window]:
    """Cut the fixes into windows with enough fixes and no hole; positions are complex."""
    fixes = log.fixes
    if fixes is None or len(stamps) < 2:
        return []
    origin = stamps[0]
    seconds = (stamps - origin) * NANOSECOND
    yaw = running_integral(stamps, vertical)
    speed = np.interp(stamps, log.tracks.stamps, log.tracks.speeds.mean(axis=1))
    velocity = speed * np.exp(1j * yaw)
    path = running_integral(stamps, velocity)
    # Derivative of the path with respect to a bias of the gyro.
    by_bias = running_integral(stamps, velocity * 1j * seconds)

    inside = (fixes.stamps >= max(origin, log.tracks.stamps[0])) & (
        fixes.stamps <= min(stamps[-1], log.tracks.stamps[-1])
    )
    times = (fixes.stamps[inside] - origin) * NANOSECOND
    places = fixes.poses[inside, 0] + 1j * fixes.poses[inside, 1]
    found: list[_Window] = []
    if not len(times):
        return found
    numbers = np.unique((times - times[0]) // WINDOW)
    for number in numbers[:-1].tolist():
        begin = times[0] + number * WINDOW
        at = np.flatnonzero((times >= begin) & (times < begin + WINDOW))
        at = at[~_outlying(places[at])]
        at = at[:: max(1, -(-len(at) // MOST_IN_WINDOW))]
        whole = all(
            len(np.unique(pieces(series, LARGEST_HOLE)[_within(series, origin, begin)])) == 1
            for series in (stamps, log.tracks.stamps)
        )
        if len(at) < FEWEST_IN_WINDOW or not whole:
            continue
        of_path, of_bias = (np.interp(times[at], seconds, one) for one in (path, by_bias))
        columns = np.column_stack([np.ones(len(at)), of_path, of_bias])
        found.append(_Window(times[at], places[at], _orthonormal(columns), of_path))
    return found


def _within(stamps: Stamps, origin: int, begin: float) -> NDArray[np.bool_]:
    seconds = (stamps - origin) * NANOSECOND
    return (seconds >= begin) & (seconds < begin + WINDOW)


def _outlying(places: Floats) -> NDArray[np.bool_]:
    """Mask of the fixes (n,) that are far from their neighbours."""
    from scipy.ndimage import median_filter

    if len(places) < 5:
        return np.zeros(len(places), dtype=bool)
    x, y = (median_filter(one, 5, mode="mirror") for one in (places.real, places.imag))
    distance = np.abs(places - (x + 1j * y))
    return np.asarray(distance > OUTLYING * np.median(distance) + 1e-6)


def _orthonormal(columns: Floats) -> Floats:
    """Orthonormal basis of columns (n, k), without those that depend on others."""
    from scipy.linalg import orth

    scale = np.linalg.norm(columns, axis=0)
    return np.asarray(orth(columns / np.where(scale > 0.0, scale, 1.0), rcond=1e-6))


def _fit(windows: list[_Window], model: tuple[float, float] | None) -> _Fit:
    """Restricted likelihood of white noise, or of wander and white noise.

    `model` is the correlation time [s] and the ratio of the white noise to the wander; None for white
    noise alone. The variance is that of the wander, or of the white noise alone.
    """
    count, squares, logarithms = 0, 0.0, 0.0
    for window in windows:
        n, k = window.design.shape
        V = np.eye(n)
        if model is not None:
            time, ratio = model
            apart = np.abs(window.seconds[:, None] - window.seconds)
            V = np.exp(-apart / time) + ratio * ratio * V
        L = np.linalg.cholesky(V)
        whitened = np.linalg.solve(L, np.column_stack([window.design, window.places]))
        Q, R = np.linalg.qr(whitened[:, :k])
        rest = whitened[:, k] - Q @ (Q.conj().T @ whitened[:, k])
        squares += float(np.vdot(rest, rest).real)
        logarithms += 2.0 * float(np.log(L.diagonal()).sum() + np.log(np.abs(R.diagonal())).sum())
        count += n - k
    # Both axes: the variance of a complex number is twice that of each.
    variance = squares / count
    return _Fit(-count * float(np.log(variance)) - logarithms, 0.5 * variance)


def _driven(windows: list[_Window], time: float) -> float:
    """Mean distance driven in up to `WINDOW` seconds [m], at the scale of the fixes."""
    speeds = []
    for window in windows:
        columns = np.column_stack([np.ones(len(window.path)), window.path])
        scale = np.abs(np.linalg.lstsq(columns, window.places, rcond=None)[0][1])
        distance = scale * float(np.abs(np.diff(window.path)).sum())
        speeds.append(distance / float(window.seconds[-1] - window.seconds[0]))
    return float(np.mean(speeds)) * min(time, WINDOW)
