"""The results of a comparison as plain data: what `results.json` holds, and all else is made from.

`variants` holds one object for each filter variant with its scores, units in the key names; `series`
holds decimated time series for the pictures. A score that a log cannot give is null.
"""

from __future__ import annotations

import hashlib
import json
import math
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from estimator import state as s
from estimator.frames import Floats, relative, wrap_angle
from estimator.kinematics import Icrs, PaperTwist, icrs_from_twist, indices_from_icrs
from estimator.log import NANOSECOND, Log, Stamps, Truth
from estimator.robot import Robot
from estimator.run import Run
from estimator.scores import (
    HORIZONS,
    drift,
    interpolate_poses,
    path_length,
    pose_nees,
    velocity_errors,
    without_fixes,
)
from estimator.smoother import SMOOTHED
from replay.comparison import Comparison

FORMAT = 1
# A time without fixes at least this long is scored as dead reckoning [s].
SCORED_OUTAGE = 15.0
SERIES_POINTS = 1500
# A time without samples that is worth telling [s].
LONG_GAP = 1.0
# Index values follow from a twist only while the robot turns at least this fast [rad/s].
LEAST_YAW_RATE = 0.1
PACKAGES = ("icreckon", "numpy", "scipy", "filterpy", "rosbags", "msgspec")

Results = dict[str, Any]


def summarise(
    comparison: Comparison,
    robot: Robot,
    *,
    command: str,
    configuration: dict[str, Any],
    seed: int | None = None,
    inputs: dict[str, Path] | None = None,
) -> Results:
    """Scores, series and provenance of a comparison, ready for `write_results`.

    Args:
        comparison: the runs.
        robot: the robot.
        command: name of the command that made them.
        configuration: what the command was told.
        seed: of a simulated log.
        inputs: bags that were read, by the name to give them, for their hashes.
    """
    log = comparison.log
    scored = _scored_intervals(log)
    reference = [name for name in comparison.runs if not name.endswith(SMOOTHED)][-1]
    variants = {
        name: _clean(
            _scores(one, log, scored)
            if log.truth is not None
            else _differences(one, comparison.runs[reference])
        )
        for name, one in comparison.runs.items()
    }
    results: Results = {
        "format": FORMAT,
        "command": command,
        "configuration": configuration,
        "seed": seed,
        "versions": _versions(),
        "inputs": {name: _digest(path) for name, path in (inputs or {}).items()},
        "robot": msgspec.to_builtins(robot),
        "log": {
            "name": log.name,
            "duration_s": log.duration,
            "track_samples": len(log.tracks.stamps),
            "imu_samples": 0 if log.imu is None else len(log.imu.stamps),
            "fixes": 0 if log.fixes is None else len(log.fixes.stamps),
            "dropped": log.dropped,
            "notes": [*log.notes, *_holes(log)],
            "start_ns": log.start,
        },
        "truth": _truth_summary(comparison, scored),
        "reference_variant": None if log.truth is not None else reference,
        "variants": variants,
        "series": _series(comparison),
    }
    return results


