"""Results of a calibration as plain data: the content of `results.json`."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from icreckon.estimator.calibration import Calibration
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.robot_check import far_centre
from icreckon.replay.checking.worth import HORIZONS, VARIANT, mean_drift
from icreckon.replay.comparison.known_bias import GYRO
from icreckon.replay.comparison.results import FORMAT, Results, digest, versions

Read = tuple[Sequence[Log], Robot]


def summarise_calibration(
    found: Calibration,
    logs: list[Log],
    headline: str,
    *,
    configuration: dict[str, Any],
    inputs: dict[str, Path],
) -> Results:
    """Summarise a calibration for tables and figure."""
    return {
        "format": FORMAT,
        "command": "calibrate",
        "configuration": configuration,
        "seed": None,
        "versions": versions(),
        "inputs": {name: digest(path) for name, path in inputs.items()},
        "headline": headline,
        "verdict": found.verdict,
        "notes": [*found.notes, *far_centre(found.robot)],
        "supported_model": found.comparison.supported,
        "parameters": {
            one.name: {
                "value": one.value,
                "sigma": one.sigma,
                "sigma_other_logs": one.sigma_other_logs,
                "interval_95": None if one.interval is None else list(one.interval),
                "unit": one.unit,
                "status": one.status,
                "before": one.before,
                "before_is_default": one.is_default,
                "note": one.note,
            }
            for one in found.parameters
        },
        "correlations": {
            "names": list(found.correlation_names),
            "matrix": np.round(found.correlations, 4).tolist(),
        },
        "models": {
            one.model: {
                "parameters_found": one.parameters,
                "held_out_drift_percent": one.drift_percent,
                "held_out_drift_percent_interval_95": [one.drift_low, one.drift_high],
                "held_out_drift_with_gyro_percent": one.drift_with_gyro_percent,
                "held_out_log_likelihood_per_segment": one.log_likelihood,
            }
            for one in found.comparison.scores
        },
        "differences": [
            {
                "model": one.model,
                "than": one.than,
                "held_out_drift_percent": one.drift,
                "held_out_drift_percent_interval_95": [one.drift_low, one.drift_high],
                "held_out_log_likelihood_per_segment": one.log_likelihood,
                "held_out_log_likelihood_per_segment_interval_95": [
                    one.log_likelihood_low,
                    one.log_likelihood_high,
                ],
            }
            for one in found.comparison.differences
        ],
        "validation": {
            "blocks": found.comparison.blocks,
            "folds": found.comparison.folds,
            "longest_window_s": found.comparison.window,
            "distance_m": found.comparison.distance,
        },
        "logs": [_of_log(one, log) for one, log in zip(found.logs, logs, strict=True)],
        "robot": msgspec.to_builtins(found.robot),
        "series": {
            "t_s": found.residuals.seconds.round(3).tolist(),
            "turned_rad": found.residuals.turning.round(5).tolist(),
            "before": found.residuals.before.round(6).tolist(),
            "after": found.residuals.after.round(6).tolist(),
        },
    }


def headline(before: Read, after: Read, progress: Callable[[float], None]) -> str:
    """Drift of filters with the robot file before and after the calibration."""
    logs, found = len(after[0]), []
    for read, variant in ((before, VARIANT), (after, VARIANT), (after, GYRO)):
        found.append(mean_drift(*read, variant, HORIZONS[0]))
        progress(len(found) / 3)
    if not math.isfinite(found[1]):
        return "The filters have no drift to score on these logs."
    of_logs = "the log" if logs == 1 else f"the {logs} logs"
    start = f" ({found[0]:.2f} % with the file before)" if math.isfinite(found[0]) else ""
    return (
        f"{VARIANT} drifts {found[1]:.2f} % of the distance after {HORIZONS[0]:g} s with these values"
        f"{start}, wheels + gyro {found[2]:.2f} %, on {of_logs} of this calibration."
        + (
            " That is more than before: compare both files on other logs."
            if found[1] > found[0]
            else ""
        )
    )


def _of_log(one: Any, log: Log) -> Results:
    return {
        "name": one.name,
        "duration_s": log.duration,
        "gyro_bias_rad_s": one.gyro_bias[0],
        "gyro_bias_sigma_rad_s": one.gyro_bias[1],
        "truth_lag_s": None if one.lag is None else one.lag[0],
        "truth_lag_sigma_s": None if one.lag is None else one.lag[1],
        "moving_segments": one.segments,
        "still_segments": one.still,
        "distance_m": one.distance,
        "dropped": log.dropped,
        "notes": list(log.notes),
    }
