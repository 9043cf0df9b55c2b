"""Noise of the residuals: variance components, and weights against outliers.

Errors of the truth at each knot are shared by two neighbouring segments: their errors have a correlation
of -1/2. The model error grows with the difference of the tracks and with the distance. Residuals are
Student-t: each row has the weight (nu + 1) / (nu + u²) of its standardised residual u (Lange, Little and
Taylor, Robust statistical modeling using the t distribution, JASA 84, 1989).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import lgamma

import numpy as np

from icreckon.estimator.base.array_types import Flags, Floats, Indexes
from icreckon.estimator.calibration.residuals import ACROSS, ALONG, BINS, FORCE, SLIP, YAW, Problem

FREEDOM = 5.0  # degrees of freedom of Student's t
TOLERANCE = 0.02  # tolerances of the logarithms of components, and of the log likelihood
SMALLEST, LARGEST = 1e-5, 10.0  # bounds of the components, in the units of their rows


@dataclass(frozen=True)
class Channel:
    """Rows with a common covariance: a sum of matrices times squared components."""

    name: str  # "position", "slip", "yaw", "forward force" or "left force"
    rows: Indexes  # (r, 2) segment and row of each
    bands: Floats  # (c, b, r) matrix of each component, lower bands as in scipy.linalg

    def covariance(self, components: Floats) -> Floats:
        """Covariance as lower bands (b, r)."""
        return np.asarray(np.tensordot(components**2, self.bands, 1))

    def variances(self, components: Floats) -> Floats:
        """Variances (r,), the diagonal of the covariance."""
        return np.asarray(np.tensordot(components**2, self.bands[:, 0], 1))

    def select(self, values: Floats) -> Floats:
        """Rows (r, ...) of the channel from values (n, ROWS, ...)."""
        return values[self.rows[:, 0], self.rows[:, 1]]


@dataclass(frozen=True)
class Noise:
    """Noise model: channels, their components, and the weight of each row."""

    channels: tuple[Channel, ...]  # the channels
    components: tuple[Floats, ...]  # (c,) standard deviations of each channel
    weights: tuple[Floats, ...]  # (r,) weights of the rows of each channel, against outliers


def channels_of(problem: Problem, heading: Floats) -> tuple[Channel, ...]:
    """Channels of a problem, by the middle heading (n,) of each segment [rad].

    Bands are the diagonal and those below it: band b of row r is the covariance with row r + b.
    """
    recording = problem.recording
    speeds = recording.speeds(0.0)
    turning = np.abs(speeds[..., 1] - speeds[..., 0]).sum(axis=1) * recording.cell
    driving = np.abs(speeds.mean(axis=-1)).sum(axis=1) * recording.cell
    counted = problem.counted_rows()
    along, slip, yaw, force = (np.flatnonzero(counted[:, row]) for row in (ALONG, SLIP, YAW, FORCE))
    channels = [_position_channel(recording.follows, along, heading, turning, driving)]
    moves, bands = recording.moving[slip], np.ones((3, 1, len(slip)))
    bands[1, 0] = np.where(moves, turning[slip] ** 2, 0.0)
    bands[2, 0] = np.where(moves, driving[slip] ** 2, 0.0)
    channels.append(Channel("slip", _rows(slip, [SLIP]), bands))
    if len(yaw):
        bands = np.zeros((2, 2, len(yaw)))
        bands[0, 0], bands[1, 0] = 2.0, 1.0
        bands[0, 1, : len(yaw) - 1] = -1.0 * _linked(recording.follows, yaw)
        channels.append(Channel("yaw", _rows(yaw, [YAW]), bands))
    if len(force):
        bands = np.zeros((3, BINS, BINS * len(force)))
        bands[0, 0] = 1.0
        bands[1, 0] = np.repeat(turning[force] ** 2, BINS)
        # The third component is common to all parts of a segment: slopes.
        part = np.arange(BINS * len(force)) % BINS
        bands[2] = part + np.arange(BINS)[:, None] < BINS
        for first, name in ((FORCE, "forward force"), (FORCE + BINS, "left force")):
            channels.append(Channel(name, _rows(force, range(first, first + BINS)), bands))
    return tuple(channels)


def _position_channel(
    follows: Flags, segments: Indexes, heading: Floats, turning: Floats, driving: Floats
) -> Channel:
    """Channel of the rows along and across of each segment (s,), which alternate.

    Components: the truth's noise, the model's along by `turning`, by `driving` (n,) [m], and across.
    """
    bands = np.zeros((5, 4, 2 * len(segments)))
    of_truth, along_by_turning, along_by_driving, across_by_turning, across_by_driving = bands
    of_truth[0] = 2.0
    linked, turn = _linked(follows, segments), np.diff(heading[segments])
    cos, sin = np.where(linked, np.cos(turn), 0.0), np.where(linked, np.sin(turn), 0.0)
    # Neighbours share a knot: the covariance of (along, across) with the next ones is -R(turn).
    along = 2 * np.arange(len(segments) - 1)
    across = along + 1
    of_truth[2, along], of_truth[3, along] = -cos, sin
    of_truth[1, across], of_truth[2, across] = -sin, -cos
    along_by_turning[0, 0::2] = across_by_turning[0, 1::2] = turning[segments] ** 2
    along_by_driving[0, 0::2] = across_by_driving[0, 1::2] = driving[segments] ** 2
    return Channel("position", _rows(segments, [ALONG, ACROSS]), bands)


def _rows(segments: Indexes, rows: Sequence[int]) -> Indexes:
    """Pairs (r, 2) of each segment and each of some rows."""
    return np.stack([np.repeat(segments, len(rows)), np.tile(rows, len(segments))], axis=-1)


def first_noise(channels: tuple[Channel, ...], residuals: Floats) -> Noise:
    """Initial noise, whose components explain equal shares of the residuals (n, ROWS)."""
    components = []
    for channel in channels:
        mean_diagonals = channel.bands[:, 0].mean(axis=1)
        # The median size of normal errors is 0.67 sigma. SMALLEST avoids 0 / 0 where a diagonal is zero.
        typical = np.median(np.abs(channel.select(residuals))) / 0.67 + SMALLEST
        share = typical / np.sqrt(len(mean_diagonals) * mean_diagonals)
        components.append(np.clip(share, SMALLEST, LARGEST))
    weights = tuple(np.ones(len(channel.rows)) for channel in channels)
    return Noise(channels, tuple(components), weights)


def refined(noise: Noise, residuals: Floats, *, components_too: bool = True) -> Noise:
    """Refit the noise to residuals (n, ROWS): weights, and components if wanted."""
    components, weights = [], []
    for channel, sigma in zip(noise.channels, noise.components, strict=True):
        selected = channel.select(residuals)
        weight = t_weights(selected, channel.variances(sigma))
        if components_too:
            sigma = _most_likely(channel, sigma, selected * np.sqrt(weight))
            weight = t_weights(selected, channel.variances(sigma))
        components.append(sigma)
        weights.append(weight)
    return Noise(noise.channels, tuple(components), tuple(weights))


def t_weights(residuals: Floats, variances: Floats) -> Floats:
    """Weights (r,) of residuals (r,) with these variances under Student's t."""
    return (FREEDOM + 1.0) / (FREEDOM + residuals**2 / variances)


