"""Model selection by cross-validation over blocks of contiguous time.

Each fold leaves some blocks out and estimates the parameters from the rest. It scores the held-out blocks
by the likelihood of their segments, and by the drift of dead reckoning from the tracks alone over windows
of a few segments.
"""

from collections.abc import Mapping

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
DRAWS = 4000
SEED = 1
LEVELS = (2.5, 97.5)


def validate(fits: Mapping[str, Fit]) -> ModelComparison:
    """Compare models by their predictions of held-out blocks.

    Args:
        fits: by name, in the order of `MODELS`; the same segments in all.
    """
    first = next(iter(fits.values()))
    recording = first.problem.recording
    windows = _windows(recording, recording.moving & ~_jumped(first))
    speeds = np.abs(recording.speeds(0.0).mean(axis=-1))
    segment_ways = first.value("scale") * speeds.sum(axis=1) * recording.cell
    blocks = int(recording.block.max()) + 1
    window_blocks = np.array([recording.block[window[0]] for window in windows])
    window_ways = [segment_ways[window].sum() for window in windows]
    # Distance in each block, and in all windows [m].
    ways = np.bincount(window_blocks, window_ways, minlength=blocks)
    distance = ways.sum()
    sums = {name: _held_out(fit, windows, window_blocks) for name, fit in fits.items()}
    segments = int(recording.moving.sum())
    # Bootstrap: as many blocks as there are, drawn with replacement.
    drawn = np.random.default_rng(SEED).integers(0, blocks, (DRAWS, blocks))
    drawn_distances = np.maximum(ways[drawn].sum(axis=1), 1e-9)
    widening = float(few_blocks(blocks))

    def drift_interval(errors: Floats) -> tuple[float, float]:
        middle = 100.0 * errors.sum() / distance
        ends = np.percentile(100.0 * errors[drawn].sum(axis=1) / drawn_distances, LEVELS)
        low, high = middle + widening * (ends - middle)
        return float(low), float(high)

    scores = []
    for name, (likelihood, errors, errors_with_gyro) in sums.items():
        low, high = drift_interval(errors)
        scores.append(
            ModelScore(
                model=name,
                parameters=int(fits[name].problem.own(fits[name].free).sum()),
                drift_percent=100.0 * float(errors.sum() / distance),
                drift_low=max(low, 0.0),
                drift_high=high,
                drift_with_gyro_percent=100.0 * float(errors_with_gyro.sum() / distance),
                log_likelihood=float(likelihood.sum() / segments),
            )
        )
    differences = []
    names = list(sums)
    supported = names[0]
    for number, name in enumerate(names):
        better = False
        for other in names[:number]:
            likelier, errors, _ = (a - b for a, b in zip(sums[name], sums[other], strict=True))
            low, high = drift_interval(errors)
            better = better or (other == supported and high < 0.0)
            likelier_by = likelier.sum() / segments
            bounds = np.percentile(likelier[drawn].sum(axis=1) / segments, LEVELS)
            bounds = likelier_by + widening * (bounds - likelier_by)
            differences.append(
                Difference(
                    model=name,
                    than=other,
                    drift=100.0 * float(errors.sum() / distance),
                    drift_low=low,
                    drift_high=high,
                    log_likelihood=float(likelier_by),
                    log_likelihood_low=float(bounds[0]),
                    log_likelihood_high=float(bounds[1]),
                )
            )
        # Each later model replaces the one chosen so far if it is significantly better than that.
        supported = name if better else supported
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
    return max(comparison.scores, key=lambda one: one.log_likelihood).model


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
    """Consecutive runs of up to `WINDOW` usable segments within a block."""
    windows: list[list[int]] = []
    for segment in range(len(recording.log)):
        if not usable[segment]:
            continue
        last = windows[-1] if windows else []
        goes_on = (
            bool(last)
            and last[-1] == segment - 1
            and recording.follows[segment]
            and recording.block[segment] == recording.block[segment - 1]
            and len(last) < WINDOW
        )
        if goes_on:
            last.append(segment)
        else:
            windows.append([segment])
    return [np.array(window) for window in windows]


def _held_out(
    fit: Fit, windows: list[NDArray[np.int64]], window_blocks: NDArray[np.int64]
) -> tuple[Floats, Floats, Floats]:
    """Sums (blocks,) of likelihood, error and error with gyro, each block held out."""
    problem = fit.problem
    block = problem.recording.block
    blocks = int(block.max()) + 1
    fold = np.arange(blocks) % min(FOLDS, blocks)
    likelihood, error, with_gyro = np.zeros(blocks), np.zeros(blocks), np.zeros(blocks)
    for number in np.unique(fold):
        held_out = fold == number
        values = fit.without(held_out)
        residuals = problem.rows(values)
        for channel, sizes in zip(fit.noise.channels, fit.noise.components, strict=True):
            if channel.name not in ("position", "slip"):
                continue
            segments = channel.rows[:, 0]
            counts = held_out[block[segments]] & problem.recording.moving[segments]
            density = log_density(channel.of(residuals), channel.variances(sizes))
            np.add.at(likelihood, block[segments], np.where(counts, density, 0.0))
        blocks_out = window_blocks[held_out[window_blocks]]
        windows_out = [windows[k] for k in np.flatnonzero(held_out[window_blocks])]
        alone, aided = _window_errors(fit, values, windows_out)
        np.add.at(error, blocks_out, alone)
        np.add.at(with_gyro, blocks_out, aided)
    return likelihood, error, with_gyro


def _window_errors(
    fit: Fit, values: Floats, windows: list[NDArray[np.int64]]
) -> tuple[Floats, Floats]:
    """Distance (w,) of the ends of windows by the model from those by the truth [m].

    Returns that with headings from the tracks alone, and that with headings aided by the gyro.
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
        true = place[recording.ends[window[-1]]] - place[recording.starts[window[0]]]
        for angle, errors in ((by_tracks, alone), (by_gyro, aided)):
            went = cell * np.array(
                [
                    (np.cos(angle) * v_x - np.sin(angle) * v_y).sum(),
                    (np.sin(angle) * v_x + np.cos(angle) * v_y).sum(),
                ]
            )
            errors.append(float(np.hypot(*(went - true))))
    return np.array(alone), np.array(aided)
