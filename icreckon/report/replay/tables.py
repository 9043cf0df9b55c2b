"""Tables of a comparison for the terminal, made from its results only."""

from collections.abc import Sequence
from typing import NamedTuple

from rich.console import Group
from rich.table import Table
from rich.text import Text

from icreckon.replay.base.errors import OF_ROBOT_FILE, OF_STAMPS, coarse_stamps
from icreckon.replay.comparison.results import Results
from icreckon.report.replay import page_text
from icreckon.report.replay.page_text import CHECK_HINT, lowest, nees_text


class Column(NamedTuple):
    """Column of a table of scores."""

    heading: str
    key: str  # of a variant's scores
    decimals: int
    is_important: bool = False  # kept on a narrow terminal before others


BANNERS = (OF_ROBOT_FILE, OF_STAMPS)  # prefixes of notes that are banners above the table
SCORE_COLUMNS = (
    Column("drift 10 s\n% of distance", "drift_percent_10s_mean", 2),
    Column("drift 30 s\n% of distance", "drift_percent_30s_mean", 2, True),
    Column("drift 60 s\n% of distance", "drift_percent_60s_mean", 2),
    Column("yaw drift\ndeg/m", "yaw_drift_deg_per_m", 3),
    Column("RMSE v_x\nmm/s", "rmse_v_x_m_s", 1),
    Column("RMSE v_y\nmm/s", "rmse_v_y_m_s", 1),
    Column("RMSE w\nmrad/s", "rmse_w_rad_s", 1),
    Column("NEES pose\nideal 3", "nees_pose_mean", 1, True),
)
# On the page alone.
END_COLUMNS = (
    Column("error at end\nm", "final_position_error_m", 2, True),
    Column("error at end\ndeg", "final_yaw_error_deg", 1),
)
# Of a truth without headings.
POSITION_COLUMNS = (
    *SCORE_COLUMNS[:3],
    END_COLUMNS[0],
    Column("NEES position\nideal 2", "nees_position_mean", 1, True),
)
DIFFERENCE_COLUMNS = (
    Column("distance\nm", "distance_m", 1),
    Column("end x\nm", "end_x_m", 2, True),
    Column("end y\nm", "end_y_m", 2, True),
    Column("end yaw\ndeg", "end_yaw_deg", 1, True),
    Column("own sigma\nat end, m", "end_sigma_m", 2, True),
    Column("end apart\nm", "end_apart_m", 2),
    Column("apart 30 s\n% of distance", "apart_percent_30s_mean", 2, True),
    Column("end yaw\napart, deg", "end_yaw_apart_deg", 1),
)
# Of a truth in three dimensions.
SPATIAL_COLUMNS = (
    Column("roll\nRMS deg", "rms_roll_deg", 2),
    Column("pitch\nRMS deg", "rms_pitch_deg", 2),
    Column("height drift\n30 s, %", "height_drift_percent_30s_mean", 2),
    Column("height error\nat end, m", "final_height_error_m", 2),
    Column("own sigma\nat end, m", "final_height_sigma_m", 2),
)
WIDE_FROM = 125  # width of a terminal from which on a table has all columns [characters]


def results_table(results: Results, *, narrow: int = 0) -> Group:
    """Verdict and scores of all variants, with footnotes on the log.

    `narrow` is the width of a terminal without room for all columns [characters]; 0 for all.
    """
    log, truth = results["log"], results["truth"]
    title = f"{log['name']}: {log['duration_s']:.0f} s"
    if truth:
        title += f", {truth['distance_m']:.0f} m, truth: {truth['source']}"
    columns: Sequence[Column] = SCORE_COLUMNS if truth else DIFFERENCE_COLUMNS
    if truth and not page_text.has_yaw_errors(results):
        columns = POSITION_COLUMNS
    columns = _with_values(results, columns)
    if narrow:
        columns = _fitting(results, columns, narrow)
    # NEES has an ideal, and no lowest that is best; differences have no best at all.
    compared = [column.key for column in columns if truth and not column.key.startswith("nees")]
    tables = [_table(results, title, columns, compared)]
    if page_text.is_spatial(results):
        # Its last columns, the height at the end and its sigma, are not compared.
        compared = [column.key for column in SPATIAL_COLUMNS[:3]]
        tables.append(_table(results, "Height, roll and pitch", SPATIAL_COLUMNS, compared))
    banners = list(coarse_stamps(log["notes"]))
    doubts = page_text.doubts(results)
    if doubts:
        banners.append("The robot file does not fit this log, and all figures are with it:")
        banners += [*(f"- {doubt}" for doubt in doubts), f"{CHECK_HINT}.", ""]
    return Group(
        *(Text(line, style="bold yellow") for line in banners),
        Text(page_text.headline(results)),
        *(Text(line, style="yellow") for line in page_text.calibration_hint(results)),
        Text(),
        *tables,
        *(Text(line) for line in _footnotes(results)),
    )


