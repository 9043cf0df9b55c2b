"""HTML page of several logs or robot files, made from their results only."""

from __future__ import annotations

from typing import Any, NamedTuple

from icreckon.replay.comparison.results import Results
from icreckon.report.pages import Cell, Table, render
from icreckon.report.replay import many_text
from icreckon.report.replay.many_picture import drift_picture
from icreckon.report.replay.many_text import left_out, pooled_over
from icreckon.report.replay.page import drift_tables, interval_cell
from icreckon.report.replay.page_text import CHECK_HINT, horizon_text, lowest, number

HORIZONS = ("10s", "30s", "60s")


class Part(NamedTuple):
    """Scores of a robot file over all logs: title, notes, tables."""

    title: str
    notes: list[str]
    tables: list[Table]


class LogRow(NamedTuple):
    """Log in the table of all: its page, and its cells."""

    folder: str
    label: str
    cells: list[Cell]


def many_page(results: Results) -> str:
    """Render the page as HTML, from `summarise_many` with the folder of each log."""
    robots, logs = list(results["pooled"]), {one["label"] for one in results["logs"]}
    some = next(iter(logs)) if len(logs) == 1 else f"{len(logs)} logs"
    return render(
        "many.html",
        title=f"{' and '.join(robots)} on {some}",
        subtitle=f"icreckon {results['command']}",
        failures=many_text.many_failures(results),
        doubts=many_text.many_doubts(results),
        check_hint=CHECK_HINT,
        headline=many_text.many_headline(results),
        remarks=many_text.many_remarks(results),
        drifts=drift_picture(results),
        ratios=_ratios(results),
        parts=[_part(results, robot) for robot in robots],
        head=_head(results),
        logs=[_row(results, one) for one in results["logs"]],
        horizon=horizon_text(many_text.horizon_of(results)),
        configuration=results["configuration"],
        robots=results["robots"],
        origin={key: results[key] for key in ("versions", "inputs", "format")},
    )


def _part(results: Results, robot: str) -> Part:
    found = results["pooled"][robot]
    title = "All logs together" + (f", {robot}" if len(results["pooled"]) > 1 else "")
    if not found["logs"]:
        return Part(title, ["No log has a ground truth: there is nothing to score."], [])
    of = {key: results[key] for key in ("horizons", "baseline_variant")} | {
        "variants": found["variants"]
    }
    notes = [
        f"Position error over {pooled_over(found)}, aligned at each segment's start: summed errors over "
        "summed distances, with 95 % intervals over blocks of all logs.",
        *left_out(found),
    ]
    return Part(title, notes, [*drift_tables(of), _consistency(found["variants"])])


def _consistency(variants: dict[str, Any]) -> Table:
    """NEES and numbers of segments."""
    kinds = [
        (heading, key)
        for heading, key in (
            ("pose NEES, ideal 3", "nees_pose"),
            ("position NEES, ideal 2", "nees_position"),
        )
        if any(one[f"{key}_poses"] for one in variants.values())
    ]
    head = ["variant", *(heading for heading, _ in kinds), "logs"]
    head += [f"segments of {label[:-1]} s" for label in HORIZONS]
    rows = []
    for name, one in variants.items():
        cells = [Cell(number(one[f"{key}_mean"])) for _, key in kinds]
        counts = [one["logs"], *(one.get(f"drift_segments_{label}", 0) for label in HORIZONS)]
        rows.append((name, [*cells, *(Cell(str(count)) for count in counts)]))
    return Table("NEES over all poses, and what the figures rest on", head, rows)


def _ratios(results: Results) -> list[Table]:
    """Drift with each robot file over that with the first."""
    tables = []
    for robot, found in results["ratios"].items():
        labels = [
            label
            for label in results["horizons"]
            if any(one[f"ratio_{label}"] is not None for one in found["variants"].values())
        ]
        rows = []
        for name, one in found["variants"].items():
            cells = [
                interval_cell(one[f"ratio_{label}"], one[f"ratio_{label}_95"]) for label in labels
            ]
            rows.append((name, cells))
        head = ["variant", *(horizon_text(label) for label in labels)]
        title = f"Drift with {robot} over that with {found['to']}, on the same segments"
        tables.append(Table(title, head, rows))
    return tables


def _names(results: Results) -> list[str]:
    return list(dict.fromkeys(name for one in results["logs"] for name in one["variants"]))


def _head(results: Results) -> list[str]:
    robot = ["robot"] if len(results["pooled"]) > 1 else []
    return ["log", *robot, "duration, s", "distance, m", *_names(results)]


def _row(results: Results, one: Results) -> LogRow:
    """Length of a log, and the drift of all variants in it."""
    key = f"drift_percent_{many_text.horizon_of(results)}_mean"
    best = lowest(one["variants"], key) if one["truth"] else None
    robot = [Cell(one["robot"], "text")] if len(results["pooled"]) > 1 else []
    distance = Cell(number(one["truth"]["distance_m"]) if one["truth"] else "no truth")
    cells = [
        Cell(number(one["variants"].get(name, {}).get(key)), "best" if name == best else "")
        for name in _names(results)
    ]
    cells = [*robot, Cell(f"{one['log']['duration_s']:.0f}"), distance, *cells]
    return LogRow(one["folder"], one["label"], cells)
