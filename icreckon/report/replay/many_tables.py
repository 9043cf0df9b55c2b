"""Tables of several logs for the terminal, made from their results only."""

from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from icreckon.replay.comparison.results import Results
from icreckon.report.replay import many_text
from icreckon.report.replay.page_text import CHECK_HINT, lowest, seconds_text

HORIZONS = ("10s", "30s")
DOES_NOT_FIT = "A robot file does not fit a log, and all figures of it are with it"


def many_tables(results: Results, *, narrow: bool = False) -> Group:
    """Group of warnings, verdict, tables (all logs, robot files, each log), remarks.

    `results` are those of `summarise_many`; narrow tables omit columns to fit 80 characters.
    """
    parts: list[Any] = []
    doubts = many_text.many_doubts(results)
    if doubts:
        warning = [f"{DOES_NOT_FIT}:", *(f"- {doubt}" for doubt in doubts), f"{CHECK_HINT}.", ""]
        parts += [Text(line, style="bold yellow") for line in warning]
    parts += [Text(many_text.many_headline(results)), Text()]
    if any(pooled["logs"] for pooled in results["pooled"].values()):
        parts.append(_pooled_table(results, narrow=narrow))
    if any(ratios["variants"] for ratios in results["ratios"].values()):
        parts.append(_ratio_table(results))
    parts.append(_log_table(results))
    parts += map(Text, many_text.many_failures(results))
    for pooled in results["pooled"].values():
        parts += map(Text, many_text.left_out(pooled))
    parts += map(Text, many_text.many_remarks(results))
    return Group(*parts)


def _pooled_table(results: Results, *, narrow: bool) -> Table:
    """Drift, ratio to the baseline and NEES over all logs, by robot file and variant."""
    robots, baseline = results["pooled"], results["baseline_variant"]
    # A log may have a truth with one robot file, and none with another that cannot read it.
    extents = {many_text.pooled_over(pooled) for pooled in robots.values()}
    title = "All logs together" + (f": {min(extents)}" if len(extents) == 1 else "")
    table = Table(title=title, title_justify="left")
    table.add_column("variant", no_wrap=True)
    for horizon in HORIZONS:
        table.add_column(f"drift\n{seconds_text(horizon)}\n%", justify="right")
        if not narrow:
            table.add_column("95 %", justify="right", no_wrap=True)
    ratio_horizons = HORIZONS[1:] if narrow else HORIZONS
    for horizon in ratio_horizons:
        table.add_column(f"ratio to\n{baseline}\n{seconds_text(horizon)}", justify="right")
        table.add_column("95 %", justify="right", no_wrap=True)
    all_scores = [scores for pooled in robots.values() for scores in pooled["variants"].values()]
    has_poses = any(scores["nees_pose_poses"] for scores in all_scores)
    has_positions = any(scores["nees_position_poses"] for scores in all_scores)
    kind, ideal = ("position", 2) if has_positions and not has_poses else ("pose", 3)
    table.add_column(f"NEES\nideal\n{ideal}", justify="right")
    table.add_column("segments\n30 s", justify="right")
    for robot, pooled in robots.items():
        if len(robots) > 1:
            table.add_section()
            table.add_row(Text(robot, style="bold"))
        for name, scores in pooled["variants"].items():
            cells = []
            for horizon in HORIZONS:
                key = f"drift_percent_{horizon}"
                is_best = name == lowest(pooled["variants"], f"{key}_mean")
                cells.append(_value(scores.get(f"{key}_mean"), is_best=is_best))
                if not narrow:
                    cells.append(_interval(scores.get(f"{key}_95")))
            for horizon in ratio_horizons:
                key = f"drift_ratio_{horizon}"
                interval = None if name == baseline else scores.get(f"{key}_95")
                cells += [_value(scores.get(key)), _interval(interval)]
            cells.append(_value(scores[f"nees_{kind}_mean"], digits=1))
            cells.append(Text(str(scores.get("drift_segments_30s", "-"))))
            table.add_row(name, *cells)
    return table


def _ratio_table(results: Results) -> Table:
    """Ratio of drift with each robot file to that with the first."""
    first_robot = next(iter(results["pooled"]))
    table = Table(title=f"Drift over that with {first_robot}, same segments", title_justify="left")
    table.add_column("variant", no_wrap=True)
    for horizon in HORIZONS:
        table.add_column(f"ratio\n{seconds_text(horizon)}", justify="right")
        table.add_column("95 %", justify="right", no_wrap=True)
    table.add_column("segments\n30 s", justify="right")
    for robot, ratios in results["ratios"].items():
        table.add_section()
        table.add_row(Text(robot, style="bold"))
        for name, ratio in ratios["variants"].items():
            cells = []
            for key in (f"ratio_{horizon}" for horizon in HORIZONS):
                cells += [_value(ratio[key]), _interval(ratio[f"{key}_95"])]
            table.add_row(name, *cells, str(ratio["segments_30s"]))
    return table


def _log_table(results: Results) -> Table:
    """One row for each log: its length, and the variant with the least drift."""
    horizon = many_text.horizon_of(results)
    several_robots = len(results["pooled"]) > 1
    table = Table(title="Each log", title_justify="left")
    table.add_column("log", overflow="fold")
    if several_robots:
        table.add_column("robot", overflow="fold")
    table.add_column("s", justify="right")
    table.add_column("m", justify="right")
    table.add_column(f"least drift, {seconds_text(horizon)}", no_wrap=True)
    table.add_column("%", justify="right")
    for log in results["logs"]:
        key = f"drift_percent_{horizon}_mean"
        truth = log["truth"]
        best = lowest(log["variants"], key) if truth else None
        table.add_row(
            log["label"],
            *([log["robot"]] if several_robots else []),
            f"{log['log']['duration_s']:.0f}",
            _value(truth["distance_m"] if truth else None, digits=0),
            best or ("too short" if truth else "no ground truth"),
            _value(log["variants"][best][key] if best else None),
        )
    return table


def _value(value: float | None, *, digits: int = 2, is_best: bool = False) -> Text:
    return Text("-" if value is None else f"{value:.{digits}f}", style="bold" if is_best else "")


def _interval(interval: list[float] | None) -> Text:
    return Text("" if interval is None else "{:.2f} to {:.2f}".format(*interval))
