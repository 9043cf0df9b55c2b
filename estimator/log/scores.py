"""Errors of an estimate against the truth: drift, velocity errors and consistency.

All scores compare at the stamps of the truth, to which the estimate is interpolated. Drift is the error
after estimate and truth are aligned at the start of a segment, so they need not share a frame.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Floats, Indexes, Stamps
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import relative, rotate, wrap_angle
from icreckon.estimator.log.series import PoseSeries, Truth
from icreckon.estimator.log.trajectory import Trajectory

HORIZONS = (10.0, 30.0, 60.0)  # lengths of segments in reports [s], [m]
DISTANCES = (5.0, 10.0, 30.0, 50.0)
# Spacing of segment starts [s], and the least mean speed [m/s] of segments in per-segment figures.
SEGMENT_STEP = 1.0
SLOWEST_MEAN_SPEED = 0.02
VELOCITY_WINDOW = 1.0  # window of mean velocities if the truth has no twists [s]
PATH_STEP = 0.5  # least time between points of a path length, so that noise does not add up [s]
LONGEST_FILLED = 10.0  # longest gap that is filled with evenly spaced times [s]
# Gap in a truth from which on segments across it are left out: this [s], or this many usual intervals.
LEAST_GAP, USUAL_GAPS = 1.0, 2.5
LEAST_EIGENVALUE = 1e-12  # a covariance with a smaller eigenvalue counts as singular

Interval = tuple[int, int]
Unit = Literal["s", "m"]


@dataclass(frozen=True)
class Drift:
    """Drift over segments of one length.

    Attributes:
        horizon: length of the segments [s], or of their true path [m].
        unit: unit of that length, "s" or "m".
        starts: (n,) stamps of their starts [ns].
        durations: (n,) their durations [s].
        position_errors: (n,) distance of the end points after alignment at the start [m].
        yaw_errors: (n,) [rad], signed.
        distances: (n,) length of the true path [m].
    """

    horizon: float
    unit: Unit
    starts: Stamps
    durations: Floats
    position_errors: Floats
    yaw_errors: Floats
    distances: Floats

    @property
    def moved(self) -> Flags:
        """Mask (n,) of segments with enough motion for a meaningful ratio."""
        return self.distances > SLOWEST_MEAN_SPEED * self.horizon

    @property
    def percent_mean(self) -> float:
        """Mean error over mean distance [%]; NaN without a segment with motion."""
        return float(100.0 * mean_ratio(self.position_errors, self.distances, self.horizon))

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
        return float(np.degrees(mean_ratio(np.abs(self.yaw_errors), self.distances, self.horizon)))


def mean_ratio(errors: Floats, distances: Floats, horizon: float) -> Floats:
    """Mean error over mean distance of segments with motion; NaN without any.

    Errors are (n, ...), distances (n, ...) [m], of segments of a length `horizon` [s, m].
    """
    moved = distances > SLOWEST_MEAN_SPEED * horizon
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sum(errors, 0, where=moved) / np.sum(distances, 0, where=moved))


def interpolate(known: Stamps, values: Floats, stamps: Stamps) -> Floats:
    """Values (n, k) at `stamps`, linear between values (m, k) at `known` stamps [ns]."""
    wanted, seconds = (stamps - known[0]) * NANOSECOND, (known - known[0]) * NANOSECOND
    return np.stack([np.interp(wanted, seconds, column) for column in values.T], axis=-1)


def interpolate_poses(series: PoseSeries, stamps: Stamps) -> Floats:
    """Poses (n, 3) at the given stamps: linear in position and in unwrapped yaw."""
    x, y, yaw = series.poses.T
    return interpolate(series.stamps, np.stack([x, y, np.unwrap(yaw)], axis=-1), stamps)


def path_length(series: PoseSeries) -> Floats:
    """Distance (n,) since the first pose [m].

    Unless known, it is along points at least `PATH_STEP` apart.
    """
    if series.travelled is not None:
        return np.asarray(series.travelled - series.travelled[0])
    seconds = (series.stamps - series.stamps[0]) * NANOSECOND
    knots = np.append(even_grid(0.0, seconds[-1], PATH_STEP, seconds), seconds[-1])
    x, y = (np.interp(knots, seconds, series.poses[:, axis]) for axis in (0, 1))
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    return np.asarray(np.interp(seconds, knots, lengths))


def drift(
    estimate: PoseSeries,
    truth: PoseSeries,
    horizon: float,
    *,
    unit: Unit = "s",
    within: list[Interval] | None = None,
    largest_gap: float | None = None,
) -> Drift:
    """Drift over all segments of a given length, which begin `SEGMENT_STEP` apart.

    A segment ends at the first pose of the truth at that time, or at that distance along its path.

    Args:
        estimate: estimated poses, in any frame.
        truth: true poses.
        horizon: length of the segments [s, m].
        unit: "s" for segments of a duration, "m" for those of a distance.
        within: intervals of stamps [ns] that must contain a segment; None for everywhere.
        largest_gap: segments across a longer gap in the truth are left out [s]; None for one second, or
            more where the truth is slower, see `USUAL_GAPS`.

    Raises:
        EstimatorError: the horizon is not positive.
    """
    if not horizon > 0.0:
        raise EstimatorError(f"horizon must be a positive number of {unit}, found {horizon!r}")
    shared = truth.rows(is_shared(estimate, truth))
    stamps = shared.stamps
    if len(stamps) < 2:
        return Drift(horizon, unit, stamps[:0], *(np.zeros(0) for _ in range(4)))
    if largest_gap is None:
        usual = float(np.median(np.diff(truth.stamps))) * NANOSECOND
        largest_gap = max(LEAST_GAP, min(USUAL_GAPS * usual, LONGEST_FILLED))
    true_poses = interpolate_poses(truth, stamps)
    travelled = path_length(shared)
    first = segment_starts(stamps)
    if unit == "m":
        last = np.searchsorted(travelled, travelled[first] + horizon)
    else:
        last = np.searchsorted(stamps, stamps[first] + int(horizon / NANOSECOND))
    first, last = usable_segments(stamps, first, last, within=within, largest_gap=largest_gap)
    durations = np.asarray((stamps[last] - stamps[first]) * NANOSECOND, dtype=float)
    errors = segment_errors(interpolate_poses(estimate, stamps), true_poses, first, last)
    distances = travelled[last] - travelled[first]
    return Drift(horizon, unit, stamps[first], durations, *errors, distances)


def is_shared(estimate: PoseSeries | Trajectory, truth: PoseSeries) -> NDArray[np.bool_]:
    """Mask (n,) of the truth's poses within the time of the estimate."""
    inside = (truth.stamps >= estimate.stamps[0]) & (truth.stamps <= estimate.stamps[-1])
    return np.asarray(inside)


