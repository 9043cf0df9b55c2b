"""Scores of each variant over a log, against the truth or else another variant."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.first_order import first_order
from icreckon.estimator.base.frames import relative, wrap_angle
from icreckon.estimator.log.path_heading import headings_by_path
from icreckon.estimator.log.scores import (
    HORIZONS,
    Interval,
    drift,
    interpolate_poses,
    path_length,
    pose_nees,
    shared_stamps,
    velocity_errors,
)
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import FixWander
from icreckon.estimator.streaming.outputs import Run
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.drift_table import Results, horizon_labels
from icreckon.replay.comparison.fixes import OF_FIXES, scored_intervals
from icreckon.replay.comparison.holes import between_holes, largest_sigma, scored_parts, until_holes
from icreckon.replay.comparison.truth_level import spatial_scores

NOISE_ROUNDS = 4  # draws of the noise of a truth, of which the mean is taken


def scores(comparison: Comparison, name: str, holes: Sequence[Interval]) -> Results:
    """Score a run against the truth; intervals of drift are in `drift_table`.

    RMSE is computed between the holes, NEES before the first one in each interval that is scored.
    """
    run, aligned = comparison.runs[name], comparison.truths[name]
    truth, estimate, log = aligned.truth, run.trajectory, comparison.log
    results: Results = {"lever_arm_m": list(aligned.lever_arm)}
    for horizon in HORIZONS:
        segments = comparison.drifts[f"{horizon:g}s"][name]
        results[f"drift_percent_{horizon:.0f}s_median"] = segments.percent_median
        if horizon == 30.0:
            results["yaw_drift_deg_per_m"] = segments.yaw_deg_per_m if truth.headings else math.nan
    # Without headings displacements have no axes.
    has_axes = truth.headings or truth.twists is not None
    known = between_holes([(log.start, log.end)], holes) if has_axes else []
    truths = [replace(log, truth=truth).between(*part).truth for part in known]
    parts = [velocity_errors(estimate, one) for one in truths if one and len(one.poses.stamps) > 1]
    errors = np.concatenate([np.zeros((0, 3)), *parts])
    rmse = np.sqrt(np.mean(errors**2, axis=0)) if len(errors) else np.full(3, np.nan)
    results |= zip(("rmse_v_x_m_s", "rmse_v_y_m_s", "rmse_w_rad_s"), rmse.tolist(), strict=True)
    at_start = [hole for hole in holes if hole[0] == log.start]
    within = until_holes(between_holes(scored_intervals(log), at_start), holes)
    nees = pose_nees(estimate, truth.poses, within=within, position_only=not truth.headings)
    # The filter's covariance does not include the errors of fixes that serve as truth.
    has_nees = len(nees) > 0 and truth.source != OF_FIXES
    nees_key = "nees_pose_mean" if truth.headings else "nees_position_mean"
    results |= {"nees_pose_mean": math.nan, nees_key: nees.mean().item() if has_nees else math.nan}
    results["nees_poses"] = len(nees) if has_nees else 0
    end = np.array([min(truth.poses.stamps[-1], estimate.stamps[-1])])
    estimated, true = (interpolate_poses(of, end)[0] for of in (estimate.pose_series, truth.poses))
    x, y, yaw = estimated - true
    results["final_position_error_m"] = float(np.hypot(x, y))
    yaw_error = float(np.degrees(wrap_angle(yaw)))
    results["final_yaw_error_deg"] = yaw_error if truth.headings else math.nan
    results |= spatial_scores(estimate, truth.poses, scored_parts(log))
    return results | _consistency(run)


def noise_drifts(comparison: Comparison, robot: Robot) -> dict[str, float]:
    """Drift [%] that noise of the truth alone causes, by horizon as "30s".

    The path of the last run is scored against itself plus noise: white with the deviation of the truth,
    and the wander of the robot file if fixes are the truth. Then headings are found as the truth's were.
    Empty without a truth, or if the truth has headings of its own.
    """
    alignment, log = comparison.alignment, comparison.log
    if log.truth is None or alignment is None or alignment.headings is None:
        return {}
    path = [*comparison.runs.values()][-1].trajectory.pose_series
    stamps, wander = shared_stamps(path, log.truth.poses), FixWander.of(robot)
    wander_sigma = wander.sigma if log.truth.source == OF_FIXES else 0.0
    step = float(np.median(np.diff(stamps))) * NANOSECOND
    # The wander is a first-order Gauss-Markov process, driven by white noise.
    correlation = math.exp(-step / wander.time) if wander_sigma else 0.0
    poses, generator = interpolate_poses(path, stamps), np.random.default_rng(0)
    percents: dict[str, list[float]] = {}
    scored = scored_parts(log)
    for _ in range(NOISE_ROUNDS):
        white, driving = generator.standard_normal((2, len(stamps), 2))
        driving[1:] *= math.sqrt(1.0 - correlation**2)
        noisy = poses.copy()
        noisy[:, :2] += alignment.headings.noise * white
        noisy[:, :2] += wander_sigma * first_order(driving, correlation)
        truth = headings_by_path(PoseSeries(stamps, noisy), path)
        if truth is None:
            return {}
        for horizon in HORIZONS:
            segments = drift(path, truth.poses, horizon, within=scored)
            percents.setdefault(f"{horizon:g}s", []).append(segments.percent_mean)
    return {label: float(np.mean(values)) for label, values in percents.items()}


def differences(run: Run, reference: Run) -> Results:
    """Compare a run with a reference run, without a truth: final pose and distances."""
    estimate, expected = run.trajectory, reference.trajectory
    end, expected_end = estimate.poses[-1], expected.poses[-1]
    x, y, yaw = end
    forward, left, _ = relative(expected_end, end)
    scored: Results = {
        "distance_m": float(path_length(estimate.pose_series)[-1]),
        "end_x_m": float(x),
        "end_y_m": float(y),
        "end_yaw_deg": float(np.degrees(yaw)),
        "end_sigma_m": largest_sigma(estimate.pose_covariances[-1:])[0],
        "end_apart_m": float(np.hypot(forward, left)),
        "end_yaw_apart_deg": float(np.degrees(yaw - expected_end[2])),
    }
    for label, (horizon, unit) in horizon_labels().items():
        segments = drift(estimate.pose_series, expected.pose_series, horizon, unit=unit)
        scored[f"apart_percent_{label}_mean"] = segments.percent_mean
    return scored | _consistency(run)


def _consistency(run: Run) -> Results:
    """Collect statistics of a run's innovations and its final parameters."""
    health, names = run.health, run.state_names
    final = dict(zip(names, run.states[-1].tolist(), strict=True))
    sigmas = dict(zip(names, run.state_sigmas[-1].tolist(), strict=True))
    # States that the variant lacks have no name.
    estimated = [name for name in names[s.LEARNT.start : s.GRAVITY.stop] if name]
    return {
        "nis": {name: sensor.nis_per_degree for name, sensor in health.sensors.items()},
        "used": {name: sensor.used for name, sensor in health.sensors.items()},
        "rejected": health.rejections(),
        "standstill_updates": health.standstill_updates,
        "track_gaps": health.track_gaps,
        "faults": health.times,
        "final_parameters": {name: final[name] for name in estimated},
        "final_parameter_sigmas": {name: sigmas[name] for name in estimated},
    }
