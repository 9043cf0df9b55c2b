"""Errors of an estimate against the truth: drift, velocity errors and consistency.

All scores compare at the stamps of the truth, to which the estimate is interpolated. Drift is the error
after estimate and truth are aligned at the start of a segment, so they need not share a frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import relative, wrap_angle
from icreckon.estimator.log.series import PoseSeries, Truth
from icreckon.estimator.log.trajectory import Trajectory

HORIZONS = (10.0, 30.0, 60.0)
# Spacing of segment starts [s], and the least mean speed [m/s] of segments in per-segment figures.
SEGMENT_STEP = 1.0
SLOWEST_MEAN_SPEED = 0.02
# Window of mean velocities if the truth has no twists [s].
VELOCITY_WINDOW = 1.0
# Least time between points of a path length, so that noise does not add up [s].
PATH_STEP = 0.5

Interval = tuple[int, int]
Places = NDArray[np.int64]


@dataclass(frozen=True)
class Drift:
    """Drift over segments of one horizon.

    Attributes:
        horizon: length of the segments [s].
        starts: (n,) stamps of their starts [ns].
        position_errors: (n,) distance of the end points after alignment at the start [m].
        yaw_errors: (n,) [rad], signed.
        distances: (n,) length of the true path [m].
    """

    horizon: float
    starts: Stamps
    position_errors: Floats
    yaw_errors: Floats
    distances: Floats

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Mask (n,) of segments with enough motion for a meaningful ratio."""
        return self.distances > SLOWEST_MEAN_SPEED * self.horizon

    @property
    def percent_mean(self) -> float:
        """Mean error over mean distance [%]; NaN without a segment with motion."""
        moved = self.moved
        if not moved.any():
            return float("nan")
        return float(100.0 * self.position_errors[moved].sum() / self.distances[moved].sum())

    @property
    def percent_median(self) -> float:
        """Median over segments of error over distance [%]; NaN without any with motion."""
        moved = self.moved
        if not moved.any():
            return float("nan")
        return float(np.median(100.0 * self.position_errors[moved] / self.distances[moved]))

    @property
    def yaw_deg_per_m(self) -> float:
        """Mean yaw error over mean distance [deg/m]; NaN without a segment with motion."""
        moved = self.moved
        if not moved.any():
            return float("nan")
        errors = np.degrees(np.abs(self.yaw_errors[moved]))
        return float(errors.sum() / self.distances[moved].sum())


def interpolate_poses(series: PoseSeries, stamps: Stamps) -> Floats:
    """Poses (n, 3) at the given stamps: linear in position and in unwrapped yaw."""
    at = (stamps - series.stamps[0]) * NANOSECOND
    known = (series.stamps - series.stamps[0]) * NANOSECOND
    yaw = np.unwrap(series.poses[:, 2])
    columns = (series.poses[:, 0], series.poses[:, 1], yaw)
    return np.stack([np.interp(at, known, column) for column in columns], axis=-1)


def path_length(series: PoseSeries) -> Floats:
    """Distance (n,) since the first pose [m], along points at least `PATH_STEP` apart."""
    seconds = (series.stamps - series.stamps[0]) * NANOSECOND
    knots = np.append(np.arange(0.0, seconds[-1], PATH_STEP), seconds[-1])
    x, y = (np.interp(knots, seconds, series.poses[:, axis]) for axis in (0, 1))
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    return np.asarray(np.interp(seconds, knots, lengths))


def drift(
    estimate: PoseSeries,
    truth: PoseSeries,
    horizon: float,
    *,
    within: list[Interval] | None = None,
    largest_gap: float = 1.0,
) -> Drift:
    """Drift over all segments of a given length.

    Args:
        estimate: estimated poses, in any frame.
        truth: true poses.
        horizon: length of the segments [s].
        within: intervals of stamps [ns] that must contain a segment; None for everywhere.
        largest_gap: segments across a longer gap in the truth are left out [s].
    """
    span = int(horizon / NANOSECOND)
    found = segments(
        estimate,
        truth,
        lambda stamps, _, first: np.searchsorted(stamps, stamps[first] + span),
        within=within,
        largest_gap=largest_gap,
    )
    return Drift(horizon, found.starts, found.position_errors, found.yaw_errors, found.distances)