def shared_stamps(estimate: PoseSeries | Trajectory, truth: PoseSeries) -> Stamps:
    """Stamps (n,) of the truth within those of the estimate [ns]."""
    return np.asarray(truth.stamps[is_shared(estimate, truth)])


def segment_starts(stamps: Stamps) -> Indexes:
    """Indices (n,) of stamps (m,) [ns] at which segments start; one after each gap."""
    begins = even_grid(stamps[0], stamps[-1], int(SEGMENT_STEP / NANOSECOND), stamps)
    return np.asarray(np.unique(np.searchsorted(stamps, begins)))


def usable_segments(
    stamps: Stamps,
    first: Indexes,
    last: Indexes,
    *,
    within: list[Interval] | None,
    largest_gap: float,
) -> tuple[Indexes, Indexes]:
    """Starts and ends (k,) of complete segments within an interval, without a gap.

    `first` and `last` (n,) are indices of stamps (m,) [ns], m or more for no end. One of the intervals
    [ns] must contain a segment, None for everywhere; gaps are longer than `largest_gap` [s].
    """
    ends_inside = last < len(stamps)
    first, last = first[ends_inside], last[ends_inside]
    piece = pieces(stamps, largest_gap)
    keep = piece[first] == piece[last]
    if within is not None:
        inside = [(stamps[first] >= low) & (stamps[last] <= high) for low, high in within]
        keep &= np.any(inside, axis=0)
    return first[keep], last[keep]


