"""Tables of a comparison for the terminal, made from its results only."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from icreckon.replay.checking.check import OF_ROBOT_FILE
from icreckon.replay.comparison.results import Results
from icreckon.report.replay.page_text import (
    CHECK_HINT,
    doubts,
    failures,
    filtered,
    has_yaw_errors,
    headline,
    is_spatial,
    lag_text,
    level_text,
    lowest,
    rejections_text,
)

# Heading, key, digits.
SCORE_COLUMNS = (
    ("drift 10 s\n% of distance", "drift_percent_10s_mean", 2),
    ("drift 30 s\n% of distance", "drift_percent_30s_mean", 2),
    ("drift 60 s\n% of distance", "drift_percent_60s_mean", 2),
    ("yaw drift\ndeg/m", "yaw_drift_deg_per_m", 3),
    ("RMSE v_x\nmm/s", "rmse_v_x_m_s", 1),
    ("RMSE v_y\nmm/s", "rmse_v_y_m_s", 1),
    ("RMSE w\nmrad/s", "rmse_w_rad_s", 1),
    ("NEES pose\nideal 3", "nees_pose_mean", 1),
)
# Of a truth without headings.
POSITION_COLUMNS = (
    *SCORE_COLUMNS[:3],
    ("error at end\nm", "final_position_error_m", 2),
    ("NEES position\nideal 2", "nees_position_mean", 1),
)
DIFFERENCE_COLUMNS = (
    ("distance\nm", "distance_m", 1),
    ("end x\nm", "end_x_m", 2),
    ("end y\nm", "end_y_m", 2),
    ("end yaw\ndeg", "end_yaw_deg", 1),
    ("own sigma\nat end, m", "end_sigma_m", 2),
    ("end apart\nm", "end_apart_m", 2),
    ("apart 30 s\n% of distance", "apart_percent_30s_mean", 2),
    ("end yaw\napart, deg", "end_yaw_apart_deg", 1),
)
# Of a truth in three dimensions.
SPATIAL_COLUMNS = (
    ("roll\nRMS deg", "rms_roll_deg", 2),
    ("pitch\nRMS deg", "rms_pitch_deg", 2),
    ("height drift\n30 s, %", "height_drift_percent_30s_mean", 2),
    ("height error\nat end, m", "final_height_error_m", 2),
    ("own sigma\nat end, m", "final_height_sigma_m", 2),
)
THOUSANDTHS = ("rmse_",)
# Columns of a terminal that is too narrow for all of them, and its width [characters].
NARROW = (
    "drift_percent_30s_mean",
    "final_position_error_m",
    "nees_pose_mean",
    "nees_position_mean",
    "end_x_m",
    "end_y_m",
    "end_yaw_deg",
    "end_sigma_m",
    "apart_percent_30s_mean",
)
WIDE_FROM = 125


def results_table(results: Results, *, narrow: bool = False) -> Group:
    """Verdict and scores of all variants, with footnotes on the log.

    Args:
        results: results of a comparison.
        narrow: leave columns out, so that 80 characters are enough.
    """
    truth = results["truth"]
    columns: Sequence[tuple[str, str, int]] = SCORE_COLUMNS if truth else DIFFERENCE_COLUMNS
    if truth and not has_yaw_errors(results):
        columns = POSITION_COLUMNS
    if narrow:
        columns = [column for column in columns if column[1] in NARROW]
    # NEES has an ideal, and no lowest that is best.
    compared = [key for _, key, _ in columns if truth and not key.startswith("nees")]
    tables = [_table(results, _title(results), columns, compared)]
    if is_spatial(results):
        compared = [key for _, key, _ in SPATIAL_COLUMNS[:3]]
        tables.append(_table(results, "Height, roll and pitch", SPATIAL_COLUMNS, compared))
    doubtful = [f"- {one}" for one in doubts(results)]
    if doubtful:
        doubtful = [
            "The robot file does not fit this log, and all figures are with it:",
            *doubtful,
            f"{CHECK_HINT}.",
            "",
        ]
    return Group(
        *(Text(line, style="bold yellow") for line in doubtful),
        Text(headline(results)),
        Text(),
        *tables,
        *(Text(line) for line in _footnotes(results)),
    )


def _table(
    results: Results,
    title: str,
    columns: Sequence[tuple[str, str, int]],
    compared: Sequence[str],
) -> Table:
    """Table of scores; the lowest of the compared ones are bold."""
    table = Table(title=title, title_justify="left")
    table.add_column("variant", no_wrap=True)
    for heading, _, _ in columns:
        table.add_column(heading, justify="right")
    best = {key: lowest(results["variants"], key) for key in compared}
    for name, scores in results["variants"].items():
        cells = [
            _cell(scores.get(key), key, digits, is_best=best.get(key) == name)
            for _, key, digits in columns
        ]
        table.add_row(name, *cells)
    for name in results["failed"]:
        error = Text("ERROR", style="bold red")
        table.add_row(name, *(error for _ in columns))
    return table


def _title(results: Results) -> str:
    log, truth = results["log"], results["truth"]
    title = f"{log['name']}: {log['duration_s']:.0f} s"
    if truth:
        title += f", {truth['distance_m']:.0f} m, truth: {truth['source']}"
    return title


def _footnotes(results: Results) -> list[str]:
    log, truth = results["log"], results["truth"]
    lines = failures(results)
    if truth is None:
        lines.append(f"No ground truth: apart means from {results['reference_variant']}.")
    else:
        parts = ", ".join(f"{start:.0f} to {end:.0f} s" for start, end in truth["scored_s"])
        drifts = "Drift and yaw drift" if has_yaw_errors(results) else "Drift"
        lines.append(f"{drifts}: without fixes, {parts or 'nowhere long enough'}.")
        if truth["lag_s"] != 0.0 or any(truth["lever_arm_m"]):
            x, y = truth["lever_arm_m"]
            lines.append(
                f"Taken out of the truth: {lag_text(truth)}, "
                f"a lever arm of {x:.2f} m forward and {y:.2f} m left (scores: each variant's own)."
            )
        if is_spatial(results):
            lines.append(level_text(results))
    lines += [f"Dropped from the log: {count} x {what}" for what, count in log["dropped"].items()]
    lines += [f"Note: {note}" for note in log["notes"] if not note.startswith(OF_ROBOT_FILE)]
    for name, one in filtered(results).items():
        if one["rejected"]:
            lines.append(f"Rejected by {name}: {rejections_text(one)}")
    return lines


def _cell(value: float | None, key: str, digits: int, *, is_best: bool) -> Text:
    if value is None:
        return Text("-")
    if key.startswith(THOUSANDTHS):
        value *= 1e3
    return Text(f"{value:.{digits}f}", style="bold" if is_best else "")
