"""Alignment of a logged truth: estimation and removal of lag and lever arm.

A pose from lidar or GPS is stamped late, and it is that of a sensor rather than of `base_link`. Both
would count as drift. They are estimated from relative motion over short windows, in which dead
reckoning is accurate, and reported. A truth of positions alone has no headings to align by: they are
found from the path, and its lag from the changes of speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import relative, rotate
from icreckon.estimator.base.lag_search import BEYOND, BLOCKS, beside_lowest, jackknife_sigma
from icreckon.estimator.log.path_heading import PathHeadings, headings_by_path
from icreckon.estimator.log.scores import even_grid, interpolate_poses, pieces
from icreckon.estimator.log.series import PoseSeries, Truth
from icreckon.estimator.log.trajectory import Trajectory

LAGS = np.arange(-0.3, 1.0, 0.01)
GRID_STEP = 0.1
LAG_WINDOW = 1.0
LEVER_WINDOW = 2.0
# Windows across a longer gap in the truth are omitted [s].
LARGEST_HOLE = 0.5
# Rounds of headings and lever arm of a truth without headings.
ROUNDS = 3
# Standard deviation of the initial pose from a logged truth [m, rad].
LOGGED_START_SIGMA = (0.02, 0.01)
# Share of the windows kept for the lever arm: those with the smallest residuals.
TRIMMED_SHARE = 0.8
# Least turning within windows at which a lever arm is observable, root mean square [rad].
LEAST_TURNING = 0.1
# Least turning at which a lag may be observable, root mean square [rad]; its standard error decides.
LEAST_TURNING_FOR_LAG = 0.02
# Least change of speed at which a lag of positions may be observable, root mean square [m/s].
LEAST_SPEEDING = 0.05
# Lags with a smaller standard error [s] are removed even if they are within it.
CERTAIN = 0.04


@dataclass(frozen=True)
class TruthAlignment:
    """Lag and lever arm removed from a truth.

    Attributes:
        lag: latency of its stamps [s]; 0 if not observable.
        lever_arm: position of the tracked point in base_link: x forward, y left [m].
        truth: the corrected truth of `base_link`.
        lag_sigma: standard error of the lag [s], or None if the log shows none.
        headings: headings that were found from the path, None if the truth has its own.
    """

    lag: float
    lever_arm: tuple[float, float]
    truth: Truth
    lag_sigma: float | None = None
    headings: PathHeadings | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on missing headings, and on a lag that is not observable."""
        found = []
        if self.headings is not None:
            found.append(
                "the truth has no headings: scored are positions (drift, error at the end, NEES of the "
                "position). They are aligned by headings from the path of tracks and gyro, "
                f"± {math.degrees(self.headings.sigma):.1f}°"
            )
        if not self.lag:
            error = "" if self.lag_sigma is None else f" (standard error {self.lag_sigma:.2f} s)"
            what = "too little turning" if self.headings is None else "too even a speed"
            found.append(
                f"whether the truth is late cannot be seen: {what}{error}; it is taken as it is stamped"
            )
        return tuple(found)

    @property
    def start_sigma(self) -> tuple[float, float, float]:
        """Standard deviations of the truth's pose at the start of a run [m, m, rad]."""
        place, turn = LOGGED_START_SIGMA
        if self.headings is not None:
            place = max(place, self.headings.noise)
            turn = math.hypot(turn, self.headings.start_sigma)
        return place, place, turn


def align_truth(truth: Truth, reckoned: Trajectory) -> TruthAlignment:
    """Estimate and remove lag and lever arm of a truth.

    Args:
        truth: poses of some point of the robot, late by an unknown lag.
        reckoned: dead reckoning over the same time.

    Returns:
        The alignment; zero lag or lever arm if not observable (log too short, no turning). A truth
        without headings stays without them if the robot moves too little to see any.
    """
    lag, sigma = _lag(truth, reckoned.pose_series)
    shifted = PoseSeries(truth.poses.stamps - round(lag / NANOSECOND), truth.poses.poses)
    aligned = align_place(replace(truth, poses=shifted), reckoned)
    return replace(aligned, lag=lag, lag_sigma=sigma)


def align_place(truth: Truth, reckoned: Trajectory) -> TruthAlignment:
    """Estimate and remove only the lever arm of a truth without lag.

    A filter's base_link is its mean turning centre, which depends on its model and parameters. The same
    truth therefore has another lever arm for each filter.

    Args:
        truth: poses of some point of the robot.
        reckoned: trajectory of a filter over the same time.
    """
    lever, headings, known = np.zeros(2), None, truth.poses
    # The point's path is not that of base_link: its headings are found again without the lever arm.
    for _ in range(1 if truth.headings else ROUNDS):
        if not truth.headings:
            headings = headings_by_path(known, reckoned.pose_series)
            if headings is None:
                return TruthAlignment(0.0, (0.0, 0.0), truth)
            known = headings.poses
        more = _lever_arm(known, reckoned.pose_series)
        poses = known.poses.copy()
        poses[:, :2] -= rotate(more, poses[:, 2])
        lever, known = lever + more, PoseSeries(known.stamps, poses)
    moved = replace(truth, poses=known)
    return TruthAlignment(0.0, (float(lever[0]), float(lever[1])), moved, headings=headings)


