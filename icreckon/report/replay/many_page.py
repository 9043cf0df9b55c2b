"""HTML page of several logs or robot files, made from their results only."""

import math
from collections.abc import Iterator, Mapping
from types import SimpleNamespace as Named
from typing import Any

from icreckon.replay.base.colours import colour_of, on_dark
from icreckon.replay.comparison.results import Results
from icreckon.report.pages import Cell, Table, render
from icreckon.report.replay import many_text, page_text
from icreckon.report.replay.many_text import horizon_of, left_out, pooled_over
from icreckon.report.replay.page import drift_tables, interval_cell
from icreckon.report.replay.page_text import interval_text, number

HORIZONS = ("10s", "30s", "60s")
# Heights of a row's label, of a variant's mark in it, and of the space between rows [px].
LABEL_HEIGHT, MARK_HEIGHT, ROW_SPACE = 20, 11, 10


def many_page(results: Results) -> str:
    """Render the page as HTML, from `summarise_many` with the folder of each log."""
    robots, logs = list(results["pooled"]), {log["label"] for log in results["logs"]}
    logs_text = next(iter(logs)) if len(logs) == 1 else f"{len(logs)} logs"
    robot_head = ["robot"] if len(robots) > 1 else []
    # Variants of any log, in their order, each once.
    names = list(dict.fromkeys(name for log in results["logs"] for name in log["variants"]))
    return render(
        "many.html",
        title=f"{' and '.join(robots)} on {logs_text}",
        subtitle=f"icreckon {results['command']}",
        failures=many_text.many_failures(results),
        doubts=many_text.many_doubts(results),
        check_hint=page_text.CHECK_HINT,
        headline=many_text.many_headline(results),
        remarks=many_text.many_remarks(results),
        drifts=drift_picture(results),
        ratios=_ratio_tables(results),
        parts=[_robot_section(results, robot) for robot in robots],
        head=["log", *robot_head, "duration, s", "distance, m", *names],
        logs=[_log_row(results, log, names) for log in results["logs"]],
        horizon=page_text.horizon_text(horizon_of(results)),
        results=results,
        origin={key: results[key] for key in ("versions", "inputs", "format")},
    )


def _robot_section(results: Results, robot: str) -> Named:
    """Section of a robot file: title, notes and tables of its scores over all logs."""
    pooled = results["pooled"][robot]
    title = "All logs together" + (f", {robot}" if len(results["pooled"]) > 1 else "")
    if not pooled["logs"]:
        nothing = "No log has a ground truth: there is nothing to score."
        return Named(title=title, notes=[nothing], tables=[])
    notes = [
        f"Position error over {pooled_over(pooled)}, aligned at each segment's start: summed errors over "
        "summed distances, with 95 % intervals over blocks of all logs.",
        *left_out(pooled),
    ]
    tables = drift_tables(results | {"variants": pooled["variants"]})
    return Named(title=title, notes=notes, tables=[*tables, _nees_table(pooled["variants"])])


def _nees_table(variants: dict[str, Any]) -> Table:
    """NEES of poses and positions, if there is any, and numbers of logs and segments."""
    headings = {"nees_pose": "pose NEES, ideal 3", "nees_position": "position NEES, ideal 2"}
    keys = [key for key in headings if any(scores[f"{key}_poses"] for scores in variants.values())]
    head = ["variant", *(headings[key] for key in keys), "logs"]
    head += [f"segments of {label[:-1]} s" for label in HORIZONS]
    rows = []
    for name, scores in variants.items():
        cells = [Cell(number(scores[f"{key}_mean"])) for key in keys]
        segments = [scores.get(f"drift_segments_{label}", 0) for label in HORIZONS]
        rows.append((name, [*cells, *(Cell(str(count)) for count in (scores["logs"], *segments))]))
    return Table("NEES over all poses, and what the figures rest on", head, rows)


def _ratio_tables(results: Results) -> list[Table]:
    """Drift with each robot file over that with the first, at horizons with any ratio."""
    tables = []
    for robot, ratios in results["ratios"].items():
        variants = ratios["variants"]
        labels = [
            label
            for label in results["horizons"]
            if any(scores[f"ratio_{label}"] is not None for scores in variants.values())
        ]
        rows = []
        for name, scores in variants.items():
            keys = [f"ratio_{label}" for label in labels]
            rows.append((name, [interval_cell(scores[key], scores[f"{key}_95"]) for key in keys]))
        head = ["variant", *map(page_text.horizon_text, labels)]
        title = f"Drift with {robot} over that with {ratios['to']}, on the same segments"
        tables.append(Table(title, head, rows))
    return tables


