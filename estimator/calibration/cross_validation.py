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
    ways = first.value("scale") * speeds.sum(axis=1) * recording.cell
    block = recording.block
    blocks = int(block.max()) + 1
    of_window = np.array([block[one[0]] for one in windows])
    way = np.bincount(of_window, [ways[one].sum() for one in windows], minlength=blocks)
    found = {name: _held_out(fit, windows, of_window) for name, fit in fits.items()}
    segments = int(recording.moving.sum())
    rng = np.random.default_rng(SEED)
    drawn = rng.integers(0, blocks, (DRAWS, blocks))
    distance = np.maximum(way[drawn].sum(axis=1), 1e-9)
    wider = float(few_blocks(blocks))

    def interval(sums: Floats) -> tuple[float, float]:
        middle = 100.0 * sums.sum() / way.sum()
        ends = np.percentile(100.0 * sums[drawn].sum(axis=1) / distance, LEVELS)
        low, high = middle + wider * (ends - middle)
        return float(low), float(high)

    scores = []
    for name, (likelihood, error, with_gyro) in found.items():
        low, high = interval(error)
        scores.append(
            ModelScore(
                name,
                int(fits[name].problem.own(fits[name].free).sum()),
                100.0 * float(error.sum() / way.sum()),
                max(low, 0.0),
                high,
                100.0 * float(with_gyro.sum() / way.sum()),
                float(likelihood.sum() / segments),
            )
        )
    differences = []
    names = list(found)
    supported = names[0]
    for at, name in enumerate(names):
        better = False
        for other in names[:at]:
            likelier, apart, _ = (a - b for a, b in zip(found[name], found[other], strict=True))
            low, high = interval(apart)
            better = better or (other == supported and high < 0.0)
            likelier_by = likelier.sum() / segments
            bounds = np.percentile(likelier[drawn].sum(axis=1) / segments, LEVELS)
            bounds = likelier_by + wider * (bounds - likelier_by)
            differences.append(
                Difference(
                    name,
                    other,
                    100.0 * float(apart.sum() / way.sum()),
                    low,
                    high,
                    float(likelier_by),
                    float(bounds[0]),
                    float(bounds[1]),
                )
            )
        # Each later model replaces the one chosen so far if it is significantly better than that.
        supported = name if better else supported
    return ModelComparison(
        tuple(scores),
        tuple(differences),
        blocks,
        min(FOLDS, blocks),
        float(way.sum()),
        WINDOW * recording.length,
        supported,
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
    for place in range(len(recording.log)):
        if not usable[place]:
            continue
        last = windows[-1] if windows else []
        goes_on = (
            bool(last)
            and last[-1] == place - 1
            and recording.follows[place]
            and recording.block[place] == recording.block[place - 1]
            and len(last) < WINDOW
        )
        if goes_on:
            last.append(place)
        else:
            windows.append([place])
    return [np.array(one) for one in windows]


def _held_out(
    fit: Fit, windows: list[NDArray[np.int64]], of_window: NDArray[np.int64]
) -> tuple[Floats, Floats, Floats]:
    """Sums (blocks,) of likelihood, error and error with gyro, each block held out."""
    problem = fit.problem
    block = problem.recording.block
    blocks = int(block.max()) + 1
    fold = np.arange(blocks) % min(FOLDS, blocks)
    likelihood, error, with_gyro = np.zeros(blocks), np.zeros(blocks), np.zeros(blocks)
    for number in np.unique(fold):
        out = fold == number
        values = fit.without(out)
        residuals = problem.rows(values)
        for channel, sizes in zip(fit.noise.channels, fit.noise.components, strict=True):
            if channel.name not in ("position", "slip"):
                continue
            at = channel.rows[:, 0]
            log_likelihood = log_density(channel.of(residuals), channel.variances(sizes))
            log_likelihood = np.where(
                out[block[at]] & problem.recording.moving[at], log_likelihood, 0.0
            )
            np.add.at(likelihood, block[at], log_likelihood)
        wanted = [one for one, its in zip(windows, of_window, strict=True) if out[its]]
        alone, aided = _window_errors(fit, values, wanted)
        at = of_window[out[of_window]]
        np.add.at(error, at, alone)
        np.add.at(with_gyro, at, aided)
    return likelihood, error, with_gyro


def _window_errors(
    fit: Fit, values: Floats, windows: list[NDArray[np.int64]]
) -> tuple[Floats, Floats]:
    """Distance (w,) of the ends of windows by the model from those by the truth [m].

    Returns it with headings from the tracks, and with those of the gyro.
    """
    problem, recording = fit.problem, fit.problem.recording
    twist, cell = problem.twist(values), recording.cell
    heading, _ = problem.heading(values)
    place = problem.body_places(values)
    alone: list[float] = []
    aided: list[float] = []
    for window in windows:
        v_x, v_y, w = (twist[window, :, axis].ravel() for axis in range(3))
        start = heading[window[0], 0]
        turned = start + cell * (np.cumsum(w) - 0.5 * w)
        gyro = np.diff(heading[window], axis=1)
        by_gyro = start + np.cumsum(gyro.ravel()) - 0.5 * gyro.ravel()
        true = place[recording.ends[window[-1]]] - place[recording.starts[window[0]]]
        for angle, errors in ((turned, alone), (by_gyro, aided)):
            went = cell * np.array(
                [
                    (np.cos(angle) * v_x - np.sin(angle) * v_y).sum(),
                    (np.sin(angle) * v_x + np.cos(angle) * v_y).sum(),
                ]
            )
            errors.append(float(np.hypot(*(went - true))))
    return np.array(alone), np.array(aided)
