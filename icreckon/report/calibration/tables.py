"""Tables of a calibration for terminal and page, made from its results only."""

from __future__ import annotations

import math

import numpy as np
from rich.console import Group
from rich.text import Text

from icreckon.replay.comparison.results import Results
from icreckon.report.pages import Cell, Table
from icreckon.report.terminal import rich_table

STATUS = {
    "shown": "shown",
    "conditional": "shown, given what is held",
    "held": "not shown: held",
}
# Correlation from which two estimates can hardly be separated.
STRONG_CORRELATION = 0.9


def calibration_tables(results: Results) -> Group:
    """Parameters, logs, models, and the verdict, for the terminal."""
    tables = [parameter_table(results), log_table(results), model_table(results)]
    lines = [*footnotes(results), "", results["verdict"]]
    return Group(*map(rich_table, tables), *map(Text, lines))


def parameter_table(results: Results) -> Table:
    """Value, standard error and status of each parameter."""
    rows = []
    for name, one in results["parameters"].items():
        status = STATUS[one["status"]] + (f"; {one['note']}" if one["note"] else "")
        cells = [
            Cell(_to_error(one["value"], one["sigma"])),
            Cell("" if one["sigma"] is None else f"{one['sigma']:#.2g}"),
            Cell(one["unit"]),
            Cell(_in_file(one)),
            Cell(status, "wrap"),
        ]
        rows.append((name, cells))
    head = ["parameter", "value", "standard\nerror", "unit", "robot file", "the logs"]
    return Table(f"parameters of {results['robot']['name']}", head, rows)


def _in_file(one: Results) -> str:
    """Value in the robot file, and whether it is a default."""
    if one["before"] is None:
        return ""
    return _number(one["before"]) + (" (default)" if one["before_is_default"] else "")


def _lag(log: Results) -> str:
    if log["truth_lag_s"] is None:
        return "not found"
    return f"{log['truth_lag_s']:.3f} ± {log['truth_lag_sigma_s']:.3f}"


def log_table(results: Results) -> Table:
    """Gyro bias, lag of the truth and size of each log."""
    rows = []
    for one in results["logs"]:
        cells = [
            f"{one['gyro_bias_rad_s']:.5f} ± {one['gyro_bias_sigma_rad_s']:.5f}",
            _lag(one),
            f"{one['distance_m']:.0f}",
            f"{one['moving_segments']}, {one['still_segments']}",
        ]
        rows.append((one["name"], list(map(Cell, cells))))
    head = [
        "log",
        "gyro bias\nrad/s",
        "truth late\ns",
        "distance\nm",
        "segments\nmoving, still",
    ]
    return Table("logs", head, rows)


def model_table(results: Results) -> Table:
    """Held-out scores of each model; the supported one has a star."""
    rows = []
    for name, one in results["models"].items():
        low, high = one["held_out_drift_percent_interval_95"]
        cells = [
            str(one["parameters_found"]),
            f"{one['held_out_drift_percent']:.2f} ({low:.2f} to {high:.2f})",
            f"{one['held_out_drift_with_gyro_percent']:.2f}",
            f"{one['held_out_log_likelihood_per_segment']:.2f}",
        ]
        star = f"{name} *" if name == results["supported_model"] else name
        rows.append((star, list(map(Cell, cells))))
    head = [
        "model",
        "parameters\nfound",
        "held-out drift, tracks alone\n% of distance, 95 %",
        "with the gyro\n% of distance",
        "log likelihood\nof a segment",
    ]
    return Table("models, predicting what they were not fitted to", head, rows)


def footnotes(results: Results) -> list[str]:
    """Validation, correlated parameters, notes on the logs."""
    validation = results["validation"]
    lines = [
        f"Held out: {validation['folds']} folds of {validation['blocks']} blocks of contiguous time, "
        f"windows of up to {validation['longest_window_s']:.0f} s, {validation['distance_m']:.0f} m."
    ]
    names, matrix = results["correlations"]["names"], np.array(results["correlations"]["matrix"])
    pairs = [
        f"{names[row]} and {names[column]} ({matrix[row, column]:+.2f})"
        for row in range(len(names))
        for column in range(row)
        if abs(matrix[row, column]) >= STRONG_CORRELATION
    ]
    if pairs:
        lines.append(f"Hardly separable, by their correlation: {', '.join(pairs)}.")
    lines += [f"Note: {note}" for note in results["notes"]]
    lines += [f"{one['name']}: {note}" for one in results["logs"] for note in one["notes"]]
    return lines


def _to_error(value: float, sigma: float | None) -> str:
    """Value, rounded to the second digit of its standard error."""
    if not value or not sigma or not math.isfinite(value * sigma):
        return _number(value)
    before, last = (math.floor(math.log10(abs(one))) for one in (value, sigma))
    digits = max(before - last + 2, before + 1, 1)
    return f"{value:#.{digits}g}".removesuffix(".")


def _number(value: float) -> str:
    return f"{value:.5g}"