def _with_values(results: Results, columns: Sequence[Column]) -> list[Column]:
    """Columns with a value of any variant, and the drift of the verdict's horizon."""
    key = _verdict_key(results)
    if key and key not in [column.key for column in columns]:
        horizon = page_text.seconds_text(results["verdict"]["horizon"])
        columns = [Column(f"drift {horizon}\n% of distance", key, 2), *columns]
    variants = results["variants"].values()
    known = {key for scores in variants for key, value in scores.items() if value is not None}
    return [column for column in columns if column.key in known]


def _verdict_key(results: Results) -> str:
    """Key of the drift of the verdict; empty without a verdict."""
    verdict = results["verdict"]
    return f"drift_percent_{verdict['horizon']}_mean" if verdict else ""


def _fitting(results: Results, columns: Sequence[Column], width: int) -> list[Column]:
    """Columns that fit a width [characters], the most important ones, in their order."""
    first = _verdict_key(results)
    names = (*results["variants"], *results["failed"], "variant")
    # Borders and padding: 4 characters for the names, 3 for each other column.
    room = width - max(map(len, names)) - 4
    kept = set()
    for column in sorted(
        columns, key=lambda column: (column.key != first, not column.is_important)
    ):
        cells = [_cell(scores, column, is_best=False) for scores in results["variants"].values()]
        texts = [*column.heading.split("\n"), *(cell.plain for cell in cells)]
        room -= max(map(len, texts)) + 3
        if room < 0:
            break
        kept.add(column.key)
    return [column for column in columns if column.key in kept]


def _table(
    results: Results, title: str, columns: Sequence[Column], compared: Sequence[str]
) -> Table:
    """Table of scores; the lowest of the scores `compared` (keys) are bold."""
    table = Table(title=title, title_justify="left")
    table.add_column("variant", no_wrap=True)
    for column in columns:
        table.add_column(column.heading, justify="right")
    best = {key: lowest(results["variants"], key) for key in compared}
    for name, scores in results["variants"].items():
        cells = [_cell(scores, column, is_best=best.get(column.key) == name) for column in columns]
        table.add_row(name, *cells)
    for name in results["failed"]:
        table.add_row(name, *[Text("ERROR", style="bold red")] * len(columns))
    return table


def _footnotes(results: Results) -> list[str]:
    """Failures, truth and its corrections, notes on the log, rejections."""
    log, truth = results["log"], results["truth"]
    lines = page_text.failures(results)
    if truth is None:
        lines.append(f"No ground truth: apart means from {results['reference_variant']}.")
    else:
        spans = ", ".join(f"{start:.0f}-{end:.0f} s" for start, end in truth["scored_s"])
        lines.append(f"Scored without fixes: {spans or 'nowhere long enough'}.{nees_text(results)}")
        if correction := page_text.truth_correction(results):
            lines.append(f"Truth corrected before scoring: {correction}.")
        if page_text.is_spatial(results):
            lines.append(page_text.level_text(results))
    lines += [f"Dropped from the log: {count} x {what}" for what, count in log["dropped"].items()]
    lines += [f"Note: {note}" for note in log["notes"] if not note.startswith(BANNERS)]
    return lines + page_text.all_rejections(results) + page_text.fault_lines(results)


def _cell(scores: Results, column: Column, *, is_best: bool) -> Text:
    """Score of a variant, bold if the best; a dash if it has none."""
    value = scaled(scores.get(column.key), column.key)
    if value is None:
        return Text("-")
    return Text(f"{value:.{column.decimals}f}", style="bold" if is_best else "")


def scaled(value: float | None, key: str) -> float | None:
    """Score of a key in the unit of its heading: RMSE in mm/s and mrad/s."""
    return 1e3 * value if value is not None and key.startswith("rmse_") else value