class Segments(NamedTuple):
    """Segments of a log, aligned at their starts.

    Attributes:
        starts: (n,) stamps of their starts [ns].
        ends: (n,) stamps of their ends [ns].
        position_errors: (n,) distance of the end points [m].
        yaw_errors: (n,) [rad], signed.
        distances: (n,) length of the true path [m].
    """

    starts: Stamps
    ends: Stamps
    position_errors: Floats
    yaw_errors: Floats
    distances: Floats


def segments(
    estimate: PoseSeries,
    truth: PoseSeries,
    ends_of: Callable[[Stamps, Floats, Places], Places],
    *,
    within: list[Interval] | None,
    largest_gap: float,
) -> Segments:
    """Errors over all segments, which begin `SEGMENT_STEP` apart.

    Args:
        estimate: estimated poses, in any frame.
        truth: true poses.
        ends_of: function from the stamps of the truth (m,) [ns], its distance so far (m,) [m] and the
            indices (n,) of segment starts to those of segment ends; m or more for no end.
        within: intervals of stamps [ns] that must contain a segment; None for everywhere.
        largest_gap: segments across a longer gap in the truth are left out [s].
    """
    stamps = truth.stamps[
        (truth.stamps >= estimate.stamps[0]) & (truth.stamps <= estimate.stamps[-1])
    ]
    if len(stamps) < 2:
        return Segments(stamps[:0], stamps[:0], *(np.zeros(0) for _ in range(3)))
    true_poses = interpolate_poses(truth, stamps)
    travelled = path_length(PoseSeries(stamps, true_poses))
    begins = np.arange(stamps[0], stamps[-1], int(SEGMENT_STEP / NANOSECOND))
    # All starts within a gap of the truth give one segment, the one after the gap.
    first = np.unique(np.searchsorted(stamps, begins))
    last = ends_of(stamps, travelled, first)
    ends_inside = last < len(stamps)
    first, last = first[ends_inside], last[ends_inside]
    piece = pieces(stamps, largest_gap)
    keep = piece[first] == piece[last]
    if within is not None:
        keep &= np.any(
            [(stamps[first] >= low) & (stamps[last] <= high) for low, high in within], axis=0
        )
    first, last = first[keep], last[keep]
    estimated = interpolate_poses(estimate, stamps)
    true_step = relative(true_poses[first], true_poses[last])
    estimated_step = relative(estimated[first], estimated[last])
    return Segments(
        stamps[first],
        stamps[last],
        np.hypot(*(estimated_step - true_step)[:, :2].T),
        np.asarray(wrap_angle(estimated_step[:, 2] - true_step[:, 2])),
        travelled[last] - travelled[first],
    )


def pieces(stamps: Stamps, largest_gap: float) -> Places:
    """Index (n,) of the piece of each stamp [ns], between gaps over `largest_gap` [s]."""
    return np.concatenate([[0], np.cumsum(np.diff(stamps) * NANOSECOND > largest_gap)])


