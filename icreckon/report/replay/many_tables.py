"""Tables of several logs for the terminal, made from their results only."""

from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from icreckon.replay.comparison.results import Results
from icreckon.report.replay import many_text
from icreckon.report.replay.page_text import CHECK_HINT, lowest

LABELS = ("10s", "30s")
DOES_NOT_FIT = "A robot file does not fit a log, and all figures of it are with it"


def many_tables(results: Results, *, narrow: bool = False) -> Group:
    """Verdict, scores over all logs, ratios of robot files, and the logs.

    `results` are those of `summarise_many`; narrow tables omit columns to fit 80 characters.
    """
    parts: list[Any] = []
    if doubtful := many_text.many_doubts(results):
        lines = [f"{DOES_NOT_FIT}:", *(f"- {one}" for one in doubtful), f"{CHECK_HINT}.", ""]
        parts += [Text(line, style="bold yellow") for line in lines]
    parts += [Text(many_text.many_headline(results)), Text()]
    if any(found["logs"] for found in results["pooled"].values()):
        parts.append(_pooled(results, narrow=narrow))
    if any(found["variants"] for found in results["ratios"].values()):
        parts.append(_ratios(results))
    parts.append(_logs(results))
    notes = [line for found in results["pooled"].values() for line in many_text.left_out(found)]
    lines = [*many_text.many_failures(results), *notes, *many_text.many_remarks(results)]
    return Group(*parts, *(Text(line) for line in lines))


def _pooled(results: Results, *, narrow: bool) -> Table:
    pooled, baseline = results["pooled"], results["baseline_variant"]
    # A log may have a truth with one robot file, and none with another that cannot read it.
    over = list(dict.fromkeys(map(many_text.pooled_over, pooled.values())))
    title = "All logs together" + (f": {over[0]}" if len(over) == 1 else "")
    table = Table(title=title, title_justify="left")
    table.add_column("variant", no_wrap=True)
    for label in LABELS:
        table.add_column(f"drift\n{_seconds(label)}\n%", justify="right")
        if not narrow:
            table.add_column("95 %", justify="right", no_wrap=True)
    for label in LABELS if not narrow else LABELS[1:]:
        table.add_column(f"ratio to\n{baseline}\n{_seconds(label)}", justify="right")
        table.add_column("95 %", justify="right", no_wrap=True)
    of_positions = _of_positions(results)
    table.add_column(f"NEES\nideal\n{2 if of_positions else 3}", justify="right")
    table.add_column("segments\n30 s", justify="right")
    for robot, found in pooled.items():
        if len(pooled) > 1:
            table.add_section()
            table.add_row(Text(robot, style="bold"))
        best = {label: lowest(found["variants"], f"drift_percent_{label}_mean") for label in LABELS}
        for name, one in found["variants"].items():
            cells = []
            for label in LABELS:
                key = f"drift_percent_{label}"
                cells.append(_value(one.get(f"{key}_mean"), is_best=best[label] == name))
                if not narrow:
                    cells.append(_interval(one.get(f"{key}_95")))
            for label in LABELS if not narrow else LABELS[1:]:
                interval = None if name == baseline else one.get(f"drift_ratio_{label}_95")
                cells += [_value(one.get(f"drift_ratio_{label}")), _interval(interval)]
            nees = one["nees_position_mean" if of_positions else "nees_pose_mean"]
            cells.append(_value(nees, digits=1))
            cells.append(Text(str(one.get("drift_segments_30s", "-"))))
            table.add_row(name, *cells)
    return table


def _of_positions(results: Results) -> bool:
    """Return True if no pose has a NEES, but positions have."""
    rows = [one for found in results["pooled"].values() for one in found["variants"].values()]
    return not any(one["nees_pose_poses"] for one in rows) and any(
        one["nees_position_poses"] for one in rows
    )


def _ratios(results: Results) -> Table:
    """Ratio of drift with each robot file to that with the first."""
    first = next(iter(results["pooled"]))
    table = Table(title=f"Drift over that with {first}, same segments", title_justify="left")
    table.add_column("variant", no_wrap=True)
    for label in LABELS:
        table.add_column(f"ratio\n{_seconds(label)}", justify="right")
        table.add_column("95 %", justify="right", no_wrap=True)
    table.add_column("segments\n30 s", justify="right")
    for robot, found in results["ratios"].items():
        table.add_section()
        table.add_row(Text(robot, style="bold"))
        for name, one in found["variants"].items():
            cells = []
            for label in LABELS:
                cells += [_value(one[f"ratio_{label}"]), _interval(one[f"ratio_{label}_95"])]
            table.add_row(name, *cells, str(one["segments_30s"]))
    return table


def _logs(results: Results) -> Table:
    """One row for each log: its length, and the variant with the least drift."""
    label = many_text.horizon_of(results)
    several = len(results["pooled"]) > 1
    table = Table(title="Each log", title_justify="left")
    table.add_column("log", overflow="fold")
    if several:
        table.add_column("robot", overflow="fold")
    table.add_column("s", justify="right")
    table.add_column("m", justify="right")
    table.add_column(f"least drift, {_seconds(label)}", no_wrap=True)
    table.add_column("%", justify="right")
    for one in results["logs"]:
        key = f"drift_percent_{label}_mean"
        best = lowest(one["variants"], key) if one["truth"] else None
        value = None if best is None else one["variants"][best][key]
        named = [one["label"], one["robot"]] if several else [one["label"]]
        why = "no ground truth" if one["truth"] is None else "too short"
        distance = one["truth"]["distance_m"] if one["truth"] else None
        table.add_row(
            *named,
            f"{one['log']['duration_s']:.0f}",
            _value(distance, digits=0),
            best or why,
            _value(value),
        )
    return table


def _seconds(label: str) -> str:
    return f"{label[:-1]} {label[-1]}"


def _value(value: float | None, *, digits: int = 2, is_best: bool = False) -> Text:
    return Text("-" if value is None else f"{value:.{digits}f}", style="bold" if is_best else "")


def _interval(interval: list[float] | None) -> Text:
    return Text("" if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}")
