"""Lever arm of a tracked point in base_link, by a path of base_link."""

from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import relative, rotate
from icreckon.estimator.log.path_heading import PathHeadings, headings_by_path
from icreckon.estimator.log.scores import are_within, even_grid, interpolate_poses, pieces
from icreckon.estimator.log.series import PoseSeries

GRID_STEP, WINDOW = 0.1, 2.0  # distance of the starts of windows, and their length [s]
LARGEST_HOLE = 0.5  # windows across a longer gap in the places are omitted [s]
ROUNDS = 3  # rounds of headings and lever arm, and of trimming
FEWEST_WINDOWS = 10  # least number of windows for a lever arm
TRIMMED_SHARE = 0.8  # share of the windows kept for the lever arm, by their residuals [-]
LEAST_TURNING = 0.1  # least RMS turn in a window at which a lever arm is observable [rad]


def at_lever_arm(poses: PoseSeries, lever: Floats) -> PoseSeries:
    """Poses of the point at a lever arm (2,), forward and left [m]."""
    moved = poses.poses.copy()
    moved[:, :2] += rotate(lever, moved[:, 2])
    return replace(poses, poses=moved)


def headings_and_lever_arm(
    places: PoseSeries, path: PoseSeries
) -> tuple[PathHeadings, Floats, PoseSeries] | None:
    """Find headings and lever arm (2,) [m] of places without headings, by a path.

    The place of a point differs from base_link's in turns: headings are found again after the lever arm
    is subtracted. Returns the poses of base_link, too; None if headings are not observable.
    """
    lever = np.zeros(2)
    headings: PathHeadings
    for _ in range(ROUNDS):
        found = headings_by_path(places, path)
        if found is None:
            return None
        headings, correction = found, lever_arm(found.poses, path)
        lever = lever + correction
        places = at_lever_arm(headings.poses, -correction)
    return headings, lever, places


def _windows(places: PoseSeries, path: PoseSeries) -> tuple[Stamps, Stamps]:
    """Starts and ends [ns] of windows in both series without a gap in the places."""
    low = max(places.stamps[0], path.stamps[0])
    high = min(places.stamps[-1], path.stamps[-1]) - int(WINDOW / NANOSECOND)
    starts = even_grid(low, high, int(GRID_STEP / NANOSECOND), places.stamps)
    ends = starts + int(WINDOW / NANOSECOND)
    unbroken = are_within(pieces(places.stamps, LARGEST_HOLE), places.stamps, starts, ends)
    return starts[unbroken], ends[unbroken]


def lever_arm(places: PoseSeries, path: PoseSeries) -> Floats:
    """Lever arm (2,) [m] by trimmed least squares.

    Relative to its start, a point at l in base_link moves by the motion of base_link plus (R - I) l,
    with R the rotation within the window. Zero with few windows or little turning.
    """
    starts, ends = _windows(places, path)
    if len(starts) < FEWEST_WINDOWS:
        return np.zeros(2)
    place_steps, path_steps = (
        relative(interpolate_poses(series, starts), interpolate_poses(series, ends))
        for series in (places, path)
    )
    angle = place_steps[:, 2]
    if np.sqrt(np.mean(angle**2)) < LEAST_TURNING:
        return np.zeros(2)
    cos_less_one, sin = np.cos(angle) - 1.0, np.sin(angle)
    # Matrices R - I (n, 2, 2) of the windows.
    rows = np.stack([cos_less_one, -sin], -1), np.stack([sin, cos_less_one], -1)
    design = np.stack(rows, axis=1)
    differences = (place_steps - path_steps)[:, :2]
    keep, lever = np.ones(len(differences), dtype=bool), np.zeros(2)
    for _ in range(ROUNDS):
        kept = design[keep].reshape(-1, 2), differences[keep].ravel()
        lever = np.linalg.lstsq(*kept, rcond=None)[0]
        residual = np.hypot(*(differences - design @ lever).T)
        keep = residual <= np.quantile(residual, TRIMMED_SHARE)
    return np.asarray(lever)
