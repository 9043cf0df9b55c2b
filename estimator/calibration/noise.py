"""Noise of the residuals: variance components, and weights against outliers.

Errors of the truth at each knot are shared by two neighbouring segments: their errors have a correlation
of -1/2. The model error grows with the difference of the tracks and with the distance. Residuals are
Student-t: each row has the weight (nu + 1) / (nu + u²) of its standardised residual u (Lange, Little and
Taylor, Robust statistical modeling using the t distribution, JASA 84, 1989).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.calibration.residuals import ACROSS, ALONG, BINS, FORCE, SLIP, YAW, Problem

FREEDOM = 5.0
"""Degrees of freedom of Student's t."""
CLOSE = 0.02
"""Tolerances of the logarithms of components, and of the log likelihood."""
SMALLEST, LARGEST = 1e-5, 10.0
"""Bounds of every component's standard deviation, in the units of its row."""


@dataclass(frozen=True)
class Channel:
    """Rows with a common covariance: a sum of matrices times squared components."""

    name: str  # name for reports
    rows: NDArray[np.int64]  # (r, 2) segment and row of each
    # (c, b, r) matrix of each component, as lower bands in the format of scipy.linalg
    bands: Floats

    def covariance(self, components: Floats) -> Floats:
        """Covariance as lower bands (b, r)."""
        return np.asarray(np.tensordot(components**2, self.bands, 1))

    def variances(self, components: Floats) -> Floats:
        """Variances (r,), the diagonal of the covariance."""
        return np.asarray(np.tensordot(components**2, self.bands[:, 0], 1))

    def of(self, values: Floats) -> Floats:
        """Rows (r, ...) of the channel from values (n, ROWS, ...)."""
        return values[self.rows[:, 0], self.rows[:, 1]]


@dataclass(frozen=True)
class Noise:
    """Noise model: channels, their components, and the weight of each row."""

    channels: tuple[Channel, ...]  # the channels
    components: tuple[Floats, ...]  # (c,) standard deviations of each channel
    weights: tuple[Floats, ...]  # (r,) weights of each channel


def channels_of(problem: Problem, heading: Floats) -> tuple[Channel, ...]:
    """Channels of a problem, by the middle heading (n,) of each segment [rad]."""
    recording = problem.recording
    speeds = recording.speeds(0.0)
    turning = np.abs(speeds[..., 1] - speeds[..., 0]).sum(axis=1) * recording.cell
    driving = np.abs(speeds.mean(axis=-1)).sum(axis=1) * recording.cell
    counted = problem.counted_rows()
    channels = []
    # Position: along and across of a segment side by side.
    at = np.flatnonzero(counted[:, ALONG])
    rows = np.stack([np.repeat(at, 2), np.tile([ALONG, ACROSS], len(at))], axis=-1)
    bands = np.zeros((5, 4, 2 * len(at)))
    bands[0, 0] = 2.0
    linked = _linked(recording.follows, at)
    turn = heading[at][1:] - heading[at][:-1]
    cos, sin = np.where(linked, np.cos(turn), 0.0), np.where(linked, np.sin(turn), 0.0)
    # Noise at the shared knot, along the later heading and the earlier one: -R(turn).
    first = 2 * np.arange(len(at) - 1)
    bands[0, 2, first], bands[0, 2, first + 1] = -cos, -cos
    bands[0, 3, first] = sin
    bands[0, 1, first + 1] = -sin
    for component, (row, size) in enumerate(
        ((0, turning), (0, driving), (1, turning), (1, driving)), start=1
    ):
        bands[component, 0, row::2] = size[at] ** 2
    channels.append(Channel("position", rows, bands))
    at = np.flatnonzero(counted[:, SLIP])
    still = ~recording.moving[at]
    parts = [np.ones(len(at)), turning[at] ** 2, driving[at] ** 2]
    parts[1][still] = parts[2][still] = 0.0
    rows = np.stack([at, np.full(len(at), SLIP)], axis=-1)
    channels.append(Channel("slip", rows, np.stack(parts)[:, None]))
    at = np.flatnonzero(counted[:, YAW])
    if len(at):
        bands = np.zeros((2, 2, len(at)))
        bands[0, 0], bands[1, 0] = 2.0, 1.0
        bands[0, 1, : len(at) - 1] = -1.0 * _linked(recording.follows, at)
        rows = np.stack([at, np.full(len(at), YAW)], axis=-1)
        channels.append(Channel("yaw", rows, bands))
    at = np.flatnonzero(counted[:, FORCE])
    for first_row, name in ((FORCE, "forward force"), (FORCE + BINS, "left force")):
        if not len(at):
            continue
        rows = np.stack([np.repeat(at, BINS), np.tile(first_row + np.arange(BINS), len(at))], -1)
        bands = np.zeros((3, BINS, BINS * len(at)))
        bands[0, 0] = 1.0
        bands[1, 0] = np.repeat(turning[at] ** 2, BINS)
        # The third component is common to all parts of a segment: slopes.
        part = np.arange(BINS * len(at)) % BINS
        for band in range(BINS):
            bands[2, band] = part + band < BINS
        channels.append(Channel(name, rows, bands))
    return tuple(channels)


