"""Decimated time series of a comparison, for plots."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import rotate, wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate, path_length
from icreckon.estimator.log.series import Truth
from icreckon.estimator.motion.icr import Icrs, PaperTwist, icrs_from_twist, indices_from_icrs
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.streaming.outputs import Run
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.drift_table import Results
from icreckon.replay.comparison.holes import are_bridged, largest_sigma, nearest_rows, true_poses_at

# Rows of the series: one each `SERIES_STEP` [s], within these limits. With all nine
# variants, 1500 rows make a page of 2.6 MB, 4000 rows one of 5.7 MB.
SERIES_POINTS, MOST_SERIES_POINTS, SERIES_STEP = 1500, 4000, 0.25
PARAMETER_POINTS = 300
INNOVATION_POINTS = 700
ELLIPSES = 30
LEAST_YAW_RATE = 0.1  # least yaw rate at which indices are computed from a twist [rad/s]
DECIMALS = 4  # decimals of positions [m], and of values as large
POSE, SPATIAL = ("x_m", "y_m", "yaw_rad"), ("z_m", "roll_rad", "pitch_rad")
SPATIAL_SIGMA = ("z_sigma_m", "roll_sigma_rad", "pitch_sigma_rad")
TWIST, INDICES = ("v_x_m_s", "v_y_m_s", "w_rad_s"), ("zeta_m", "epsilon_m", "eta")


def series_of(comparison: Comparison, robot: Robot, headline: str) -> Results:
    """Decimate the time series; parameters and innovations have their own times.

    Each run has errors against a truth that is aligned by its own lever arm. Paths of all runs are those
    of one point: base_link by the truth of the variant `headline`.
    """
    log = comparison.log
    first_run = next(iter(comparison.runs.values()))
    wanted = (log.end - log.start) * NANOSECOND / SERIES_STEP
    most = int(np.clip(wanted, SERIES_POINTS, MOST_SERIES_POINTS))
    stamps = first_run.stamps[picks(len(first_run.stamps), most)]
    truths, path = comparison.truths, first_run.trajectory.pose_series
    shown = truths.get(headline)
    series: Results = {"t_s": rounded((stamps - log.start) * NANOSECOND), "variants": {}}
    series["inputs"] = _inputs(log, robot, stamps)
    if log.truth is not None and shown is not None:
        series["truth"] = _true_columns(log.truth, shown.truth, stamps)
        path = shown.truth.poses
    series["distance_m"] = rounded(np.interp(stamps, path.stamps, path_length(path)), DECIMALS)
    if log.fixes is not None:
        rows = picks(len(log.fixes.stamps), most)
        times = (log.fixes.stamps[rows] - log.start) * NANOSECOND
        places = _columns(POSE[:2], log.fixes.poses[rows, :2], DECIMALS)
        series["fixes"] = {"t_s": rounded(times), **places}
    for name, run in comparison.runs.items():
        point, truth = np.zeros(2), None
        if shown is not None:
            point, truth = np.subtract(truths[name].lever_arm, shown.lever_arm), truths[name].truth
        series["variants"][name] = _run_columns(run, stamps, point, truth) | {
            "parameters": _parameters(run, log.start),
            "innovations": _innovations(run, log.start),
        }
    return series


def _true_columns(logged: Truth, aligned: Truth, stamps: Stamps) -> Results:
    """Truth at the stamps: poses of the aligned truth, twists and indices as logged."""
    columns = _columns(POSE, true_poses_at(aligned, stamps), DECIMALS)
    if aligned.poses.spatial is not None:
        spatial = interpolate(aligned.poses.stamps, aligned.poses.spatial, stamps)
        columns |= _columns(SPATIAL, spatial)
    if logged.twists is not None:
        rows = nearest_rows(logged.twists.stamps, stamps)
        columns |= _columns(TWIST, logged.twists.twists[rows])
    return columns | _true_indices(logged, stamps)


def _run_columns(run: Run, stamps: Stamps, point: Floats, truth: Truth | None) -> Results:
    """Estimates of a run at stamps, poses of a point (2,) [m], and true errors."""
    rows = np.minimum(np.searchsorted(run.stamps, stamps), len(run.stamps) - 1)
    path = run.trajectory
    poses, covariances = path.poses[rows], path.pose_covariances[rows]
    columns = {
        **_columns(POSE, _at_point(poses, point), DECIMALS),
        **_columns(TWIST, path.twists[rows]),
        "nis_per_dof": rounded(_nis(run, rows)),
        "position_sigma_m": rounded(largest_sigma(covariances)),
        "yaw_sigma_rad": rounded(np.sqrt(covariances[:, 2, 2])),
        **_columns(INDICES, run.indices[rows]),
        "ellipses": _ellipses(run, point),
    }
    if path.spatial is not None and path.spatial_sigmas is not None:
        columns |= _columns(SPATIAL, path.spatial[rows])
        columns |= _columns(SPATIAL_SIGMA, path.spatial_sigmas[rows])
    if truth is not None:
        x, y, yaw = (poses - true_poses_at(truth, stamps)).T
        columns["position_error_m"] = rounded(np.hypot(x, y))
        columns["yaw_error_rad"] = rounded(np.asarray(wrap_angle(yaw)))
    return columns


def _inputs(log: Log, robot: Robot, stamps: Stamps) -> Results:
    """Track speeds and yaw rate as measured, nearest to the stamps; None in holes."""
    tracks, imu = log.tracks, log.imu
    left, right = (_measured(tracks.stamps, speeds, stamps) for speeds in tracks.speeds.T)
    columns = {"left_m_s": rounded(left), "right_m_s": rounded(right)}
    if imu is not None and len(imu.stamps):
        rates = SensorModels(robot).yaw_rates(imu.angular_velocity)
        columns["gyro_rad_s"] = rounded(_measured(imu.stamps, rates, stamps))
    return columns


def _measured(known: Stamps, values: Floats, wanted: Stamps) -> Floats:
    """Values (n,) of `known` stamps, nearest to the `wanted` ones; NaN in a hole."""
    if len(known) < 2:
        return np.full(len(wanted), math.nan)
    return np.where(are_bridged(known, wanted), values[nearest_rows(known, wanted)], math.nan)


def _at_point(poses: Floats, point: Floats) -> Floats:
    """Poses (n, 3) of a point (2,) in base_link [m]."""
    moved = poses.copy()
    moved[:, :2] += rotate(point, poses[:, 2])
    return moved


def _ellipses(run: Run, point: Floats) -> list[list[float | None]]:
    """Ellipses of 1σ about a point (2,): x, y, half axes [m], direction [rad]."""
    rows = picks(len(run.stamps), ELLIPSES)
    # Eigenvalues ascend: the last eigenvector has the direction of the larger axis.
    variances, axes = np.linalg.eigh(run.trajectory.pose_covariances[rows, :2, :2])
    minor, major = np.sqrt(np.maximum(variances, 0.0)).T
    direction = np.arctan2(axes[:, 1, 1], axes[:, 0, 1])
    centres = _at_point(run.trajectory.poses[rows], point)[:, :2]
    return [rounded(row) for row in np.column_stack([centres, major, minor, direction])]


def _nis(run: Run, rows: NDArray[np.int64]) -> Floats:
    """Mean squared normalised innovation since the previous row; NaN without any."""
    squares = np.full((len(run.stamps), 1), math.nan)
    if run.innovations.size:
        squares = run.innovations.astype(float) ** 2
    known = np.isfinite(squares)
    # Sums up to each row, so that a difference is the sum of the rows between two.
    sums = np.concatenate([[0.0], np.cumsum(np.where(known, squares, 0.0).sum(axis=1))])
    counts = np.concatenate([[0], np.cumsum(known.sum(axis=1))])
    ends, starts = rows + 1, np.concatenate([[0], rows[:-1] + 1])
    used = counts[ends] - counts[starts]
    mean = (sums[ends] - sums[starts]) / np.maximum(used, 1)
    return np.where(used > 0, mean, math.nan)


def picks(count: int, most: int) -> NDArray[np.int64]:
    """Select at most `most` rows, evenly spaced, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.int64))


