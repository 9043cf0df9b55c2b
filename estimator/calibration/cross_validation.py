"""Model selection by cross-validation over blocks of contiguous time.

Each fold leaves some blocks out and estimates the parameters from the rest. It scores the held-out blocks
by the likelihood of their segments, and by the drift of dead reckoning from the tracks alone over windows
of a few segments.
"""

from collections.abc import Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Flags, Floats, Indexes
from icreckon.estimator.calibration.fit import Fit, few_blocks
from icreckon.estimator.calibration.noise import log_density
from icreckon.estimator.calibration.result import Difference, ModelComparison, ModelScore
from icreckon.estimator.calibration.segments import Recording

FOLDS = 8
WINDOW = 3  # segments of a window, at most
JUMPED = 0.15  # weight of a truth's turning below which it is an outlier, six sigmas off
DRAWS, SEED = 4000, 1  # number of draws of the bootstrap, and the seed of its random numbers
LEVELS = (2.5, 97.5)  # ends of a 95 % interval [%]


class HeldOutSums(NamedTuple):
    """Sums (blocks,) over segments and windows of each block, left out of the fit."""

    likelihood: Floats  # log likelihood of the segments
    error: Floats  # error of the windows by the tracks alone [m]
    error_with_gyro: Floats  # error of the windows with headings from the gyro [m]


class _Blocks(NamedTuple):
    """Blocks of the held-out segments, and draws of them for the bootstrap."""

    distances: Floats  # (blocks,) distance of the windows in each block [m]
    segments: int  # number of moving segments in all blocks
    drawn: Indexes  # (DRAWS, blocks) blocks of each draw, with replacement

    def drift(self, errors: Floats) -> tuple[float, float, float]:
        """Drift [%] of errors (blocks,) [m] or of their difference, and its 95 % interval."""
        distance = self.distances.sum()
        drawn_distances = np.maximum(self.distances[self.drawn].sum(axis=1), 1e-9)
        drawn = 100.0 * errors[self.drawn].sum(axis=1) / drawn_distances
        interval = self._interval(100.0 * errors.sum() / distance, drawn)
        return 100.0 * float(errors.sum() / distance), *interval

    def likelihood(self, sums: Floats) -> tuple[float, float, float]:
        """Mean of log likelihoods (blocks,) over the segments, and its 95 % interval."""
        mean = sums.sum() / self.segments
        return float(mean), *self._interval(mean, sums[self.drawn].sum(axis=1) / self.segments)

    def _interval(self, middle: float, drawn: Floats) -> tuple[float, float]:
        """95 % interval by values (DRAWS,) of the draws, wider for few blocks."""
        ends = np.percentile(drawn, LEVELS)
        low, high = middle + float(few_blocks(len(self.distances))) * (ends - middle)
        return float(low), float(high)


def validate(fits: Mapping[str, Fit]) -> ModelComparison:
    """Compare models, in the order of `MODELS`, by predictions of held-out blocks."""
    first = next(iter(fits.values()))
    recording = first.problem.recording
    windows = _windows(recording, recording.moving & ~_jumped(first))
    speeds = np.abs(recording.speeds(0.0).mean(axis=-1))
    segment_distances = first.value("scale") * speeds.sum(axis=1) * recording.cell
    count = int(recording.block.max()) + 1
    window_blocks = np.array([recording.block[window[0]] for window in windows])
    window_distances = [segment_distances[window].sum() for window in windows]
    blocks = _Blocks(
        distances=np.asarray(np.bincount(window_blocks, window_distances, count), dtype=float),
        segments=int(recording.moving.sum()),
        drawn=np.random.default_rng(SEED).integers(0, count, (DRAWS, count)),
    )
    sums = {name: _held_out(fit, windows, window_blocks) for name, fit in fits.items()}
    differences = {}
    for other, name in combinations(sums, 2):
        drift = blocks.drift(sums[name].error - sums[other].error)
        gain = blocks.likelihood(sums[name].likelihood - sums[other].likelihood)
        differences[name, other] = Difference(name, other, *drift, *gain)
    supported, *later = sums
    for name in later:
        # A later model replaces the one chosen so far if it drifts significantly less.
        if differences[name, supported].drift_high < 0.0:
            supported = name
    return ModelComparison(
        scores=tuple(_score(name, fit, sums[name], blocks) for name, fit in fits.items()),
        differences=tuple(differences.values()),
        blocks=count,
        folds=min(FOLDS, count),
        distance=float(blocks.distances.sum()),
        window=WINDOW * recording.length,
        supported=supported,
    )


