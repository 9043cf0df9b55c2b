"""Statistics of a run: one number each, NaN if the run does not have it.

An engine returns them in this order, see `simulation.running.engines`; definitions are those of
`estimator.log.scores`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import (
    drift,
    interpolate_poses,
    pose_nees,
    velocity_errors,
    without_fixes,
)
from icreckon.estimator.log.series import Truth
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.streaming.recorded_run import Run
from icreckon.simulation.base.sampling import sample_times
from icreckon.simulation.scenario import Scenario

# Yaw drift is scored over segments of this length [s].
YAW_HORIZON = 30.0
# A covariance with a smaller eigenvalue counts as singular, as in `pose_nees`.
LEAST_EIGENVALUE = 1e-12
SENSORS = ("gyro", "accelerometer", "position")
DRIFT = "drift_percent_{:g}s"


def score_times(scenario: Scenario) -> Floats:
    """Times (n,) at which a run is scored [s]: IMU samples next to the truth's stamps.

    A filter has an estimate there at any combination of rates.
    """
    samples = sample_times(scenario.duration, scenario.imu_rate)
    wanted = sample_times(scenario.duration, scenario.truth_rate)
    following = np.minimum(np.searchsorted(samples, wanted - 1e-9), len(samples) - 1)
    return np.asarray(samples[np.unique(following)])


class Statistic(NamedTuple):
    """Statistic: its name in files, title for people, unit, and ideal value, if any."""

    name: str
    title: str
    unit: str
    ideal: float | None = None


def statistics(horizons: Sequence[float]) -> tuple[Statistic, ...]:
    """Statistics of a run, in their order.

    Args:
        horizons: lengths of the segments over which drift is scored [s].
    """
    return (
        *(
            Statistic(DRIFT.format(horizon), f"drift after {horizon:g} s", "% of distance")
            for horizon in horizons
        ),
        Statistic("yaw_drift_deg_per_m", f"yaw drift after {YAW_HORIZON:g} s", "deg/m"),
        Statistic("final_position_error_m", "position error at the end", "m"),
        Statistic("final_yaw_error_rad", "yaw error at the end, absolute", "rad"),
        Statistic("position_rmse_m", "RMS position error", "m"),
        Statistic("yaw_rmse_rad", "RMS yaw error", "rad"),
        Statistic("rmse_v_x_m_s", "RMS error of v_x", "m/s"),
        Statistic("rmse_v_y_m_s", "RMS error of v_y", "m/s"),
        Statistic("rmse_w_rad_s", "RMS error of w", "rad/s"),
        Statistic("nees_pose_mean", "NEES of the pose, over the run", "-", 3.0),
        Statistic("nees_pose_end", "NEES of the pose at the end", "-", 3.0),
        Statistic("nees_velocity_mean", "NEES of the velocity, over the run", "-", 3.0),
        *(
            Statistic(f"nis_{name}_mean", f"NIS of {name}, per degree", "-", 1.0)
            for name in SENSORS
        ),
        *(
            Statistic(f"rejected_{name}", f"rejected by the gate of {name}", "-")
            for name in SENSORS
        ),
        Statistic("rejected_total", "rejected measurements", "-"),
    )


def run_statistics(one: Run, log: Log, horizons: Sequence[float]) -> Floats:
    """Statistics (n,) of a run, in the order of `statistics`.

    Drift is scored in the spans without fixes that are at least as long as a segment; over the whole
    run if it has no fixes.

    Args:
        one: the run; it starts at the true pose.
        log: log of the run, with its truth.
        horizons: lengths of the segments over which drift is scored [s].

    Raises:
        ValueError: the log has no truth with twists.
    """
    truth = log.truth
    if truth is None or truth.twists is None:
        raise ValueError("there is no truth to score against")
    estimate = one.trajectory
    drifts = [_drift(estimate, log, truth, horizon)[0] for horizon in horizons]
    yaw_drift = _drift(estimate, log, truth, YAW_HORIZON)[1]
    stamps = truth.poses.stamps
    stamps = stamps[(stamps >= estimate.stamps[0]) & (stamps <= estimate.stamps[-1])]
    poses = interpolate_poses(estimate.pose_series, stamps)
    errors = poses - interpolate_poses(truth.poses, stamps)
    errors[:, 2] = wrap_angle(errors[:, 2])
    velocities = velocity_errors(estimate, truth)
    nees = pose_nees(estimate, truth.poses)
    values = [
        *drifts,
        yaw_drift,
        math.hypot(*errors[-1, :2]),
        abs(float(errors[-1, 2])),
        _rms(errors[:, :2]) * math.sqrt(2.0),
        _rms(errors[:, 2]),
        *(_rms(velocities[:, axis]) for axis in range(3)),
        _mean(nees),
        float(nees[-1]) if len(nees) and np.isfinite(errors[-1]).all() else math.nan,
        _mean(_velocity_nees(estimate, truth, velocities)),
        *_consistency(one.health),
    ]
    return np.array(values, dtype=float)


def _drift(estimate: Trajectory, log: Log, truth: Truth, horizon: float) -> tuple[float, float]:
    """Drift [%] and yaw drift [deg/m] of one horizon."""
    within = None
    if log.fixes is not None and len(log.fixes.stamps):
        within = without_fixes(log.fixes.stamps, log.start, log.end, horizon)
        if not within:
            return math.nan, math.nan
    segments = drift(estimate.pose_series, truth.poses, horizon, within=within)
    return segments.percent_mean, segments.yaw_deg_per_m


def _velocity_nees(estimate: Trajectory, truth: Truth, errors: Floats) -> Floats:
    """NEES (n,) of the twist at the truth's stamps with a regular covariance."""
    stamps = truth.poses.stamps
    stamps = stamps[(stamps >= estimate.stamps[0]) & (stamps <= estimate.stamps[-1])]
    covariances = estimate.twist_covariances[np.searchsorted(estimate.stamps, stamps)]
    regular = np.linalg.eigvalsh(covariances)[:, 0] > LEAST_EIGENVALUE
    solved = np.linalg.solve(covariances[regular], errors[regular][..., None])[..., 0]
    return np.asarray(np.einsum("ij,ij->i", errors[regular], solved))


def _consistency(health: Health) -> list[float]:
    """NIS and rejections of each sensor, and all rejections."""
    sensors = [health.sensors.get(name) for name in SENSORS]
    nis = [math.nan if one is None else one.nis_per_degree for one in sensors]
    gated = [0.0 if one is None else float(one.rejected.get("gate", 0)) for one in sensors]
    return [*nis, *gated, float(sum(health.rejections().values()))]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else math.nan