def write_results(path: Path, results: Results) -> None:
    """Write results as JSON; NaN becomes null."""
    path.write_text(json.dumps(_clean(results), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _holes(log: Log) -> list[str]:
    """What is to be said of times without track speeds or IMU samples."""
    streams = {"track speeds": log.tracks.stamps}
    if log.imu is not None:
        streams["IMU samples"] = log.imu.stamps
    told = []
    for name, stamps in streams.items():
        gaps = np.diff(stamps) * NANOSECOND
        long = gaps[gaps > LONG_GAP]
        if len(long):
            told.append(
                f"{len(long)} holes of more than {LONG_GAP:.0f} s in the {name}, "
                f"the longest of {long.max():.1f} s"
            )
    return told


def _truth_summary(comparison: Comparison, scored: list[tuple[int, int]]) -> Results | None:
    truth, alignment = comparison.log.truth, comparison.alignment
    if truth is None:
        return None
    start = comparison.log.start
    return {
        "source": truth.source,
        "distance_m": float(path_length(truth.poses)[-1]),
        "lag_s": 0.0 if alignment is None else alignment.lag,
        "lever_arm_m": [0.0, 0.0] if alignment is None else list(alignment.lever_arm),
        "scored_s": [[(a - start) * NANOSECOND, (b - start) * NANOSECOND] for a, b in scored],
    }


def _scored_intervals(log: Log) -> list[tuple[int, int]]:
    """Where drift is scored: all of a log without fixes, otherwise its long gaps between fixes."""
    if log.fixes is None or len(log.fixes.stamps) == 0:
        return [(log.start, log.end)]
    return without_fixes(log.fixes.stamps, log.start, log.end, SCORED_OUTAGE)


def _scores(one: Run, log: Log, scored: list[tuple[int, int]]) -> Results:
    """Scores against the truth."""
    truth = log.truth
    if truth is None:
        raise ValueError("there is no truth to score against")
    estimate = one.trajectory
    scores: Results = {}
    for horizon in HORIZONS:
        segments = drift(estimate.pose_series, truth.poses, horizon, within=scored)
        label = f"{horizon:.0f}s"
        scores[f"drift_percent_{label}_mean"] = segments.percent_mean
        scores[f"drift_percent_{label}_median"] = segments.percent_median
        scores[f"drift_segments_{label}"] = int(segments.moved.sum())
        if horizon == 30.0:
            scores["yaw_drift_deg_per_m"] = segments.yaw_deg_per_m
    errors = velocity_errors(estimate, truth)
    rmse = np.sqrt(np.mean(errors**2, axis=0)) if len(errors) else np.full(3, np.nan)
    for name, value in zip(("v_x_m_s", "v_y_m_s", "w_rad_s"), rmse.tolist(), strict=True):
        scores[f"rmse_{name}"] = value
    nees = pose_nees(estimate, truth.poses, within=scored)
    scores["nees_pose_mean"] = float(nees.mean()) if len(nees) else math.nan
    end = min(truth.poses.stamps[-1], estimate.stamps[-1])
    at = np.array([end])
    last = interpolate_poses(estimate.pose_series, at) - interpolate_poses(truth.poses, at)
    scores["final_position_error_m"] = float(np.hypot(*last[0, :2]))
    scores["final_yaw_error_deg"] = float(np.degrees(wrap_angle(last[0, 2])))
    return scores | _consistency(one)


def _differences(one: Run, reference: Run) -> Results:
    """What can be said without a truth: where a variant ends, and how far from another."""
    estimate, other = one.trajectory, reference.trajectory
    end = estimate.poses[-1]
    apart = relative(other.poses[-1], end)
    scores: Results = {
        "distance_m": float(path_length(estimate.pose_series)[-1]),
        "end_x_m": float(end[0]),
        "end_y_m": float(end[1]),
        "end_yaw_deg": float(np.degrees(end[2])),
        "end_sigma_m": _largest_sigma(estimate.pose_covariances[-1:])[0],
        "end_apart_m": float(np.hypot(apart[0], apart[1])),
        "end_yaw_apart_deg": float(np.degrees(end[2] - other.poses[-1, 2])),
    }
    for horizon in HORIZONS:
        segments = drift(estimate.pose_series, other.pose_series, horizon)
        scores[f"apart_percent_{horizon:.0f}s_mean"] = segments.percent_mean
    return scores | _consistency(one)


def _consistency(one: Run) -> Results:
    """What the filter says of its own measurements and parameters."""
    health = one.health
    names = one.state_names
    final = dict(zip(names, one.states[-1].tolist(), strict=True))
    sigmas = dict(zip(names, one.state_sigmas[-1].tolist(), strict=True))
    kept = [name for name in names[s.LEARNT] if not name.startswith("unused")]
    return {
        "nis": {name: sensor.nis_per_degree for name, sensor in health.sensors.items()},
        "rejected": health.rejections(),
        "standstill_updates": health.standstill_updates,
        "final_parameters": {name: final[name] for name in kept},
        "final_parameter_sigmas": {name: sigmas[name] for name in kept},
    }


def _series(comparison: Comparison) -> Results:
    """Decimated time series, all on the same times."""
    log = comparison.log
    first = next(iter(comparison.runs.values()))
    picks = np.unique(
        np.linspace(0, len(first.stamps) - 1, min(SERIES_POINTS, len(first.stamps))).astype(int)
    )
    stamps = first.stamps[picks]
    series: Results = {"t_s": _rounded((stamps - log.start) * NANOSECOND), "variants": {}}
    truth_poses = None
    if log.truth is not None:
        inside = np.clip(stamps, log.truth.poses.stamps[0], log.truth.poses.stamps[-1])
        truth_poses = interpolate_poses(log.truth.poses, inside)
        series["truth"] = _pose_columns(truth_poses) | _true_indices(log.truth, stamps)
    if log.fixes is not None:
        series["fixes"] = {
            "t_s": _rounded((log.fixes.stamps - log.start) * NANOSECOND),
            "x_m": _rounded(log.fixes.poses[:, 0]),
            "y_m": _rounded(log.fixes.poses[:, 1]),
        }
    for name, one in comparison.runs.items():
        rows = np.minimum(np.searchsorted(one.stamps, stamps), len(one.stamps) - 1)
        poses, covariances = one.trajectory.poses[rows], one.trajectory.pose_covariances[rows]
        columns = _pose_columns(poses) | {
            "position_sigma_m": _rounded(_largest_sigma(covariances)),
            "yaw_sigma_rad": _rounded(np.sqrt(covariances[:, 2, 2])),
            "zeta_m": _rounded(one.indices[rows, 0]),
            "epsilon_m": _rounded(one.indices[rows, 1]),
            "eta": _rounded(one.indices[rows, 2]),
        }
        if truth_poses is not None:
            apart = poses - truth_poses
            columns["position_error_m"] = _rounded(np.hypot(apart[:, 0], apart[:, 1]))
            columns["yaw_error_rad"] = _rounded(np.asarray(wrap_angle(apart[:, 2])))
        series["variants"][name] = columns
    return series


def _true_indices(truth: Truth, stamps: Stamps) -> Results:
    """Indices of the true motion by (1) to (3) and (17) to (19), up to the gauge of eta."""
    if truth.twists is None or truth.tracks is None:
        return {}
    columns = [
        _nearest(truth.twists.stamps, truth.twists.twists, stamps),
        _nearest(truth.tracks.stamps, truth.tracks.speeds, stamps),
    ]
    (v_x, v_y, w), (V_l, V_r) = columns[0].T, columns[1].T
    with np.errstate(divide="ignore", invalid="ignore"):
        icrs = icrs_from_twist(V_l, V_r, PaperTwist(-v_y, v_x, w))
    turning = np.abs(w) >= LEAST_YAW_RATE
    shown = Icrs(*(np.where(turning, value, np.nan) for value in icrs))
    zeta, epsilon, width = indices_from_icrs(shown, 1.0)
    return {
        "zeta_m": _rounded(zeta),
        "epsilon_m": _rounded(epsilon),
        "icr_distance_m": _rounded(width),
    }


def _nearest(known: Stamps, values: Floats, wanted: Stamps) -> Floats:
    after = np.clip(np.searchsorted(known, wanted), 1, len(known) - 1)
    closer = np.where(known[after] - wanted < wanted - known[after - 1], after, after - 1)
    return np.asarray(values[closer])


def _largest_sigma(covariances: Floats) -> Floats:
    """Standard deviation (n,) of the position along its least certain direction [m]."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]))


def _pose_columns(poses: Floats) -> Results:
    return {
        "x_m": _rounded(poses[:, 0]),
        "y_m": _rounded(poses[:, 1]),
        "yaw_rad": _rounded(poses[:, 2]),
    }


def _rounded(values: ArrayLike) -> list[float | None]:
    """Numbers to five significant digits, NaN as None: these series are for pictures."""
    return [
        float(f"{value:.5g}") if math.isfinite(value) else None
        for value in np.asarray(values, dtype=float).tolist()
    ]


def _clean(value: Any) -> Any:
    """The same without NaN and infinity, which JSON does not have, and without numpy's types."""
    if isinstance(value, dict):
        return {key: _clean(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _digest(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder in the order of their names."""
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return f"sha256:{digest.hexdigest()}"
