"""Decimated time series of a comparison, for plots."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import rotate, wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate, interpolate_poses, path_length
from icreckon.estimator.log.series import Truth
from icreckon.estimator.motion.icr import Icrs, PaperTwist, icrs_from_twist, indices_from_icrs
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.streaming.outputs import Run
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.drift_table import Results
from icreckon.replay.comparison.holes import largest_sigma
from icreckon.replay.comparison.scores import truths_of

# Rows of the series: one each `SERIES_STEP` [s], within these limits. With all nine
# variants, 1500 rows make a page of 2.6 MB, 4000 rows one of 5.7 MB.
SERIES_POINTS, MOST_SERIES_POINTS, SERIES_STEP = 1500, 4000, 0.25
PARAMETER_POINTS = 300
INNOVATION_POINTS = 700
ELLIPSES = 30
# Least yaw rate at which indices are computed from a twist [rad/s].
LEAST_YAW_RATE = 0.1
# Longest interval between poses of the truth that is bridged, or twice the usual one if longer [s].
LONGEST_BRIDGE = 1.0
# Decimals of positions [m], which may be far from their origin, and of values as large.
DECIMALS = 4
POSE, SPATIAL = ("x_m", "y_m", "yaw_rad"), ("z_m", "roll_rad", "pitch_rad")
SPATIAL_SIGMA = ("z_sigma_m", "roll_sigma_rad", "pitch_sigma_rad")
TWIST, INDICES = ("v_x_m_s", "v_y_m_s", "w_rad_s"), ("zeta_m", "epsilon_m", "eta")


def series_of(comparison: Comparison, robot: Robot, headline: str) -> Results:
    """Decimate the time series; parameters and innovations have their own times.

    Paths of all runs are those of the point that the variant `headline` calls base_link, errors those
    against the truth by each run's own lever arm.
    """
    log = comparison.log
    first = next(iter(comparison.runs.values()))
    most = series_points((log.end - log.start) * NANOSECOND)
    stamps = first.stamps[picks(len(first.stamps), most)]
    truths = {} if log.truth is None else truths_of(comparison)
    shown = truths[headline] if truths else None
    truth = None if shown is None else shown.truth.poses
    series: Results = {"t_s": _rounded((stamps - log.start) * NANOSECOND), "variants": {}}
    series["inputs"] = _inputs(log, robot, stamps)
    if log.truth is not None and truth is not None and shown is not None:
        series["truth"] = _columns(POSE, true_poses_at(shown.truth, stamps), DECIMALS)
        if truth.spatial is not None:
            spatial = interpolate(truth.stamps, truth.spatial, stamps)
            series["truth"] |= _columns(SPATIAL, spatial)
        if log.truth.twists is not None:
            twists = log.truth.twists
            series["truth"] |= _columns(TWIST, _nearest(twists.stamps, twists.twists, stamps))
        series["truth"] |= _true_indices(log.truth, stamps)
    driven = first.trajectory.pose_series if truth is None else truth
    travelled = np.interp(stamps, driven.stamps, path_length(driven))
    series["distance_m"] = _rounded(travelled, DECIMALS)
    if log.fixes is not None:
        rows = picks(len(log.fixes.stamps), most)
        times = (log.fixes.stamps[rows] - log.start) * NANOSECOND
        places = _columns(POSE[:2], log.fixes.poses[rows, :2], DECIMALS)
        series["fixes"] = {"t_s": _rounded(times), **places}
    for name, one in comparison.runs.items():
        rows = np.minimum(np.searchsorted(one.stamps, stamps), len(one.stamps) - 1)
        poses, covariances = one.trajectory.poses[rows], one.trajectory.pose_covariances[rows]
        away = np.zeros(2)
        if shown is not None:
            away = np.subtract(truths[name].lever_arm, shown.lever_arm)
        columns = {
            **_columns(POSE, _at_point(poses, away), DECIMALS),
            **_columns(TWIST, one.trajectory.twists[rows]),
            "nis_per_dof": _rounded(_nis(one, rows)),
            "position_sigma_m": _rounded(largest_sigma(covariances)),
            "yaw_sigma_rad": _rounded(np.sqrt(covariances[:, 2, 2])),
            **_columns(INDICES, one.indices[rows]),
            "ellipses": _ellipses(one, away),
        }
        path = one.trajectory
        if path.spatial is not None and path.spatial_sigmas is not None:
            columns |= _columns(SPATIAL, path.spatial[rows])
            columns |= _columns(SPATIAL_SIGMA, path.spatial_sigmas[rows])
        if truths:
            apart = poses - true_poses_at(truths[name].truth, stamps)
            columns["position_error_m"] = _rounded(np.hypot(apart[:, 0], apart[:, 1]))
            columns["yaw_error_rad"] = _rounded(np.asarray(wrap_angle(apart[:, 2])))
        columns["parameters"] = _parameters(one, log.start)
        columns["innovations"] = _innovations(one, log.start)
        series["variants"][name] = columns
    return series


def series_points(seconds: float) -> int:
    """Most rows of the series of a log of this duration [s]."""
    return int(min(max(SERIES_POINTS, seconds / SERIES_STEP), MOST_SERIES_POINTS))


def _inputs(log: Log, robot: Robot, stamps: Stamps) -> Results:
    """Track speeds and yaw rate as measured, nearest to the stamps; None in holes."""
    found = {}
    for side, speeds in zip(("left", "right"), log.tracks.speeds.T, strict=True):
        found[f"{side}_m_s"] = _rounded(_measured(log.tracks.stamps, speeds, stamps))
    if log.imu is not None and len(log.imu.stamps):
        rates = SensorModels(robot).yaw_rates(log.imu.angular_velocity)
        found["gyro_rad_s"] = _rounded(_measured(log.imu.stamps, rates, stamps))
    return found


def _measured(known: Stamps, values: Floats, wanted: Stamps) -> Floats:
    """Values nearest to the stamps, NaN in a hole."""
    if len(known) < 2:
        return np.full(len(wanted), math.nan)
    return np.where(_bridged(known, wanted), _nearest(known, values, wanted), math.nan)


def _at_point(poses: Floats, point: Floats) -> Floats:
    """Poses (n, 3) of a point (2,) in base_link [m]."""
    moved = poses.copy()
    moved[:, :2] += rotate(point, poses[:, 2])
    return moved


def _ellipses(one: Run, point: Floats) -> list[list[float | None]]:
    """Ellipses of one sigma: x, y, half axes [m], direction of the larger one [rad]."""
    rows = picks(len(one.stamps), ELLIPSES)
    variances, axes = np.linalg.eigh(one.trajectory.pose_covariances[rows, :2, :2])
    minor, major = np.sqrt(np.maximum(variances, 0.0)).T
    turn = np.arctan2(axes[:, 1, 1], axes[:, 0, 1])
    places = _at_point(one.trajectory.poses[rows], point)[:, :2]
    table = np.column_stack([places, major, minor, turn])
    return [_rounded(row) for row in table]


def _nis(one: Run, rows: NDArray[np.int64]) -> Floats:
    """Mean squared normalised innovation since the row before; NaN without any."""
    squares = np.full((len(one.stamps), 1), math.nan)
    if one.innovations.size:
        squares = one.innovations.astype(float) ** 2
    known = np.isfinite(squares)
    # Sums up to each row, so that a difference is the sum of the rows between two.
    sums = np.concatenate([[0.0], np.cumsum(np.where(known, squares, 0.0).sum(axis=1))])
    counts = np.concatenate([[0], np.cumsum(known.sum(axis=1))])
    starts = np.concatenate([[0], rows[:-1] + 1])
    used = counts[rows + 1] - counts[starts]
    mean = (sums[rows + 1] - sums[starts]) / np.maximum(used, 1)
    return np.where(used > 0, mean, math.nan)


def picks(count: int, most: int) -> NDArray[np.int64]:
    """Select at most `most` rows, evenly spaced, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.int64))