def segment_errors(
    estimated: Floats, true: Floats, first: Indexes, last: Indexes
) -> tuple[Floats, Floats]:
    """Position [m] and signed yaw errors [rad] of segments aligned at their starts.

    Poses are (m, ..., 3); `first` and `last` (n,) are indices of segment starts and ends.
    """
    apart = relative(estimated[first], estimated[last]) - relative(true[first], true[last])
    return np.hypot(apart[..., 0], apart[..., 1]), np.asarray(wrap_angle(apart[..., 2]))


def pieces(stamps: Stamps, largest_gap: float) -> Indexes:
    """Index (n,) of the piece of each stamp [ns], between gaps over `largest_gap` [s]."""
    return np.concatenate([[0], np.cumsum(np.diff(stamps) * NANOSECOND > largest_gap)])


def are_within(piece: Indexes, times: NDArray[Any], begins: Any, ends: Any) -> Flags:
    """Mask (k,) of intervals within one piece; times and their `pieces` are (n,)."""
    first = np.clip(np.searchsorted(times, begins, side="right") - 1, 0, None)
    last = np.minimum(np.searchsorted(times, ends), len(piece) - 1)
    return np.asarray(piece[first] == piece[last])


def even_grid(low: float, high: float, step: float, known: NDArray[Any]) -> NDArray[Any]:
    """Evenly spaced times (m,) from `low` to below `high`, but not amid gaps.

    Of a gap of more than `LONGEST_FILLED` in the `known` times only the times next to its ends are kept,
    so that a clock that jumps does not fill the memory. Times and step are stamps [ns] or floats [s].
    """
    unit = NANOSECOND if np.issubdtype(known.dtype, np.integer) else 1.0
    gaps = np.flatnonzero(np.diff(known) > LONGEST_FILLED / unit)
    if not len(gaps) or high <= low:
        return np.arange(low, max(low, high), step, dtype=known.dtype)
    begins = np.clip(np.append(known[:1], known[gaps + 1]), low, high)
    ends = np.clip(np.append(known[gaps], known[-1:]), low, high)
    begins[0], ends[-1] = low, high
    firsts, lasts = ((begins - low) // step).tolist(), ((ends - low) // step).tolist()
    steps = [np.arange(first, last + 2) for first, last in zip(firsts, lasts, strict=True)]
    times = low + step * np.unique(np.concatenate(steps))
    return np.asarray(times[times < high], dtype=known.dtype)


def velocity_errors(estimate: Trajectory, truth: Truth) -> Floats:
    """Errors (n, 3) of v_x, v_y [m/s] and w [rad/s] in the axes of base_link.

    Rows are at the stamps of the truth's twists; without twists see `_mean_velocity_errors`.
    """
    if truth.twists is None:
        return _mean_velocity_errors(estimate, truth.poses)
    stamps, twists = truth.twists.stamps, truth.twists.twists
    inside = (stamps >= estimate.stamps[0]) & (stamps <= estimate.stamps[-1])
    estimated = interpolate(estimate.stamps, estimate.twists, stamps[inside])
    return np.asarray(estimated - twists[inside])


def _mean_velocity_errors(estimate: Trajectory, truth: PoseSeries) -> Floats:
    """Errors (n, 3) of mean velocities over windows, in the axes of their starts.

    The estimate's is from its integrated twists, so that jumps at fixes do not count as velocity.
    """
    window_ns = int(VELOCITY_WINDOW / NANOSECOND)
    low = max(truth.stamps[0], estimate.stamps[0])
    high = min(truth.stamps[-1], estimate.stamps[-1])
    starts = even_grid(low, high - window_ns, window_ns // 2, truth.stamps)
    # Skip windows that touch a gap of the truth longer than half a window.
    piece = pieces(truth.stamps, 0.5 * VELOCITY_WINDOW)
    starts = starts[are_within(piece, truth.stamps, starts, starts + window_ns)]
    estimated, true = (
        relative(interpolate_poses(poses, starts), interpolate_poses(poses, starts + window_ns))
        for poses in (_reckoned(estimate), truth)
    )
    errors = estimated - true
    errors[:, 2] = wrap_angle(errors[:, 2])
    return np.asarray(errors / VELOCITY_WINDOW)


def _reckoned(estimate: Trajectory) -> PoseSeries:
    """Integrate the estimated twists from the origin: no jumps at fixes."""
    dt = np.diff(estimate.stamps)[:, None] * NANOSECOND
    steps = 0.5 * (estimate.twists[1:] + estimate.twists[:-1]) * dt
    poses = np.zeros((len(estimate.stamps), 3))
    poses[1:, 2] = np.cumsum(steps[:, 2])
    middle_yaw = poses[:-1, 2] + 0.5 * steps[:, 2]
    poses[1:, :2] = np.cumsum(rotate(steps[:, :2], middle_yaw), axis=0)
    return PoseSeries(estimate.stamps, poses)


def nees(errors: Floats, covariances: Floats) -> Floats:
    """Normalised estimation error squared (...) of three errors; NaN if singular.

    Chi-square with three degrees of freedom if the filter is consistent (Bar-Shalom, Li, Kirubarajan,
    Estimation with Applications, section 5.4).

    Args:
        errors: (..., 3).
        covariances: (..., 3, 3); one with an eigenvalue below `LEAST_EIGENVALUE` is singular.
    """
    shifted = covariances - LEAST_EIGENVALUE * np.eye(3)
    with np.errstate(all="ignore"):
        # Sylvester: a matrix is positive definite if its leading minors are positive.
        minors = shifted[..., 0, 0], np.linalg.det(shifted[..., :2, :2]), np.linalg.det(shifted)
    is_regular = np.all([minor > 0.0 for minor in minors], axis=0)
    solvable = np.where(is_regular[..., None, None], covariances, np.eye(3))
    values = (errors * np.linalg.solve(solvable, errors[..., None])[..., 0]).sum(axis=-1)
    return np.where(is_regular, values, np.nan)


def pose_nees(
    estimate: Trajectory,
    truth: PoseSeries,
    *,
    within: list[Interval] | None = None,
    position_only: bool = False,
) -> Floats:
    """NEES (n,) of the pose at the truth's stamps, see `nees`.

    Estimate and truth must share their frame. Stamps with a singular covariance, and those outside of
    `within`, are left out. With `position_only` it is that of x and y: its mean is 2, not 3, if the
    filter is consistent.
    """
    stamps = shared_stamps(estimate, truth)
    if within is not None:
        inside = [(stamps >= low) & (stamps <= high) for low, high in within]
        stamps = stamps[np.any(inside, axis=0)] if inside else stamps[:0]
    errors = interpolate_poses(estimate.pose_series, stamps) - interpolate_poses(truth, stamps)
    errors[:, 2] = wrap_angle(errors[:, 2])
    covariances = estimate.pose_covariances[np.searchsorted(estimate.stamps, stamps)]
    if position_only:
        # An independent yaw error of zero adds nothing to the NEES.
        errors[:, 2], covariances[:, 2], covariances[:, :, 2] = 0.0, 0.0, 0.0
        covariances[:, 2, 2] = 1.0
    values = nees(errors, covariances)
    return values[np.isfinite(values)]


def without_fixes(fix_stamps: Stamps, start: int, end: int, shortest: float) -> list[Interval]:
    """Intervals without fixes between two stamps [ns], of at least `shortest` [s]."""
    edges = np.concatenate([[start], np.clip(fix_stamps, start, end), [end]])
    long_gaps = np.flatnonzero(np.diff(edges) >= int(shortest / NANOSECOND))
    return [(int(edges[i]), int(edges[i + 1])) for i in long_gaps]
