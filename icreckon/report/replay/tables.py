"""Tables of a comparison for the terminal, made from its results only."""

from collections.abc import Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from icreckon.replay.base.errors import OF_ROBOT_FILE, OF_STAMPS, coarse_stamps
from icreckon.replay.comparison.results import Results
from icreckon.report.replay import page_text
from icreckon.report.replay.page_text import CHECK_HINT, arm_text, lag_text, lowest, nees_text

Column = tuple[str, str, int]
# Heading, key, digits.
BANNERS = (OF_ROBOT_FILE, OF_STAMPS)
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
# On the page alone.
END_COLUMNS = (
    ("error at end\nm", "final_position_error_m", 2),
    ("error at end\ndeg", "final_yaw_error_deg", 1),
)
# Of a truth without headings.
POSITION_COLUMNS = (
    *SCORE_COLUMNS[:3],
    END_COLUMNS[0],
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
# Columns that a narrow terminal has first, and the width that has room for all [characters].
IMPORTANT = (
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


def results_table(results: Results, *, narrow: int = 0) -> Group:
    """Verdict and scores of all variants, with footnotes on the log.

    `narrow` is the width of a terminal without room for all columns [characters]; 0 for all.
    """
    truth = results["truth"]
    columns: Sequence[Column] = SCORE_COLUMNS if truth else DIFFERENCE_COLUMNS
    if truth and not page_text.has_yaw_errors(results):
        columns = POSITION_COLUMNS
    columns = _filled(results, columns)
    if narrow:
        columns = _fitting(results, columns, narrow)
    # NEES has an ideal, and no lowest that is best.
    compared = [key for _, key, _ in columns if truth and not key.startswith("nees")]
    tables = [_table(results, _title(results), columns, compared)]
    if page_text.is_spatial(results):
        compared = [key for _, key, _ in SPATIAL_COLUMNS[:3]]
        tables.append(_table(results, "Height, roll and pitch", SPATIAL_COLUMNS, compared))
    coarse = coarse_stamps(results["log"]["notes"])
    doubtful = [f"- {one}" for one in page_text.doubts(results)]
    if doubtful:
        doubtful = [
            "The robot file does not fit this log, and all figures are with it:",
            *doubtful,
            f"{CHECK_HINT}.",
            "",
        ]
    return Group(
        *(Text(line, style="bold yellow") for line in (*coarse, *doubtful)),
        Text(page_text.headline(results)),
        *(Text(line, style="yellow") for line in page_text.calibration_hint(results)),
        Text(),
        *tables,
        *(Text(line) for line in _footnotes(results)),
    )


def _filled(results: Results, columns: Sequence[Column]) -> list[Column]:
    """Columns with values, and that of the verdict's horizon."""
    found = results["verdict"]
    if found is not None:
        key = f"drift_percent_{found['horizon']}_mean"
        if key not in [one for _, one, _ in columns]:
            number, unit = found["horizon"][:-1], found["horizon"][-1]
            columns = [(f"drift {number} {unit}\n% of distance", key, 2), *columns]
    variants = results["variants"].values()
    return [one for one in columns if any(of.get(one[1]) is not None for of in variants)]


def _fitting(results: Results, columns: Sequence[Column], width: int) -> list[Column]:
    """Columns that fit a width [characters], the most important ones, in their order."""
    found = results["verdict"]
    first = (f"drift_percent_{found['horizon']}_mean",) if found else ()
    keys = [key for _, key, _ in columns]
    order = [key for key in dict.fromkeys((*first, *IMPORTANT, *keys)) if key in keys]
    left = width - max(map(len, (*results["variants"], *results["failed"], "variant"))) - 4
    kept = set()
    for heading, key, digits in sorted(columns, key=lambda one: order.index(one[1])):
        cells = [
            _cell(one.get(key), key, digits, is_best=False).plain
            for one in results["variants"].values()
        ]
        left -= max(map(len, (*heading.split("\n"), *cells))) + 3
        if left < 0:
            break
        kept.add(key)
    return [one for one in columns if one[1] in kept]


def _table(
    results: Results, title: str, columns: Sequence[Column], compared: Sequence[str]
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
    lines = page_text.failures(results)
    if truth is None:
        lines.append(f"No ground truth: apart means from {results['reference_variant']}.")
    else:
        parts = ", ".join(f"{start:.0f}-{end:.0f} s" for start, end in truth["scored_s"])
        lines.append(f"Scored without fixes: {parts or 'nowhere long enough'}.{nees_text(results)}")
        if truth["lag_s"] != 0.0 or any(truth["lever_arm_m"]):
            lines.append(f"Truth corrected before scoring: {lag_text(truth)}, {arm_text(results)}.")
        if page_text.is_spatial(results):
            lines.append(page_text.level_text(results))
    lines += [f"Dropped from the log: {count} x {what}" for what, count in log["dropped"].items()]
    lines += [f"Note: {note}" for note in log["notes"] if not note.startswith(BANNERS)]
    return lines + page_text.all_rejections(results)


def _cell(value: float | None, key: str, digits: int, *, is_best: bool) -> Text:
    if value is None:
        return Text("-")
    if key.startswith(THOUSANDTHS):
        value *= 1e3
    return Text(f"{value:.{digits}f}", style="bold" if is_best else "")
