"""Tables and page of a calibration, made from its results only."""

import math

import numpy as np
from rich.console import Group
from rich.text import Text

from icreckon.replay.comparison.results import Results
from icreckon.report.pages import Cell, Picture, Table, render, unless_missing
from icreckon.report.terminal import rich_table

STATUS = {
    "shown": "shown",
    "conditional": "shown, if the held ones are right",
    "held": "held, not shown",
}
WIDE_FROM = 120  # width of a terminal from which on tables have all columns [characters]
STRONG_CORRELATION = 0.9  # correlation from which two estimates can hardly be separated
ORIGIN = ("versions", "inputs", "format")


def calibration_tables(results: Results, *, narrow: bool) -> Group:
    """Verdict, models, parameters and logs, for the terminal.

    `results` are those of `summarise_calibration`; narrow tables omit columns to fit 80 characters.
    """
    makers = (model_table, parameter_table, log_table)
    tables = [rich_table(make(results, narrow=narrow), narrow=narrow) for make in makers]
    lines = map(Text, (results["verdict"], *footnotes(results)))
    return Group(Text(results["headline"], style="bold"), *tables, *lines)


def parameter_table(results: Results, *, narrow: bool = False) -> Table:
    """Value, standard error and status of each parameter."""
    rows = []
    for name, parameter in results["parameters"].items():
        note = f"; {parameter['note']}" if parameter["note"] else ""
        in_file = "" if parameter["before"] is None else f"{parameter['before']:.5g}"
        if in_file and parameter["before_is_default"] and not narrow:
            in_file += " (= default)"
        # Standard errors for the given logs and for others, in one cell if narrow.
        errors = ["", ""]
        if parameter["sigma"] is not None:
            errors = [f"{parameter[key]:#.2g}" for key in ("sigma", "sigma_other_logs")]
        if narrow:
            errors = ["/".join(dict.fromkeys(errors))]
        value = _rounded_to_error(parameter["value"], parameter["sigma"])
        cells = [Cell(text) for text in (value, *errors, parameter["unit"], in_file)]
        rows.append((name, [*cells, Cell(STATUS[parameter["status"]] + note, "wrap")]))
    head = [
        "parameter",
        "value",
        "standard\nerror",
        "on other\nlogs",
        "unit",
        "robot file",
        "the logs",
    ]
    if narrow:
        head = ["parameter", "value", "error/on\nother logs", "unit", "robot\nfile", "the logs"]
    return Table(f"parameters of {results['robot']['name']}", head, rows)


def log_table(results: Results, *, narrow: bool = False) -> Table:
    """Gyro bias, lag of the truth and size of each log."""
    rows = []
    for log in results["logs"]:
        lag = "not found"
        if log["truth_lag_s"] is not None:
            lag = f"{log['truth_lag_s']:.3f} ± {log['truth_lag_sigma_s']:.3f}"
        texts = [
            log["name"],
            f"{log['gyro_bias_rad_s']:.5f} ± {log['gyro_bias_sigma_rad_s']:.5f}",
            lag,
            f"{log['distance_m']:.0f}",
            f"{log['moving_segments']}, {log['still_segments']}",
        ]
        rows.append(texts)
    head = ["log", "gyro bias\nrad/s", "truth late\ns", "distance\nm", "segments\nmoving, still"]
    return _text_table("logs", head, rows, narrow=narrow)


def _text_table(title: str, head: list[str], rows: list[list[str]], *, narrow: bool) -> Table:
    """Table of texts, without its last column if narrow."""
    if narrow:
        head, rows = head[:-1], [row[:-1] for row in rows]
    return Table(title, head, [(name, list(map(Cell, texts))) for name, *texts in rows])


def model_table(results: Results, *, narrow: bool = False) -> Table:
    """Held-out scores of each model; the supported one has a star."""
    rows = []
    for name, scores in results["models"].items():
        low, high = scores["held_out_drift_percent_interval_95"]
        texts = [
            f"{name} *" if name == results["supported_model"] else name,
            str(scores["parameters_found"]),
            f"{scores['held_out_drift_percent']:.2f} ({low:.2f} to {high:.2f})",
            f"{scores['held_out_drift_with_gyro_percent']:.2f}",
            f"{scores['held_out_log_likelihood_per_segment']:.2f}",
        ]
        rows.append(texts)
    head = [
        "model",
        "parameters\nfound",
        "held-out drift, tracks alone\n% of distance, 95 %",
        "with the gyro\n% of distance",
        "log likelihood\nof a segment",
    ]
    title = "models, predicting what they were not fitted to; * the one that the logs support"
    return _text_table(title, head, rows, narrow=narrow)


def footnotes(results: Results) -> list[str]:
    """Validation, correlated parameters, and notes on calibration and logs."""
    validation = results["validation"]
    lines = [
        f"Held out: {validation['folds']} folds of {validation['blocks']} blocks of contiguous time, "
        f"windows of up to {validation['longest_window_s']:.0f} s, {validation['distance_m']:.0f} m."
    ]
    names, matrix = results["correlations"]["names"], np.array(results["correlations"]["matrix"])
    # Each pair once: below the diagonal.
    strong_pairs = np.argwhere(np.tril(np.abs(matrix) >= STRONG_CORRELATION, k=-1))
    if len(strong_pairs):
        texts = [f"{names[i]} and {names[j]} ({matrix[i, j]:+.2f})" for i, j in strong_pairs]
        lines.append(f"Hardly separable, by their correlation: {', '.join(texts)}.")
    lines += [f"Note: {note}" for note in results["notes"]]
    lines += [f"{log['name']}: {note}" for log in results["logs"] for note in log["notes"]]
    return lines


def _rounded_to_error(value: float, sigma: float | None) -> str:
    """Value, rounded to the second digit of its standard error."""
    if not value or not sigma or not math.isfinite(value * sigma):
        return f"{value:.5g}"
    value_power, sigma_power = (math.floor(math.log10(abs(x))) for x in (value, sigma))
    # At least all digits before the decimal point, so that "#g" writes no exponent.
    digits = max(value_power - sigma_power + 2, value_power + 1, 1)
    return f"{value:#.{digits}g}".removesuffix(".").replace(".e", "e")


def calibration_page(results: Results) -> str:
    """Render the page as HTML."""
    logs = results["logs"]
    count = f"{len(logs)} {'log' if len(logs) == 1 else 'logs'}"
    distance = sum(log["distance_m"] for log in logs)
    pictures: list[Picture] = []
    with unless_missing():
        from icreckon.report.calibration.figure import calibration_pictures

        pictures = calibration_pictures(results)
    return render(
        "calibration.html",
        title=f"{results['robot']['name']}, calibrated",
        subtitle=f"icreckon calibrate · {count} · {distance:.0f} m",
        headline=results["headline"],
        remarks=[results["verdict"]],
        pictures=pictures,
        tables=[model_table(results), parameter_table(results), log_table(results)],
        notes=footnotes(results),
        configuration=results["configuration"],
        robot=results["robot"],
        origin={key: results[key] for key in ORIGIN},
    )
