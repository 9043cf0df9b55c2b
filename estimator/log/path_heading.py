"""Headings of a truth: check them, or find them from its path.

A position has no heading. But over some metres the path by tracks and gyro has the right shape: the
heading is its yaw, plus the turn that aligns it with the positions around a stamp.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Floats, Stamps
from icreckon.estimator.log.scores import interpolate, interpolate_poses, path_length
from icreckon.estimator.log.series import PoseSeries, Truth, running_integral

STEP = 0.5  # distance between the places whose course is compared with the heading [m]
FEWEST_STEPS = 10  # least number of such steps for a check
LEAST_AGREEMENT = 0.4
"""Least length of the mean vector of course less heading: 1 if they always agree, 0 for chance [-]."""
SLOW = 0.05  # speed below which a true twist has no direction [m/s]
TURNED = 0.5  # turning by the true twists at which headings must differ [rad]
TURN_STEP = 2.0  # time over which turning by headings and by the gyro is compared [s]
LEAST_TURNING = 2.0  # least turning by the gyro for that comparison [rad]
MOST_APART = 0.1  # largest sum of squared differences, over the squares of the gyro's turning [-]
SAME = 1e-9  # headings that differ by less are the same [rad]
REACH = 5.0  # distance along the path, to each side, over which it is aligned [m]
ALIKE = 1.0  # distance along the path over which errors of the positions are correlated [m]
LEAST_EXTENT = 1.0  # least RMS extent of an aligned part of the path whose turn is used [m]
LARGEST_SIGMA = 0.3  # largest standard error of a turn that is used [rad]


class PathHeadings(NamedTuple):
    """Headings from a path."""

    poses: PoseSeries  # positions with headings, and the distance along the path
    sigma: float  # median of the headings' standard errors [rad]
    start_sigma: float  # standard error of the first heading [rad]
    noise: float  # RMS distance of the positions from the path over a few metres, per axis [m]
    scale: float  # length of the positions over that of the path [-]


def heading_fault(truth: Truth, gyro: tuple[Stamps, Floats] | None = None) -> str | None:
    """Check the headings of a truth by the course of its path, and by a gyro.

    A robot that turns on the spot has a short path whose course shows little: headings that turn as the
    gyro does, with stamps [ns] and yaw rates (n,) [rad/s], are valid, too.

    Returns:
        The reason not to use them; None if they follow the path or the gyro, or the path is too short.
    """
    poses = truth.poses
    ends = _steps(poses.poses[:, :2])
    if len(ends) < 3:
        return None
    yaw = np.unwrap(poses.poses[:, 2])
    steps = np.diff(poses.poses[ends, :2], axis=0)
    distance = float(np.hypot(*steps.T).sum())
    if np.ptp(yaw) < SAME and _may_turn(truth):
        return f"are all the same although it moves by {distance:.0f} m"
    if len(steps) < FEWEST_STEPS:
        return None
    middle = poses.stamps[(ends[1:] + ends[:-1]) // 2]
    course = np.arctan2(steps[:, 1], steps[:, 0])
    difference = course - interpolate(poses.stamps, yaw[:, None], middle)[:, 0]
    # Without twists the robot may drive backwards: twice the difference makes half a turn a full one.
    multiple = 2.0
    if truth.twists is not None:
        v_x, v_y, _ = interpolate(truth.twists.stamps, truth.twists.twists, middle).T
        if (np.hypot(v_x, v_y) > SLOW).all():
            difference, multiple = difference - np.arctan2(v_y, v_x), 1.0
    if abs(np.mean(np.exp(1j * multiple * difference))) >= LEAST_AGREEMENT:
        return None
    if gyro is not None and _turns_like(poses, *gyro):
        return None
    return f"do not follow its path of {distance:.0f} m"


def _turns_like(poses: PoseSeries, stamps: Stamps, rates: Floats) -> bool:
    """Return True if headings turn like the yaw rates (n,) [rad/s] of a gyro."""
    first, last = max(stamps[0], poses.stamps[0]), min(stamps[-1], poses.stamps[-1])
    ends = np.arange(first, last, round(TURN_STEP / NANOSECOND))
    if len(ends) <= FEWEST_STEPS:
        return False
    angles = (stamps, running_integral(stamps, rates)), (poses.stamps, np.unwrap(poses.poses[:, 2]))
    at_ends = [interpolate(known, angle[:, None], ends)[:, 0] for known, angle in angles]
    by_gyro, by_truth = np.diff(at_ends, axis=1)  # turning in each step [rad]
    difference = by_truth - by_gyro
    turns = np.abs(by_gyro).sum() >= LEAST_TURNING
    return bool(turns and difference @ difference < MOST_APART * float(by_gyro @ by_gyro))


def _may_turn(truth: Truth) -> bool:
    """Return False if the true twists show that the robot has kept its heading."""
    if truth.twists is None:
        return True
    steps = np.diff(truth.twists.stamps) * NANOSECOND
    return bool(np.ptp(np.cumsum(steps * truth.twists.twists[1:, 2])) > TURNED)


def _steps(places: Floats) -> Floats:
    """Indices of places (n, 2) that are at least `STEP` from the chosen one before."""
    chosen, last = [0], places[0]
    for index, place in enumerate(places):
        if np.hypot(*(place - last)) >= STEP:
            chosen.append(index)
            last = place
    return np.array(chosen)


def headings_by_path(places: PoseSeries, path: PoseSeries) -> PathHeadings | None:
    """Find the headings of positions by a path of the same robot, in any frame.

    Around each position the path is turned so that it fits the positions best (least squares). Where the
    robot has hardly moved, the turn is interpolated from its neighbours. Headings are limited to the time
    of the path; None if the robot moves too little for any.
    """
    inside = (places.stamps >= path.stamps[0]) & (places.stamps <= path.stamps[-1])
    stamps = places.stamps[inside]
    if len(stamps) < FEWEST_STEPS:
        return None
    x, y, yaw = interpolate_poses(path, stamps).T
    z = places.poses[inside, 0] + 1j * places.poses[inside, 1]
    turn, scale, sigma, variance, is_good = _turns(z, x + 1j * y)
    if not is_good.any():
        return None
    # Distances are of the scaled path: noise of the positions would lengthen theirs.
    path_travelled = interpolate(path.stamps, path_length(path)[:, None], stamps)[:, 0]
    length_ratio = float(np.median(scale[is_good]))
    known, everywhere = np.flatnonzero(is_good), np.arange(len(stamps))
    turns = np.interp(everywhere, known, np.unwrap(turn[is_good]))
    sigmas = np.interp(everywhere, known, sigma[is_good])
    columns = np.column_stack([places.poses[inside, :2], yaw + turns])
    poses = PoseSeries(stamps, columns, travelled=length_ratio * path_travelled)
    noise = float(np.sqrt(np.median(variance[is_good])))
    return PathHeadings(poses, float(np.median(sigmas)), float(sigmas[0]), noise, length_ratio)


def _turns(z: NDArray[Any], r: NDArray[Any]) -> tuple[Floats, Floats, Floats, Floats, Flags]:
    """Turns (n,) that align the path around each position with the positions there.

    Positions z (n,) and places r (n,) of the path at their stamps are complex numbers [m]. Also returns
    the scale of the path that fits best, the turns' standard errors [rad], the variance of the positions
    about the turned path, per axis [m²], and a mask of the turns that can be used.
    """
    distance = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(r)))])
    first = np.searchsorted(distance, distance - REACH)
    last = np.searchsorted(distance, distance + REACH, side="right")

    def total(values: NDArray[Any]) -> NDArray[Any]:
        """Sums over the part of the path around each position."""
        sums = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(sums[last] - sums[first])

    # About the mean place, so that sums of squares of large coordinates do not cancel.
    count, r, z = last - first, r - r.mean(), z - z.mean()
    mean_r, mean_z = total(r) / count, total(z) / count
    cross = total(np.conj(r) * z) - count * np.conj(mean_r) * mean_z
    square_r = np.maximum(total(np.abs(r) ** 2) - count * np.abs(mean_r) ** 2, 0.0)
    square_z = np.maximum(total(np.abs(z) ** 2) - count * np.abs(mean_z) ** 2, 0.0)
    # The angle of the sum of cross products is the turn of least squares.
    misfit = np.maximum(square_r + square_z - 2.0 * np.abs(cross), 0.0)
    variance = misfit / np.maximum(2 * count - 3, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Errors are correlated over some distance: by a lever arm, slip, multipath.
        span = distance[np.minimum(last, len(distance)) - 1] - distance[first]
        scale = np.abs(cross) / square_r
        sigma = np.sqrt(variance * count / square_r / np.maximum(span / ALIKE, 2.0))
        is_good = (square_r / count >= LEAST_EXTENT**2) & (sigma <= LARGEST_SIGMA) & (count > 2)
    return np.angle(cross), scale, sigma, variance, is_good
