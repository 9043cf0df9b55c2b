"""Picture of the page of several logs: drift of each variant, log by log."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from types import SimpleNamespace as Named
from typing import Any

from icreckon.replay.base.colours import colour_of, on_dark
from icreckon.replay.comparison.results import Results
from icreckon.report.replay.many_text import horizon_of
from icreckon.report.replay.page_text import filtered, horizon_text, interval_text, number

# Heights of a row's label, of a variant in it, and of what lies between rows [px].
LABEL, LINE, BETWEEN = 20, 11, 10


def drift_picture(results: Results) -> SimpleNamespace | None:
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
            said = f"{name}: {number(value)} %{interval_text(interval, '95 % interval ')}"
            mark = Named(at=place(value), interval=ends, y=y, variant=variants[name], text=said)
            marks.append(mark)
        rows.append(Named(label=heading, y=top + LABEL - 6, is_pooled=is_pooled, marks=marks))
        top += LABEL + LINE * len(of) + BETWEEN
    title = f"Drift {horizon_text(label)}, % of the distance, with 95 % intervals"
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
        for name, one in filtered({"variants": variants}).items()
        if one.get(f"{key}_mean")
    }


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers 1, 2, 5, 10, ... around a range."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    every = [round_ * 10.0**power for power in powers for round_ in (1.0, 2.0, 5.0)]
    first = max(place for place, tick in enumerate(every) if tick <= low * (1.0 + 1e-9))
    last = min(place for place, tick in enumerate(every) if tick > high)
    return every[first : last + 1]
