"""Tables of a calibration for the terminal, made from its results only."""

from __future__ import annotations

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from icreckon.replay.comparison.results import Results

STATUS = {
    "shown": "shown",
    "conditional": "shown, given what is held",
    "held": "not shown: held",
}
# Correlation from which two estimates can hardly be separated.
STRONG_CORRELATION = 0.9


def calibration_tables(results: Results) -> Group:
    """Parameters, logs, models, and the verdict."""
    return Group(
        _parameters(results), _logs(results), _models(results), *map(Text, _footnotes(results))
    )


def _parameters(results: Results) -> Table:
    table = Table(title=f"parameters of {results['robot']['name']}", title_justify="left")
    table.add_column("parameter", no_wrap=True)
    for heading in ("value", "standard\nerror", "unit", "before"):
        table.add_column(heading, justify="right")
    table.add_column("the logs")
    for name, one in results["parameters"].items():
        status = STATUS[one["status"]] + (f"; {one['note']}" if one["note"] else "")
        table.add_row(
            name,
            _number(one["value"]),
            "" if one["sigma"] is None else f"{one['sigma']:.2g}",
            one["unit"],
            "" if one["before"] is None else _number(one["before"]),
            status,
        )
    return table


def _lag(log: Results) -> str:
    if log["truth_lag_s"] is None:
        return "not found"
    return f"{log['truth_lag_s']:.3f} ± {log['truth_lag_sigma_s']:.3f}"


def _logs(results: Results) -> Table:
    table = Table(title="logs", title_justify="left")
    table.add_column("log", no_wrap=True)
    for heading in ("gyro bias\nrad/s", "truth late\ns", "distance\nm", "segments\nmoving, still"):
        table.add_column(heading, justify="right")
    for one in results["logs"]:
        table.add_row(
            one["name"],
            f"{one['gyro_bias_rad_s']:.5f} ± {one['gyro_bias_sigma_rad_s']:.5f}",
            _lag(one),
            f"{one['distance_m']:.0f}",
            f"{one['moving_segments']}, {one['still_segments']}",
        )
    return table


def _models(results: Results) -> Table:
    table = Table(title="models, predicting what they were not fitted to", title_justify="left")
    table.add_column("model", no_wrap=True)
    for heading in (
        "parameters\nfound",
        "held-out drift, tracks alone\n% of distance, 95 %",
        "with the gyro\n% of distance",
        "log likelihood\nof a segment",
    ):
        table.add_column(heading, justify="right")
    for name, one in results["models"].items():
        low, high = one["held_out_drift_percent_interval_95"]
        table.add_row(
            f"{name} *" if name == results["supported_model"] else name,
            str(one["parameters_found"]),
            f"{one['held_out_drift_percent']:.2f} ({low:.2f} to {high:.2f})",
            f"{one['held_out_drift_with_gyro_percent']:.2f}",
            f"{one['held_out_log_likelihood_per_segment']:.2f}",
        )
    return table


def _footnotes(results: Results) -> list[str]:
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
    return [*lines, "", results["verdict"]]


def _number(value: float) -> str:
    return f"{value:.5g}"