def _log_row(results: Results, log: Results, names: list[str]) -> Named:
    """Length of a log, and the drift of the variants `names` in it."""
    key = f"drift_percent_{horizon_of(results)}_mean"
    truth = log["truth"]
    best = page_text.lowest(log["variants"], key) if truth else None
    robot = [Cell(log["robot"], "text")] if len(results["pooled"]) > 1 else []
    duration = Cell(f"{log['log']['duration_s']:.0f}")
    distance = Cell(number(truth["distance_m"]) if truth else "no truth")
    drifts = [
        Cell(number(log["variants"].get(name, {}).get(key)), "best" if name == best else "")
        for name in names
    ]
    cells = [*robot, duration, distance, *drifts]
    return Named(folder=log["folder"], label=log["label"], cells=cells)


def drift_picture(results: Results) -> Named | None:
    """Rows of marks over a logarithmic axis, all logs first; None without scores.

    Places along the axis are in %, heights in px; ticks are places and texts.
    """
    horizon = horizon_of(results)
    key = f"drift_percent_{horizon}"
    row_drifts, edges = [], []
    for heading, is_pooled, variants in _picture_rows(results):
        # Drift of each filter that has one, with its interval [%].
        drifts: dict[str, tuple[float, list[float] | None]] = {
            name: (scores[f"{key}_mean"], scores[f"{key}_95"])
            for name, scores in page_text.filtered(variants).items()
            if scores.get(f"{key}_mean")
        }
        if drifts:
            row_drifts.append((heading, is_pooled, drifts))
        for drift, interval in drifts.values():
            edges += [drift, *(interval or ())]
    if not row_drifts:
        return None
    edges = [edge for edge in edges if edge > 0.0]
    ticks = _ticks(min(edges), max(edges))
    low, *_, high = ticks

    def place(drift: float) -> float:
        return round(100.0 * math.log(max(drift, low) / low) / math.log(high / low), 2)

    legend: dict[str, Named] = {}
    rows, top = [], 0
    for heading, is_pooled, drifts in row_drifts:
        marks = []
        for line, (name, (drift, interval)) in enumerate(drifts.items()):
            light = colour_of(name)
            legend.setdefault(name, Named(name=name, light=light, dark=on_dark(light)))
            y = top + LABEL_HEIGHT + MARK_HEIGHT * line + MARK_HEIGHT // 2
            ends = None if interval is None else tuple(map(place, interval))
            text = f"{name}: {number(drift)} %{interval_text(interval)}"
            mark = Named(at=place(drift), interval=ends, y=y, variant=legend[name], text=text)
            marks.append(mark)
        y = top + LABEL_HEIGHT - 6
        rows.append(Named(label=heading, y=y, is_pooled=is_pooled, marks=marks))
        top += LABEL_HEIGHT + MARK_HEIGHT * len(drifts) + ROW_SPACE
    title = f"Drift {page_text.horizon_text(horizon)}, % of the distance, with 95 % intervals"
    labelled = [(place(tick), f"{tick:g} %") for tick in ticks]
    names = list(legend.values())
    return Named(title=title, height=top, ticks=labelled, rows=rows, variants=names)


def _picture_rows(results: Results) -> Iterator[tuple[str, bool, Mapping[str, Any]]]:
    """Heading of each row, whether it is of all logs together, and its variants."""
    logs, several = results["logs"], len(results["pooled"]) > 1
    if len({log["label"] for log in logs}) > 1:
        for robot, pooled in results["pooled"].items():
            yield f"all logs, {robot}" if several else "all logs", True, pooled["variants"]
    for log in logs:
        heading = f"{log['label']}, {log['robot']}" if several else log["label"]
        yield heading, False, log["variants"]


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers 1, 2, 5, 10, ... around a range; the first is at most `low`."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [digit * 10.0**power for power in powers for digit in (1.0, 2.0, 5.0)]
    # A tick that equals `low` but for rounding counts as reached.
    first = max(index for index, tick in enumerate(ticks) if tick <= low * (1.0 + 1e-9))
    last = min(index for index, tick in enumerate(ticks) if tick > high)
    return ticks[first : last + 1]