def _parameters(run: Run, start: int) -> Results:
    """Value and sigma over time of each uncertain parameter, bias, scale and gravity."""
    rows = picks(len(run.stamps), PARAMETER_POINTS)
    columns: Results = {"t_s": rounded((run.stamps[rows] - start) * NANOSECOND)}
    for index in range(s.LEARNT.start, s.GRAVITY.stop):
        name, sigma = run.state_names[index], run.state_sigmas[rows, index]
        # States that the variant lacks have no name, known ones no uncertainty.
        if name and sigma.any():
            columns[name] = {"value": rounded(run.states[rows, index]), "sigma": rounded(sigma)}
    return columns


def _innovations(run: Run, start: int) -> Results:
    """Normalised innovations of each component of a sensor, on its own times."""
    by_component = {}
    for name, column in zip(run.innovation_names, run.innovations.T, strict=True):
        known = np.flatnonzero(np.isfinite(column))
        if len(known):
            rows = known[picks(len(known), INNOVATION_POINTS)]
            times = rounded((run.stamps[rows] - start) * NANOSECOND, 2)
            by_component[name] = {"t_s": times, "normalised": rounded(column[rows], 2)}
    return by_component


def _true_indices(truth: Truth, stamps: Stamps) -> Results:
    """Indices of the true motion by (1) to (3), (17) to (19); None if it hardly turns."""
    if truth.twists is None or truth.tracks is None:
        return {}
    v_x, v_y, w = truth.twists.twists[nearest_rows(truth.twists.stamps, stamps)].T
    V_l, V_r = truth.tracks.speeds[nearest_rows(truth.tracks.stamps, stamps)].T
    with np.errstate(divide="ignore", invalid="ignore"):
        icrs = icrs_from_twist(V_l, V_r, PaperTwist(-v_y, v_x, w))
    turning = np.abs(w) >= LEAST_YAW_RATE
    known_icrs = Icrs(*(np.where(turning, coordinate, np.nan) for coordinate in icrs))
    # With a gauge of 1 m, eta is the distance of the ICRs.
    indices = np.column_stack(indices_from_icrs(known_icrs, 1.0))
    return _columns(("zeta_m", "epsilon_m", "icr_distance_m"), indices)


def _columns(names: Sequence[str], values: Floats, decimals: int | None = None) -> Results:
    """Columns of a table (n, k), rounded, by their names."""
    columns = zip(names, values.T, strict=True)
    return {name: rounded(column, decimals) for name, column in columns}


def rounded(values: ArrayLike, decimals: int | None = None) -> list[float | None]:
    """Round to five significant digits or to `decimals`, with None for NaN."""
    numbers: list[float] = np.asarray(values, dtype=float).tolist()
    if decimals is None:
        return [float(f"{value:.5g}") if math.isfinite(value) else None for value in numbers]
    return [round(value, decimals) if math.isfinite(value) else None for value in numbers]