def log_density(residuals: Floats, variances: Floats) -> Floats:
    """Log density (r,) under Student's t, whose squared scales are the variances."""
    constant = lgamma(0.5 * (FREEDOM + 1)) - lgamma(0.5 * FREEDOM)
    constant -= 0.5 * np.log(FREEDOM * np.pi)
    squared = residuals**2 / variances
    tail = 0.5 * (FREEDOM + 1) * np.log1p(squared / FREEDOM)
    return np.asarray(constant - 0.5 * np.log(variances) - tail)


def information(
    noise: Noise, residuals: Floats, jacobian: Floats, block: Indexes
) -> tuple[Floats, Floats]:
    """Information (blocks, p, p) and score (blocks, p), so that both add up.

    The residuals (n, ROWS) have derivatives (n, ROWS, p); `block` (n,) is the block of each segment.
    Correlated rows of two blocks count half to either.
    """
    blocks, size = int(block.max()) + 1, jacobian.shape[-1]
    fisher, score = np.zeros((blocks, size, size)), np.zeros((blocks, size))
    for channel, sigma, weight in zip(noise.channels, noise.components, noise.weights, strict=True):
        root = np.sqrt(weight)
        slopes = channel.select(jacobian) * root[:, None]
        columns = np.column_stack([channel.select(residuals) * root, slopes])
        solved, _ = _solve_banded(channel.covariance(sigma), columns)
        row_blocks = block[channel.rows[:, 0]]
        for number in np.unique(row_blocks):
            in_block = row_blocks == number
            product = slopes[in_block].T @ solved[in_block, 1:]
            # The halves of a correlation between two blocks make the product asymmetric.
            fisher[number] += 0.5 * (product + product.T)
            score[number] += slopes[in_block].T @ solved[in_block, 0]
    return fisher, score