def _windows(
    truth: PoseSeries, reckoned: PoseSeries, window: float, margin: float
) -> tuple[Stamps, Stamps]:
    """Starts and ends [ns] of windows on an even grid that both series cover."""
    low = max(truth.stamps[0], reckoned.stamps[0]) + int(margin / NANOSECOND)
    high = min(truth.stamps[-1], reckoned.stamps[-1]) - int((margin + window) / NANOSECOND)
    starts = even_grid(low, high, int(GRID_STEP / NANOSECOND), truth.stamps)
    ends = starts + int(window / NANOSECOND)
    holes = pieces(truth.stamps, LARGEST_HOLE)
    first = np.searchsorted(truth.stamps, starts, side="right") - 1
    last = np.minimum(np.searchsorted(truth.stamps, ends), len(holes) - 1)
    whole = holes[first] == holes[last]
    return starts[whole], ends[whole]


def _lag(truth: Truth, reckoned: PoseSeries) -> tuple[float, float | None]:
    """Lag [s] with the smallest misfit of yaw changes, and its standard error.

    Of a truth without headings it is the misfit of distances. If the lag is neither beyond its error nor
    certain, it is not observable, and zero.
    """
    starts, ends = _windows(truth.poses, reckoned, LAG_WINDOW, margin=float(LAGS[-1]))
    if len(starts) < 10:
        return 0.0, None

    def moved(series: PoseSeries, shift: float) -> Floats:
        offset = round(shift / NANOSECOND)
        step = interpolate_poses(series, ends - offset) - interpolate_poses(series, starts - offset)
        return np.asarray(step[:, 2] if truth.headings else np.hypot(step[:, 0], step[:, 1]))

    true = moved(truth.poses, 0.0)
    if truth.headings and np.sqrt(np.mean(true**2)) < LEAST_TURNING_FOR_LAG:
        return 0.0, None
    if not truth.headings and np.std(true) < LEAST_SPEEDING * LAG_WINDOW:
        return 0.0, None
    squares = np.array([(true - moved(reckoned, float(lag))) ** 2 for lag in LAGS])
    lag = _lowest(squares.mean(axis=1))
    blocks = np.array_split(np.arange(len(starts)), BLOCKS)
    sigma = jackknife_sigma(
        np.array([_lowest(np.delete(squares, block, axis=1).mean(axis=1)) for block in blocks])
    )
    return (lag if sigma <= CERTAIN or abs(lag) > BEYOND * sigma else 0.0), sigma


def _lowest(costs: Floats) -> float:
    """Lag [s] of the lowest of the costs at `LAGS`, refined by a parabola."""
    best = int(np.clip(np.argmin(costs), 1, len(LAGS) - 2))
    beside = np.clip(beside_lowest(costs, best), -1.0, 1.0)
    return float(LAGS[best] + beside * (LAGS[1] - LAGS[0]))


def _lever_arm(truth: PoseSeries, reckoned: PoseSeries) -> Floats:
    """Lever arm (2,) [m] by trimmed least squares.

    Relative to its start, a point at l in base_link moves by the motion of base_link plus (R - I) l,
    with R the rotation within the window.
    """
    starts, ends = _windows(truth, reckoned, LEVER_WINDOW, margin=0.0)
    if len(starts) < 10:
        return np.zeros(2)
    steps = [
        relative(interpolate_poses(series, starts), interpolate_poses(series, ends))
        for series in (truth, reckoned)
    ]
    angle = steps[0][:, 2]
    if np.sqrt(np.mean(angle**2)) < LEAST_TURNING:
        return np.zeros(2)
    cos, sin = np.cos(angle) - 1.0, np.sin(angle)
    design = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], axis=1)
    extra = (steps[0] - steps[1])[:, :2]
    keep = np.ones(len(extra), dtype=bool)
    lever = np.zeros(2)
    for _ in range(3):
        lever = np.linalg.lstsq(design[keep].reshape(-1, 2), extra[keep].ravel(), rcond=None)[0]
        misfit = np.hypot(*(extra - design @ lever).T)
        keep = misfit <= np.quantile(misfit, TRIMMED_SHARE)
    return np.asarray(lever)
