"""Results of a calibration as plain data: the content of `results.json`."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from icreckon.estimator.calibration import Calibration
from icreckon.estimator.calibration.result import OfLog
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.robot_check import far_centre
from icreckon.replay.checking.worth import HORIZONS, VARIANT, mean_drift
from icreckon.replay.comparison.known_bias import GYRO
from icreckon.replay.comparison.results import FORMAT, Results, digest, versions

Read = tuple[Sequence[Log], Robot]  # logs, and the robot file that they were read with


def summarise_calibration(
    found: Calibration,
    logs: list[Log],
    headline: str,
    *,
    configuration: dict[str, Any],
    inputs: dict[str, Path],
) -> Results:
    """Summarise a calibration as the content of results.json, for tables and figure."""
    comparison, residuals = found.comparison, found.residuals
    correlations = np.round(found.correlations, 4).tolist()
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
        "supported_model": comparison.supported,
        "parameters": {
            parameter.name: {
                "value": parameter.value,
                "sigma": parameter.sigma,
                "sigma_other_logs": parameter.sigma_other_logs,
                "interval_95": None if parameter.interval is None else list(parameter.interval),
                "unit": parameter.unit,
                "status": parameter.status,
                "before": parameter.before,
                "before_is_default": parameter.is_default,
                "note": parameter.note,
            }
            for parameter in found.parameters
        },
        "correlations": {"names": list(found.correlation_names), "matrix": correlations},
        "models": {
            scores.model: {
                "parameters_found": scores.parameters,
                "held_out_drift_percent": scores.drift_percent,
                "held_out_drift_percent_interval_95": [scores.drift_low, scores.drift_high],
                "held_out_drift_with_gyro_percent": scores.drift_with_gyro_percent,
                "held_out_log_likelihood_per_segment": scores.log_likelihood,
            }
            for scores in comparison.scores
        },
        "differences": [
            {
                "model": pair.model,
                "than": pair.than,
                "held_out_drift_percent": pair.drift,
                "held_out_drift_percent_interval_95": [pair.drift_low, pair.drift_high],
                "held_out_log_likelihood_per_segment": pair.log_likelihood,
                "held_out_log_likelihood_per_segment_interval_95": [
                    pair.log_likelihood_low,
                    pair.log_likelihood_high,
                ],
            }
            for pair in comparison.differences
        ],
        "validation": {
            "blocks": comparison.blocks,
            "folds": comparison.folds,
            "longest_window_s": comparison.window,
            "distance_m": comparison.distance,
        },
        "logs": [_log_summary(*pair) for pair in zip(found.logs, logs, strict=True)],
        "robot": msgspec.to_builtins(found.robot),
        "series": {
            "t_s": residuals.seconds.round(3).tolist(),
            "turned_rad": residuals.turning.round(5).tolist(),
            "before": residuals.before.round(6).tolist(),
            "after": residuals.after.round(6).tolist(),
        },
    }


def headline(before: Read, after: Read, progress: Callable[[float], None]) -> str:
    """Drift of filters with the robot file before and after the calibration."""
    drifts = []
    for (logs, robot), variant in ((before, VARIANT), (after, VARIANT), (after, GYRO)):
        drifts.append(mean_drift(logs, robot, variant, HORIZONS[0]))
        progress(len(drifts) / 3)
    drift_before, drift_after, gyro_drift = drifts
    if not math.isfinite(drift_after):
        return "The filters have no drift to score on these logs."
    logs_text = "the log" if len(after[0]) == 1 else f"the {len(after[0])} logs"
    start = f" ({drift_before:.2f} % with the file before)" if math.isfinite(drift_before) else ""
    is_more = drift_after > drift_before
    warning = " That is more than before: compare both files on other logs." if is_more else ""
    return (
        f"{VARIANT} drifts {drift_after:.2f} % of the distance after {HORIZONS[0]:g} s with these values"
        f"{start}, wheels + gyro {gyro_drift:.2f} %, on {logs_text} of this calibration.{warning}"
    )


def _log_summary(found: OfLog, log: Log) -> Results:
    """Results of a log: what the calibration found, and what was dropped in reading."""
    bias, bias_sigma = found.gyro_bias
    lag, lag_sigma = found.lag or (None, None)
    return {
        "name": found.name,
        "duration_s": log.duration,
        "gyro_bias_rad_s": bias,
        "gyro_bias_sigma_rad_s": bias_sigma,
        "truth_lag_s": lag,
        "truth_lag_sigma_s": lag_sigma,
        "moving_segments": found.segments,
        "still_segments": found.still,
        "distance_m": found.distance,
        "dropped": log.dropped,
        "notes": list(log.notes),
    }
