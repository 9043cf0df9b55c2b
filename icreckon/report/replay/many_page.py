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
from icreckon.report.replay.page_text import number

HORIZONS = ("10s", "30s", "60s")
# Heights of a row's label, of a variant in it, and of what lies between rows [px].
LABEL, LINE, BETWEEN = 20, 11, 10


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
        check_hint=page_text.CHECK_HINT,
        headline=many_text.many_headline(results),
        remarks=many_text.many_remarks(results),
        drifts=drift_picture(results),
        ratios=_ratios(results),
        parts=[_part(results, robot) for robot in robots],
        head=_head(results),
        logs=[_row(results, one) for one in results["logs"]],
        horizon=page_text.horizon_text(many_text.horizon_of(results)),
        configuration=results["configuration"],
        robots=results["robots"],
        origin={key: results[key] for key in ("versions", "inputs", "format")},
    )


def _part(results: Results, robot: str) -> Named:
    """Scores of a robot file over all logs."""
    found = results["pooled"][robot]
    title = "All logs together" + (f", {robot}" if len(results["pooled"]) > 1 else "")
    if not found["logs"]:
        nothing = "No log has a ground truth: there is nothing to score."
        return Named(title=title, notes=[nothing], tables=[])
    of = {key: results[key] for key in ("horizons", "baseline_variant")} | {
        "variants": found["variants"]
    }
    notes = [
        f"Position error over {pooled_over(found)}, aligned at each segment's start: summed errors over "
        "summed distances, with 95 % intervals over blocks of all logs.",
        *left_out(found),
    ]
    tables = [*drift_tables(of), _consistency(found["variants"])]
    return Named(title=title, notes=notes, tables=tables)


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
        head = ["variant", *(page_text.horizon_text(label) for label in labels)]
        title = f"Drift with {robot} over that with {found['to']}, on the same segments"
        tables.append(Table(title, head, rows))
    return tables


def _names(results: Results) -> list[str]:
    return list(dict.fromkeys(name for one in results["logs"] for name in one["variants"]))


def _head(results: Results) -> list[str]:
    robot = ["robot"] if len(results["pooled"]) > 1 else []
    return ["log", *robot, "duration, s", "distance, m", *_names(results)]


def _row(results: Results, one: Results) -> Named:
    """Length of a log, and the drift of all variants in it."""
    key = f"drift_percent_{many_text.horizon_of(results)}_mean"
    best = page_text.lowest(one["variants"], key) if one["truth"] else None
    robot = [Cell(one["robot"], "text")] if len(results["pooled"]) > 1 else []
    distance = Cell(number(one["truth"]["distance_m"]) if one["truth"] else "no truth")
    cells = [
        Cell(number(one["variants"].get(name, {}).get(key)), "best" if name == best else "")
        for name in _names(results)
    ]
    cells = [*robot, Cell(f"{one['log']['duration_s']:.0f}"), distance, *cells]
    return Named(folder=one["folder"], label=one["label"], cells=cells)


def drift_picture(results: Results) -> Named | None:
    """Rows of marks over a logarithmic axis, all logs first; None without scores.

    Places along the axis are in %, heights in px; ticks are places and texts.
    """
    label = horizon_of(results)
    drifts = {
        (heading, is_pooled): found
        for heading, is_pooled, of in _rows(results)
        if (found := _drifts(of, label))
    }
    if not drifts:
        return None
    edges = [
        edge
        for of in drifts.values()
        for value, interval in of.values()
        for edge in (value, *(interval or ()))
        if edge > 0.0
    ]
    ticks = _ticks(min(edges), max(edges))
    low, whole = ticks[0], math.log(ticks[-1] / ticks[0])

    def place(value: float) -> float:
        return round(100.0 * math.log(max(value, low) / low) / whole, 2)

    names = list(dict.fromkeys(name for of in drifts.values() for name in of))
    variants = {
        name: Named(name=name, light=colour_of(name), dark=on_dark(colour_of(name)))
        for name in names
    }
    rows, top = [], 0
    for (heading, is_pooled), of in drifts.items():
        marks = []
        for at, (name, (value, interval)) in enumerate(of.items()):
            y = top + LABEL + LINE * at + LINE // 2
            ends = None if interval is None else (place(interval[0]), place(interval[1]))
            said = f"{name}: {number(value)} %{page_text.interval_text(interval, '95 % interval ')}"
            mark = Named(at=place(value), interval=ends, y=y, variant=variants[name], text=said)
            marks.append(mark)
        rows.append(Named(label=heading, y=top + LABEL - 6, is_pooled=is_pooled, marks=marks))
        top += LABEL + LINE * len(of) + BETWEEN
    title = f"Drift {page_text.horizon_text(label)}, % of the distance, with 95 % intervals"
    labelled = [(place(tick), f"{tick:g} %") for tick in ticks]
    every = list(variants.values())
    return Named(title=title, height=top, ticks=labelled, rows=rows, variants=every)


def _rows(results: Results) -> Iterator[tuple[str, bool, Mapping[str, Any]]]:
    """Heading of each row, True for all logs together, and its variants."""
    logs, several = results["logs"], len(results["pooled"]) > 1
    if len({one["label"] for one in logs}) > 1:
        for robot, found in results["pooled"].items():
            yield f"all logs, {robot}" if several else "all logs", True, found["variants"]
    for one in logs:
        yield f"{one['label']}, {one['robot']}" if several else one["label"], False, one["variants"]


def _drifts(variants: Mapping[str, Any], label: str) -> dict[str, tuple[float, list[float] | None]]:
    """Drift of each filter that has one, with its interval [%]."""
    key = f"drift_percent_{label}"
    return {
        name: (one[f"{key}_mean"], one[f"{key}_95"])
        for name, one in page_text.filtered({"variants": variants}).items()
        if one.get(f"{key}_mean")
    }


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers 1, 2, 5, 10, ... around a range."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    every = [round_ * 10.0**power for power in powers for round_ in (1.0, 2.0, 5.0)]
    first = max(place for place, tick in enumerate(every) if tick <= low * (1.0 + 1e-9))
    last = min(place for place, tick in enumerate(every) if tick > high)
    return every[first : last + 1]
