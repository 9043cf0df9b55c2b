"""Model selection by cross-validation over blocks of contiguous time.

Each fold leaves some blocks out and estimates the parameters from the rest. It scores the held-out blocks
by the likelihood of their segments, and by the drift of dead reckoning from the tracks alone over windows
of a few segments.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.calibration.fit import Fit, few_blocks
from icreckon.estimator.calibration.noise import log_density
from icreckon.estimator.calibration.result import Difference, ModelComparison, ModelScore
from icreckon.estimator.calibration.segments import Recording

FOLDS = 8
WINDOW = 3
"""Segments of a window, at most."""
JUMPED = 0.15
"""Weight of a truth's turning below which it is an outlier, six standard deviations off."""
DRAWS, SEED = 4000, 1
"""Number of draws of the bootstrap, and the seed of its random numbers."""
LEVELS = (2.5, 97.5)
"""Ends of a 95 % interval [%]."""


class HeldOutSums(NamedTuple):
    """Sums (blocks,) over segments and windows of each block, left out of the fit."""

    likelihood: Floats  # log likelihood of the segments
    error: Floats  # error of the windows by the tracks alone [m]
    error_with_gyro: Floats  # error of the windows with headings from the gyro [m]


def validate(fits: Mapping[str, Fit]) -> ModelComparison:
    """Compare models, in the order of `MODELS`, by predictions of held-out blocks."""
    first = next(iter(fits.values()))
    recording = first.problem.recording
    windows = _windows(recording, recording.moving & ~_jumped(first))
    speeds = np.abs(recording.speeds(0.0).mean(axis=-1))
    segment_distances = first.value("scale") * speeds.sum(axis=1) * recording.cell
    blocks = int(recording.block.max()) + 1
    window_blocks = np.array([recording.block[window[0]] for window in windows])
    window_distances = [segment_distances[window].sum() for window in windows]
    # Distance of the windows in each block, and in all [m].
    block_distances = np.bincount(window_blocks, window_distances, minlength=blocks)
    distance = block_distances.sum()
    sums = {name: _held_out(fit, windows, window_blocks) for name, fit in fits.items()}
    segments = int(recording.moving.sum())
    # Bootstrap: as many blocks as there are, drawn with replacement.
    drawn = np.random.default_rng(SEED).integers(0, blocks, (DRAWS, blocks))
    drawn_distances = np.maximum(block_distances[drawn].sum(axis=1), 1e-9)
    widening = float(few_blocks(blocks))

    def drift_interval(errors: Floats) -> tuple[float, float]:
        """95 % interval [%] of a drift or a difference, by errors (blocks,) [m]."""
        middle = 100.0 * errors.sum() / distance
        ends = np.percentile(100.0 * errors[drawn].sum(axis=1) / drawn_distances, LEVELS)
        low, high = middle + widening * (ends - middle)
        return float(low), float(high)

    scores = []
    for name, held_out in sums.items():
        low, high = drift_interval(held_out.error)
        scores.append(
            ModelScore(
                model=name,
                parameters=int(fits[name].problem.own(fits[name].free).sum()),
                drift_percent=100.0 * float(held_out.error.sum() / distance),
                drift_low=max(low, 0.0),
                drift_high=high,
                drift_with_gyro_percent=100.0 * float(held_out.error_with_gyro.sum() / distance),
                log_likelihood=float(held_out.likelihood.sum() / segments),
            )
        )
    differences = []
    names = list(sums)
    supported = names[0]
    for number, name in enumerate(names):
        is_better = False
        for other in names[:number]:
            errors = sums[name].error - sums[other].error
            low, high = drift_interval(errors)
            is_better = is_better or (other == supported and high < 0.0)
            likelihoods = sums[name].likelihood - sums[other].likelihood
            gain = likelihoods.sum() / segments
            bounds = np.percentile(likelihoods[drawn].sum(axis=1) / segments, LEVELS)
            gain_low, gain_high = (gain + widening * (bounds - gain)).tolist()
            differences.append(
                Difference(
                    model=name,
                    than=other,
                    drift=100.0 * float(errors.sum() / distance),
                    drift_low=low,
                    drift_high=high,
                    log_likelihood=float(gain),
                    log_likelihood_low=gain_low,
                    log_likelihood_high=gain_high,
                )
            )
        # Each later model replaces the one chosen so far if it is significantly better than that.
        supported = name if is_better else supported
    return ModelComparison(
        scores=tuple(scores),
        differences=tuple(differences),
        blocks=blocks,
        folds=min(FOLDS, blocks),
        distance=float(distance),
        window=WINDOW * recording.length,
        supported=supported,
    )


def likeliest(comparison: ModelComparison) -> str:
    """Name of the model with the highest held-out likelihood."""
    return max(comparison.scores, key=lambda score: score.log_likelihood).model


def _jumped(fit: Fit) -> NDArray[np.bool_]:
    """Mask (n,) of segments whose truth jumped: it turned too unlike the gyro.

    The mask does not depend on the motion model.
    """
    result = np.zeros(len(fit.problem.recording.log), dtype=bool)
    for channel, weight in zip(fit.noise.channels, fit.noise.weights, strict=True):
        if channel.name == "yaw":
            result[channel.rows[:, 0]] = weight < JUMPED
    return result


def _windows(recording: Recording, usable: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
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


def _held_out(
    fit: Fit, windows: list[NDArray[np.int64]], window_blocks: NDArray[np.int64]
) -> HeldOutSums:
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


def _window_errors(
    fit: Fit, values: Floats, windows: list[NDArray[np.int64]]
) -> tuple[Floats, Floats]:
    """Distance (w,) of the ends of windows by the model from those by the truth [m].

    The first is with headings from the tracks alone, the second with headings from the gyro.
    """
    problem, recording = fit.problem, fit.problem.recording
    twist, cell = problem.twist(values), recording.cell
    heading, _ = problem.heading(values)
    place = problem.body_places(values)
    alone: list[float] = []
    aided: list[float] = []
    for window in windows:
        v_x, v_y, w = (twist[window, :, axis].ravel() for axis in range(3))
        # Headings in the middle of each cell.
        start = heading[window[0], 0]
        by_tracks = start + cell * (np.cumsum(w) - 0.5 * w)
        turns = np.diff(heading[window], axis=1).ravel()
        by_gyro = start + np.cumsum(turns) - 0.5 * turns
        true_x, true_y = place[recording.ends[window[-1]]] - place[recording.starts[window[0]]]
        for angle, errors in ((by_tracks, alone), (by_gyro, aided)):
            x = cell * (np.cos(angle) * v_x - np.sin(angle) * v_y).sum()
            y = cell * (np.sin(angle) * v_x + np.cos(angle) * v_y).sum()
            errors.append(float(np.hypot(x - true_x, y - true_y)))
    return np.array(alone), np.array(aided)