def _solve_banded(bands: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """Solve a banded covariance for columns (r, ...); also its Cholesky factor."""
    # By LAPACK: checks and wrappers of scipy's functions take longer than they do.
    from scipy.linalg.lapack import dpbsv

    factor, solved, failed = dpbsv(bands, columns, lower=True)
    if failed or not np.isfinite(solved).all():
        raise np.linalg.LinAlgError("a covariance of residuals is not positive definite")
    return solved, factor


def flattening(noise: Noise, residuals: Floats) -> float:
    """Correction factor of the information of weighted squares, 0.3 to 1.

    The factor is the mean slope of the influence function over the mean weight (Huber, Robust
    Statistics), the least of all channels.
    """
    least = 1.0
    for channel, sigma in zip(noise.channels, noise.components, strict=True):
        squared = channel.select(residuals) ** 2 / channel.variances(sigma)
        weight = (FREEDOM + 1.0) / (FREEDOM + squared)
        slope = weight - 2.0 * (FREEDOM + 1.0) * squared / (FREEDOM + squared) ** 2
        least = min(least, float(slope.mean() / weight.mean()))
    return max(least, 0.3)


def cost(noise: Noise, residuals: Floats) -> float:
    """Twice the negative log likelihood of residuals (n, ROWS) at fixed weights."""
    total = 0.0
    for channel, sigma, weight in zip(noise.channels, noise.components, noise.weights, strict=True):
        weighted = channel.select(residuals) * np.sqrt(weight)
        solved, _ = _solve_banded(channel.covariance(sigma), weighted)
        total += float(weighted @ solved)
    return total


def _most_likely(channel: Channel, start: Floats, residuals: Floats) -> Floats:
    """Maximum-likelihood components of Gaussian residuals (r,), from an initial value."""
    from scipy.optimize import minimize

    floor = np.zeros_like(channel.bands[0])
    floor[0] = SMALLEST**2

    def neg_log_likelihood(logs: Floats) -> float:
        solved, factor = _solve_banded(channel.covariance(np.exp(logs)) + floor, residuals)
        return float(0.5 * residuals @ solved + np.log(factor[0]).sum())

    logs = np.log(np.clip(start, SMALLEST, LARGEST))
    bounds = [(np.log(SMALLEST), np.log(LARGEST))] * len(logs)
    options = {"maxiter": 300, "xatol": TOLERANCE, "fatol": TOLERANCE}
    best = minimize(neg_log_likelihood, logs, method="Nelder-Mead", bounds=bounds, options=options)
    return np.exp(best.x if best.fun < neg_log_likelihood(logs) else logs)


def _linked(follows: Flags, segments: Indexes) -> Flags:
    """Mask (s - 1,) of segments (s,) that begin at the end of the one listed before."""
    return np.asarray((np.diff(segments) == 1) & follows[segments[1:]])