def true_poses_at(truth: Truth, stamps: Stamps) -> Floats:
    """Poses (n, 3) of a truth, NaN in its holes; the yaw NaN if it has no headings."""
    known = truth.poses.stamps
    poses = interpolate_poses(truth.poses, np.clip(stamps, known[0], known[-1]))
    poses[~_bridged(known, stamps)] = np.nan
    if not truth.headings:
        poses[:, 2] = np.nan
    return poses


def _bridged(known: Stamps, wanted: Stamps) -> NDArray[np.bool_]:
    """Mask (n,) of the wanted stamps between close known stamps, or next to one."""
    after = np.clip(np.searchsorted(known, wanted), 1, max(1, len(known) - 1))
    usual = int(np.median(np.diff(known))) if len(known) > 1 else 0
    bridge = max(int(LONGEST_BRIDGE / NANOSECOND), 2 * usual)
    before, after = known[after - 1], known[np.minimum(after, len(known) - 1)]
    between = (before <= wanted) & (wanted <= after) & (after - before <= bridge)
    beside = np.minimum(abs(wanted - before), abs(wanted - after)) <= bridge // 2
    return np.asarray(between | beside)


def _parameters(one: Run, start: int) -> Results:
    """Value and sigma over time of each uncertain parameter, bias, scale and gravity."""
    rows = picks(len(one.stamps), PARAMETER_POINTS)
    found: Results = {"t_s": _rounded((one.stamps[rows] - start) * NANOSECOND)}
    for index in range(s.LEARNT.start, s.GRAVITY.stop):
        name, sigma = one.state_names[index], one.state_sigmas[rows, index]
        if name and sigma.any():
            found[name] = {"value": _rounded(one.states[rows, index]), "sigma": _rounded(sigma)}
    return found