def velocity_errors(estimate: Trajectory, truth: Truth) -> Floats:
    """Errors (n, 3) of v_x, v_y [m/s] and w [rad/s] in the axes of base_link.

    If the truth has no twists, both velocities are means over windows of `VELOCITY_WINDOW`, from poses:
    the displacement in the axes of the window's start over its length. For the estimate it is that of
    its integrated twists, so that jumps at fixes do not count as velocity.
    """
    if truth.twists is not None:
        stamps, twists = truth.twists.stamps, truth.twists.twists
        inside = (stamps >= estimate.stamps[0]) & (stamps <= estimate.stamps[-1])
        at = (stamps[inside] - estimate.stamps[0]) * NANOSECOND
        known = (estimate.stamps - estimate.stamps[0]) * NANOSECOND
        columns = [np.interp(at, known, estimate.twists[:, axis]) for axis in range(3)]
        return np.asarray(np.stack(columns, axis=-1) - twists[inside])
    window = int(VELOCITY_WINDOW / NANOSECOND)
    low = max(truth.poses.stamps[0], estimate.stamps[0])
    high = min(truth.poses.stamps[-1], estimate.stamps[-1])
    starts = np.arange(low, high - window, window // 2)
    # Skip windows in which the truth is missing for half of the time.
    holes = pieces(truth.poses.stamps, 0.5 * VELOCITY_WINDOW)
    first = np.searchsorted(truth.poses.stamps, starts, side="right") - 1
    last = np.searchsorted(truth.poses.stamps, starts + window)
    starts = starts[holes[first] == holes[np.minimum(last, len(holes) - 1)]]
    ends = starts + window
    steps = [
        relative(interpolate_poses(poses, starts), interpolate_poses(poses, ends))
        for poses in (_reckoned(estimate), truth.poses)
    ]
    errors = steps[0] - steps[1]
    errors[:, 2] = wrap_angle(errors[:, 2])
    return np.asarray(errors / VELOCITY_WINDOW)


def _reckoned(estimate: Trajectory) -> PoseSeries:
    """Integrate the estimated twists: the path without the jumps at fixes."""
    dt = np.diff(estimate.stamps)[:, None] * NANOSECOND
    steps = 0.5 * (estimate.twists[1:] + estimate.twists[:-1]) * dt
    poses = np.zeros((len(estimate.stamps), 3))
    poses[1:, 2] = np.cumsum(steps[:, 2])
    middle = poses[:-1, 2] + 0.5 * steps[:, 2]
    cos, sin = np.cos(middle), np.sin(middle)
    poses[1:, 0] = np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])
    poses[1:, 1] = np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])
    return PoseSeries(estimate.stamps, poses)


def pose_nees(
    estimate: Trajectory, truth: PoseSeries, *, within: list[Interval] | None = None
) -> Floats:
    """Normalised estimation error squared (n,) of the pose at the truth's stamps.

    Chi-square with three degrees of freedom if the filter is consistent (Bar-Shalom, Li, Kirubarajan,
    Estimation with Applications, section 5.4). Estimate and truth must share their frame. Stamps with a
    singular covariance, and those outside of `within`, are left out.
    """
    stamps = truth.stamps[
        (truth.stamps >= estimate.stamps[0]) & (truth.stamps <= estimate.stamps[-1])
    ]
    if within is not None:
        inside = [(stamps >= low) & (stamps <= high) for low, high in within]
        stamps = stamps[np.any(inside, axis=0)] if inside else stamps[:0]
    errors = interpolate_poses(estimate.pose_series, stamps) - interpolate_poses(truth, stamps)
    errors[:, 2] = wrap_angle(errors[:, 2])
    following = np.searchsorted(estimate.stamps, stamps)
    covariances = estimate.pose_covariances[following]
    regular = np.linalg.eigvalsh(covariances)[:, 0] > 1e-12
    solved = np.linalg.solve(covariances[regular], errors[regular][..., None])[..., 0]
    return np.asarray(np.einsum("ij,ij->i", errors[regular], solved))


def without_fixes(fix_stamps: Stamps, start: int, end: int, shortest: float) -> list[Interval]:
    """Intervals of stamps [ns] without fixes, at least `shortest` s long.

    They lie between `start` and `end` [ns].
    """
    edges = np.concatenate([[start], np.clip(fix_stamps, start, end), [end]])
    long = np.flatnonzero(np.diff(edges) >= int(shortest / NANOSECOND))
    return [(int(edges[i]), int(edges[i + 1])) for i in long]
