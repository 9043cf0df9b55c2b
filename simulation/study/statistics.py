"""Statistics of a run: one number each, NaN if the run does not have it.

An engine returns them in this order, see `icreckon.simulation.running.engines`;
`icreckon.estimator.log.scores` defines them.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Indexes, Stamps
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import (
    interpolate,
    interpolate_poses,
    mean_ratio,
    nees,
    path_length,
    segment_errors,
    segment_starts,
    shared_stamps,
    usable_segments,
    without_fixes,
)
from icreckon.estimator.log.series import PoseSeries, TwistSeries
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.streaming.outputs import Run
from icreckon.simulation.base.sampling import sample_times
from icreckon.simulation.scenario import Scenario

YAW_HORIZON = 30.0  # yaw drift is scored over segments of this length [s]
SENSORS = ("gyro", "accelerometer_x", "accelerometer_y", "position")
DRIFT = "drift_percent_{:g}s"


def score_times(scenario: Scenario) -> Floats:
    """Times (n,) at which a run is scored [s]: IMU samples at or after truth stamps.

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
    """Statistics of a run, in their order, by the horizons of the drift [s]."""
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
        *(Statistic(f"nis_{key}_mean", f"NIS of {key}, per degree", "-", 1.0) for key in SENSORS),
        *(Statistic(f"rejected_{key}", f"rejected by the gate of {key}", "-") for key in SENSORS),
        Statistic("rejected_total", "rejected measurements", "-"),
    )


class TrueTicks(NamedTuple):
    """Truth of one run, or of several side by side, at the stamps of their estimates."""

    poses: Floats  # (n, ..., 3) [m, m, rad]
    twists: Floats  # (n, ..., 3) [m/s, m/s, rad/s]
    lengths: Floats  # (n, ...) length of the path so far [m]


class Segments(NamedTuple):
    """Segments over which drift is scored."""

    horizon: float  # their length [s]
    first: Indexes  # (n,) indices of their starts
    last: Indexes  # (n,) indices of their ends


def scored_segments(
    stamps: Stamps, horizons: Sequence[float], fixes: Stamps, start: int, end: int
) -> list[Segments]:
    """Segments of each horizon [s], and of the yaw drift, which come last.

    They lie in the spans without fixes that are at least as long as a segment; in the whole run if it has
    no fixes. The run is scored at `stamps` (n,); all stamps are in ns.
    """
    first, scored = segment_starts(stamps), []
    for horizon in (*horizons, YAW_HORIZON):
        last = np.searchsorted(stamps, stamps[first] + int(horizon / NANOSECOND))
        within = without_fixes(fixes, start, end, horizon) if len(fixes) else None
        # The truth of a study has no gaps.
        usable = usable_segments(stamps, first, last, within=within, largest_gap=math.inf)
        scored.append(Segments(horizon, *usable))
    return scored


def _truth_of(log: Log) -> tuple[PoseSeries, TwistSeries]:
    """True poses and body velocities of a log; ValueError without them."""
    if log.truth is None or log.truth.twists is None:
        raise ValueError("there is no truth to score against")
    return log.truth.poses, log.truth.twists


def true_ticks(log: Log) -> TrueTicks:
    """Truth of a run whose truth has the stamps of its estimates."""
    poses, twists = _truth_of(log)
    return TrueTicks(poses.poses, twists.twists, path_length(poses))


def run_statistics(run: Run, log: Log, horizons: Sequence[float]) -> Floats:
    """Statistics (n,), in the order of `statistics`, of a run from the true pose on."""
    path, (poses, twists) = run.trajectory, _truth_of(log)
    stamps = shared_stamps(path, poses)
    path_rows, twist_rows = (np.searchsorted(series.stamps, stamps) for series in (path, twists))
    estimate = Trajectory(
        stamps,
        interpolate_poses(path.pose_series, stamps),
        path.pose_covariances[path_rows],
        interpolate(path.stamps, path.twists, stamps),
        path.twist_covariances[path_rows],
    )
    true_poses = interpolate_poses(poses, stamps)
    lengths = path_length(PoseSeries(stamps, true_poses))
    truth = TrueTicks(true_poses, twists.twists[twist_rows], lengths)
    fixes = np.zeros(0, np.int64) if log.fixes is None else log.fixes.stamps
    segments = scored_segments(stamps, horizons, fixes, log.start, log.end)
    return np.array([*path_statistics(estimate, truth, segments), *_consistency(run.health)])


@np.errstate(all="ignore")
def path_statistics(
    estimate: Trajectory, truth: TrueTicks, segments: Sequence[Segments]
) -> list[Floats]:
    """Statistics (...) of estimates, in their order, up to those of innovations.

    The truth is at the estimates' stamps, segments are those of `scored_segments`. An axis for runs side
    by side may follow the first axis of all arrays.
    """
    errors = estimate.poses - truth.poses
    errors[..., 2] = wrap_angle(errors[..., 2])
    x, y, yaw = np.moveaxis(errors, -1, 0)
    velocities = estimate.twists - truth.twists
    drifts = [_drift(estimate, truth, segments_of_horizon) for segments_of_horizon in segments]
    _, yaw_drift = drifts.pop()
    return [
        *(100.0 * position_drift for position_drift, _ in drifts),
        np.degrees(yaw_drift),
        np.hypot(x[-1], y[-1]),
        np.abs(yaw[-1]),
        _rms(np.hypot(x, y)),
        _rms(yaw),
        *(_rms(velocities[..., axis]) for axis in range(3)),
        *_nees(errors, estimate.pose_covariances),
        _nees(velocities, estimate.twist_covariances)[0],
    ]


def _drift(estimate: Trajectory, truth: TrueTicks, segments: Segments) -> tuple[Floats, Floats]:
    """Drift (...) of position [-] and yaw [rad/m] of one horizon."""
    horizon, first, last = segments
    position, yaw = segment_errors(estimate.poses, truth.poses, first, last)
    distances = truth.lengths[last] - truth.lengths[first]
    return (mean_ratio(position, distances, horizon), mean_ratio(np.abs(yaw), distances, horizon))


def _nees(errors: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Mean and last NEES (...) of errors (n, ..., 3) with regular covariance, or NaN."""
    values = nees(errors, covariances)
    is_regular = np.isfinite(values)
    # The last regular row is the first one in reverse order.
    last = len(is_regular) - 1 - np.argmax(is_regular[::-1], axis=0)
    end = np.take_along_axis(values, last[None], axis=0)[0]
    mean = np.sum(values, axis=0, where=is_regular) / is_regular.sum(axis=0)
    return mean, np.where(is_regular.any(axis=0), end, np.nan)


def _consistency(health: Health) -> list[float]:
    """NIS (NaN if unused) and gate rejections of each of `SENSORS`, all rejections."""
    sensors = [health.sensors.get(name) for name in SENSORS]
    nis = [math.nan if sensor is None else sensor.nis_per_degree for sensor in sensors]
    gated = [0 if sensor is None else sensor.rejected.get("gate", 0) for sensor in sensors]
    return [*nis, *map(float, gated), float(sum(health.rejections().values()))]


def _rms(values: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean(values * values, axis=0)))