def _innovations(one: Run, start: int) -> Results:
    """Normalised innovations of each component of a sensor, on its own times."""
    found = {}
    for name, column in zip(one.innovation_names, one.innovations.T, strict=True):
        there = np.flatnonzero(np.isfinite(column))
        if len(there):
            rows = there[picks(len(there), INNOVATION_POINTS)]
            found[name] = {
                "t_s": _rounded((one.stamps[rows] - start) * NANOSECOND, 2),
                "normalised": _rounded(column[rows], 2),
            }
    return found


def _true_indices(truth: Truth, stamps: Stamps) -> Results:
    """ICR indices of the true motion, with the ICR distance, as the gauge is unknown."""
    if truth.twists is None or truth.tracks is None:
        return {}
    v_x, v_y, w = _nearest(truth.twists.stamps, truth.twists.twists, stamps).T
    V_l, V_r = _nearest(truth.tracks.stamps, truth.tracks.speeds, stamps).T
    with np.errstate(divide="ignore", invalid="ignore"):
        icrs = icrs_from_twist(V_l, V_r, PaperTwist(-v_y, v_x, w))
    turning = np.abs(w) >= LEAST_YAW_RATE
    shown = Icrs(*(np.where(turning, value, np.nan) for value in icrs))
    indices = np.column_stack(indices_from_icrs(shown, 1.0))
    return _columns(("zeta_m", "epsilon_m", "icr_distance_m"), indices)


def _nearest(known: Stamps, values: Floats, wanted: Stamps) -> Floats:
    """Values at the known stamps that are nearest to the wanted ones."""
    after = np.clip(np.searchsorted(known, wanted), 1, len(known) - 1)
    closer = np.where(known[after] - wanted < wanted - known[after - 1], after, after - 1)
    return np.asarray(values[closer])


def _columns(names: Sequence[str], values: Floats, decimals: int | None = None) -> Results:
    """Columns of a table (n, k), rounded, by their names."""
    return {name: _rounded(one, decimals) for name, one in zip(names, values.T, strict=True)}


def _rounded(values: ArrayLike, decimals: int | None = None) -> list[float | None]:
    """Round to `decimals`, or five significant digits without; None if not finite."""

    def rounded(value: float) -> float | None:
        if not math.isfinite(value):
            return None
        return float(f"{value:.5g}") if decimals is None else round(value, decimals)

    return [rounded(value) for value in np.asarray(values, dtype=float).tolist()]