def first_noise(channels: tuple[Channel, ...], residuals: Floats) -> Noise:
    """Initial noise, of which each component alone explains the residuals."""
    components = []
    for channel in channels:
        sizes = channel.bands[:, 0].mean(axis=1)
        # The median size of normal errors is 0.67 standard deviations.
        typical = np.median(np.abs(channel.of(residuals))) / 0.67 + SMALLEST
        components.append(np.clip(typical / np.sqrt(len(sizes) * sizes), SMALLEST, LARGEST))
    weights = tuple(np.ones(len(channel.rows)) for channel in channels)
    return Noise(channels, tuple(components), weights)


def refined(noise: Noise, residuals: Floats, *, components_too: bool = True) -> Noise:
    """Refit noise to residuals (n, ROWS): weights, then maximum-likelihood components."""
    components, weights = [], []
    for channel, sizes in zip(noise.channels, noise.components, strict=True):
        own = channel.of(residuals)
        weight = t_weights(own, channel.variances(sizes))
        if components_too:
            sizes = _most_likely(channel, sizes, own * np.sqrt(weight))
            weight = t_weights(own, channel.variances(sizes))
        components.append(sizes)
        weights.append(weight)
    return Noise(noise.channels, tuple(components), tuple(weights))


def t_weights(residuals: Floats, variances: Floats) -> Floats:
    """Weights of residuals under Student's t."""
    return (FREEDOM + 1.0) / (FREEDOM + residuals**2 / variances)


def log_density(residuals: Floats, variances: Floats) -> Floats:
    """Log density of Student's t with these squared scales."""
    from math import lgamma

    constant = lgamma(0.5 * (FREEDOM + 1)) - lgamma(0.5 * FREEDOM)
    constant -= 0.5 * np.log(FREEDOM * np.pi)
    squared = residuals**2 / variances
    tail = 0.5 * (FREEDOM + 1) * np.log1p(squared / FREEDOM)
    return np.asarray(constant - 0.5 * np.log(variances) - tail)


def information(
    noise: Noise, residuals: Floats, jacobian: Floats, block: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Information and score of each block, so that both add up.

    Args:
        noise: fitted noise.
        residuals: (n, ROWS) residuals.
        jacobian: (n, ROWS, p) their derivatives.
        block: (n,) block of each segment.

    Returns:
        Information (blocks, p, p) and score (blocks, p). Correlated rows of two blocks count half to
        either.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded

    blocks, size = int(block.max()) + 1, jacobian.shape[-1]
    fisher, score = np.zeros((blocks, size, size)), np.zeros((blocks, size))
    for channel, sizes, weight in zip(noise.channels, noise.components, noise.weights, strict=True):
        root = np.sqrt(weight)
        own = channel.of(residuals) * root
        slopes = channel.of(jacobian) * root[:, None]
        factor = cholesky_banded(channel.covariance(sizes), lower=True)
        solved = cho_solve_banded((factor, True), np.column_stack([own, slopes]))
        row_blocks = block[channel.rows[:, 0]]
        for number in np.unique(row_blocks):
            own_rows = row_blocks == number
            half = slopes[own_rows].T @ solved[own_rows, 1:]
            fisher[number] += 0.5 * (half + half.T)
            score[number] += slopes[own_rows].T @ solved[own_rows, 0]
    return fisher, score


def flattening(noise: Noise, residuals: Floats) -> float:
    """Correction factor of the information of weighted squares, 0.3 to 1.

    It is the mean slope of the influence function over the mean weight (Huber, Robust Statistics), the
    least of all channels.
    """
    least = 1.0
    for channel, sizes in zip(noise.channels, noise.components, strict=True):
        squared = channel.of(residuals) ** 2 / channel.variances(sizes)
        weight = (FREEDOM + 1.0) / (FREEDOM + squared)
        slope = weight - 2.0 * (FREEDOM + 1.0) * squared / (FREEDOM + squared) ** 2
        least = min(least, float(slope.mean() / weight.mean()))
    return max(least, 0.3)


def cost(noise: Noise, residuals: Floats) -> float:
    """Twice the negative log likelihood of residuals (n, ROWS), without constants.

    The weights are fixed.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded

    total = 0.0
    for channel, sizes, weight in zip(noise.channels, noise.components, noise.weights, strict=True):
        own = channel.of(residuals) * np.sqrt(weight)
        factor = cholesky_banded(channel.covariance(sizes), lower=True)
        total += float(own @ cho_solve_banded((factor, True), own))
    return total


def _most_likely(channel: Channel, start: Floats, residuals: Floats) -> Floats:
    """Maximum-likelihood components of Gaussian residuals (r,), from an initial value."""
    from scipy.linalg import cho_solve_banded, cholesky_banded
    from scipy.optimize import minimize

    floor = np.zeros_like(channel.bands[0])
    floor[0] = SMALLEST**2

    def cost_of(logs: Floats) -> float:
        bands = channel.covariance(np.exp(logs)) + floor
        factor = cholesky_banded(bands, lower=True)
        solved = cho_solve_banded((factor, True), residuals)
        return float(0.5 * residuals @ solved + np.log(factor[0]).sum())

    logs = np.log(np.clip(start, SMALLEST, LARGEST))
    bounds = [(np.log(SMALLEST), np.log(LARGEST))] * len(logs)
    options = {"maxiter": 300, "xatol": CLOSE, "fatol": CLOSE}
    best = minimize(cost_of, logs, method="Nelder-Mead", bounds=bounds, options=options)
    return np.exp(best.x if best.fun < cost_of(logs) else logs)


def _linked(follows: NDArray[np.bool_], at: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mask (len(at) - 1,) of segments that begin at the end of the one listed before."""
    return np.asarray((np.diff(at) == 1) & follows[at[1:]])