def _score(name: str, fit: Fit, sums: HeldOutSums, blocks: _Blocks) -> ModelScore:
    """Scores of a model, by its sums over held-out blocks."""
    drift, low, high = blocks.drift(sums.error)
    return ModelScore(
        model=name,
        parameters=int(fit.problem.own(fit.free).sum()),
        drift_percent=drift,
        drift_low=max(low, 0.0),
        drift_high=high,
        drift_with_gyro_percent=blocks.drift(sums.error_with_gyro)[0],
        log_likelihood=blocks.likelihood(sums.likelihood)[0],
    )


def _jumped(fit: Fit) -> Flags:
    """Mask (n,) of segments whose truth turned too unlike the gyro: it jumped."""
    result = np.zeros(len(fit.problem.recording.log), dtype=bool)
    for channel, weight in zip(fit.noise.channels, fit.noise.weights, strict=True):
        if channel.name == "yaw":
            result[channel.rows[:, 0]] = weight < JUMPED
    return result


def _windows(recording: Recording, usable: Flags) -> list[Indexes]:
    """Consecutive runs of up to `WINDOW` usable segments (mask (n,)) within a block."""
    windows: list[list[int]] = []
    for segment in range(len(recording.log)):
        if not usable[segment]:
            continue
        is_next = recording.follows[segment] and bool(windows) and windows[-1][-1] == segment - 1
        is_in_block = recording.block[segment] == recording.block[segment - 1]
        if is_next and is_in_block and len(windows[-1]) < WINDOW:
            windows[-1].append(segment)
        else:
            windows.append([segment])
    return [np.array(window) for window in windows]


def _held_out(fit: Fit, windows: list[Indexes], window_blocks: Indexes) -> HeldOutSums:
    """Sums of a model over each block, with parameters estimated without its fold."""
    problem = fit.problem
    block = problem.recording.block
    blocks = int(block.max()) + 1
    fold = np.arange(blocks) % min(FOLDS, blocks)
    sums = HeldOutSums(np.zeros(blocks), np.zeros(blocks), np.zeros(blocks))
    for fold_number in np.unique(fold):
        held_out = fold == fold_number
        values = fit.without(held_out)
        residuals = problem.rows(values)
        for channel, sigmas in zip(fit.noise.channels, fit.noise.components, strict=True):
            if channel.name not in ("position", "slip"):
                continue
            segments = channel.rows[:, 0]
            counts = held_out[block[segments]] & problem.recording.moving[segments]
            density = log_density(channel.select(residuals), channel.variances(sigmas))
            np.add.at(sums.likelihood, block[segments], np.where(counts, density, 0.0))
        windows_out = np.flatnonzero(held_out[window_blocks])
        alone, aided = _window_errors(fit, values, [windows[number] for number in windows_out])
        np.add.at(sums.error, window_blocks[windows_out], alone)
        np.add.at(sums.error_with_gyro, window_blocks[windows_out], aided)
    return sums


def _window_errors(fit: Fit, values: Floats, windows: list[Indexes]) -> tuple[Floats, Floats]:
    """Errors (w,) of the ends of windows: headings by tracks alone, by the gyro [m]."""
    problem, recording = fit.problem, fit.problem.recording
    twist, cell = problem.twist(values), recording.cell
    heading, _ = problem.heading(values)
    place = problem.body_places(values)
    both_errors = np.zeros((2, len(windows)))  # by tracks alone, with the gyro
    for index, window in enumerate(windows):
        v_x, v_y, w = (twist[window, :, axis].ravel() for axis in range(3))
        # Headings in the middle of each cell.
        start = heading[window[0], 0]
        by_tracks = start + cell * (np.cumsum(w) - 0.5 * w)
        turns = np.diff(heading[window], axis=1).ravel()
        by_gyro = start + np.cumsum(turns) - 0.5 * turns
        true_x, true_y = place[recording.ends[window[-1]]] - place[recording.starts[window[0]]]
        for angle, errors in zip((by_tracks, by_gyro), both_errors, strict=True):
            x = cell * (np.cos(angle) * v_x - np.sin(angle) * v_y).sum()
            y = cell * (np.sin(angle) * v_x + np.cos(angle) * v_y).sum()
            errors[index] = np.hypot(x - true_x, y - true_y)
    return both_errors[0], both_errors[1]
