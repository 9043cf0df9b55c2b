"""Self-contained HTML page of a comparison, made from its results only."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Sequence
from importlib.resources import files
from itertools import zip_longest
from pathlib import Path
from typing import Any

from icreckon.replay.base.outputs import written_beside
from icreckon.replay.comparison.results import Results
from icreckon.report.replay.page_charts import page_data, switches
from icreckon.report.replay.page_text import (
    failures,
    filtered,
    headline,
    horizon_text,
    notes,
    number,
    provenance,
    remarks,
    scored_text,
)

# Forbid all requests, whatever the names and notes of a log contain.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
SCORES = (
    ("yaw drift, deg/m", "yaw_drift_deg_per_m", 1.0),
    ("RMSE v_x, mm/s", "rmse_v_x_m_s", 1e3),
    ("RMSE v_y, mm/s", "rmse_v_y_m_s", 1e3),
    ("RMSE w, mrad/s", "rmse_w_rad_s", 1e3),
    ("pose NEES, ideal 3", "nees_pose_mean", 1.0),
    ("error at end, m", "final_position_error_m", 1.0),
    ("error at end, deg", "final_yaw_error_deg", 1.0),
)
DIFFERENCES = (
    ("distance, m", "distance_m", 1.0),
    ("end x, m", "end_x_m", 1.0),
    ("end y, m", "end_y_m", 1.0),
    ("end yaw, deg", "end_yaw_deg", 1.0),
    ("own σ at end, m", "end_sigma_m", 1.0),
    ("end apart, m", "end_apart_m", 1.0),
    ("end yaw apart, deg", "end_yaw_apart_deg", 1.0),
)
Cell = tuple[str, str]
"""HTML of a cell of a table, and its class."""


def write_page(path: Path, results: Results, *, overwrite: bool = False) -> Path:
    """Write the page.

    Args:
        path: the file.
        results: output of `replay.comparison.results.summarise`, or content of results.json.
        overwrite: whether an existing file may be replaced.

    Raises:
        ReplayError: the file exists, or cannot be written.
    """
    with written_beside(path, overwrite=overwrite) as new:
        new.write_text(replay_page(results), encoding="utf-8")
    return path


def replay_page(results: Results) -> str:
    """Render the page as HTML; argument as for `write_page`."""
    title = f"{results['robot']['name']} on {results['log']['name']}"
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{html.escape(title)}</title>",
        f"<style>\n{_resource('page.css')}</style></head><body>",
        f"<h1>{html.escape(title)}</h1>",
        _paragraph(provenance(results), "meta"),
        *(_paragraph(line, "failure") for line in failures(results)),
        _paragraph(headline(results), "headline"),
        *(_paragraph(line, "note") for line in remarks(results)),
        "<noscript><p>The charts need JavaScript; the tables do not.</p></noscript>",
        _toggles(results),
        '<h2>Trajectories</h2><div class="charts wide" id="paths"></div>',
        f'<h2>{_errors_title(results)}</h2><div class="charts" id="errors"></div>',
        *_drift_tables(results),
        "<h2>ICRs over time</h2>",
        _paragraph(_icrs_note(results), "note"),
        '<div class="charts small" id="icrs"></div>',
        "<h2>Parameters over time</h2>",
        _paragraph(_parameters_note(results), "note"),
        '<div class="charts small" id="parameters"></div>',
        "<h2>Innovations over time</h2>",
        _paragraph(_innovations_note(results), "note"),
        '<div class="charts" id="innovations"></div>',
        _innovation_table(results),
        "<h2>What was dropped, and why</h2>",
        *_dropped(results),
        "<h2>Notes</h2>",
        _list(notes(results)) or _paragraph("None."),
        "<h2>Configuration</h2>",
        _details("Configuration", results["configuration"]),
        _details("Robot", results["robot"]),
        _details("Versions, seed and hashes of the inputs", _origin(results)),
        '<svg id="pattern" width="0" height="0" aria-hidden="true"></svg>',
        f'<script type="application/json" id="data">{_embedded(page_data(results))}</script>',
        f"<script>\n{_resource('page.js')}</script>",
        "</body></html>",
    ]
    return "\n".join(part for part in parts if part) + "\n"


def _resource(name: str) -> str:
    return files("icreckon.report.replay").joinpath(name).read_text(encoding="utf-8")


def _embedded(data: Any) -> str:
    """JSON that cannot close its enclosing element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _paragraph(text: str, kind: str = "") -> str:
    return f'<p class="{kind}">{html.escape(text)}</p>' if kind else f"<p>{html.escape(text)}</p>"


def _list(lines: Iterable[str]) -> str:
    items = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def _details(summary: str, data: Any) -> str:
    text = html.escape(json.dumps(data, indent=1, ensure_ascii=False))
    return f"<details><summary>{html.escape(summary)}</summary><pre>{text}</pre></details>"


def _toggles(results: Results) -> str:
    boxes = []
    for one in switches(results):
        name, ticked = html.escape(one["name"]), " checked" if one["shown"] else ""
        swatch = "swatch dotted" if one["dash"] else "swatch"
        boxes.append(
            f'<label><input type="checkbox" value="{name}"{ticked}>'
            f'<span class="{swatch}" style="border-color:{one["colour"]}"></span>{name}</label>'
        )
    return f'<div class="toggles">{"".join(boxes)}</div>'


def _errors_title(results: Results) -> str:
    return "Error against distance" if results["truth"] else "Apart against distance"


# --- tables ----------------------------------------------------------------------------------------


def _table(head: Sequence[str], rows: Sequence[tuple[str, Sequence[Cell]]]) -> str:
    """Table with a first column of text; other cells have their own class."""
    kinds = ["text", *(kind for _, kind in rows[0][1])] if rows else []
    top = "".join(
        f'<th class="{kind}">{html.escape(one)}</th>'
        if kind in {"text", "wrap"}
        else f"<th>{html.escape(one)}</th>"
        for one, kind in zip_longest(head, kinds, fillvalue="")
    )
    body = []
    for name, cells in rows:
        cells_html = "".join(
            f'<td class="{kind}">{content}</td>' if kind else f"<td>{content}</td>"
            for content, kind in cells
        )
        body.append(f'<tr><td class="text">{html.escape(name)}</td>{cells_html}</tr>')
    lines = "\n".join(body)
    return (
        f'<div class="scroll"><table><thead><tr>{top}</tr></thead>\n<tbody>\n{lines}\n</tbody></table>'
        "</div>"
    )


def _drift_tables(results: Results) -> list[str]:
    labels, variants = results["horizons"], results["variants"]
    head = ["variant", *(horizon_text(label) for label in labels)]
    if not results["truth"]:
        keys = [f"apart_percent_{label}_mean" for label in labels]
        rows = [
            (name, [(number(one.get(key)), "") for key in keys]) for name, one in variants.items()
        ]
        caption = f"Distance from {results['reference_variant']}, % of the distance driven"
        return [
            "<h2>How far apart per horizon</h2>",
            _paragraph(f"{caption}, aligned at each segment's start.", "note"),
            _table(head, rows),
            "<h2>Ends</h2>",
            _score_table(results, DIFFERENCES),
        ]
    baseline = results["baseline_variant"]
    parts = ["<h2>Drift per horizon</h2>", _paragraph(scored_text(results), "note")]
    for title, key in (
        (
            "% of the distance, with 95 % intervals; bold: the lowest of the filters",
            "drift_percent_{}_mean",
        ),
        (f"Ratio to {baseline}, over the same segments", "drift_ratio_{}"),
    ):
        rows = []
        best = _lowest(results, [key.format(label) for label in labels])
        for name, one in variants.items():
            cells = []
            for label in labels:
                place = key.format(label)
                interval = one.get(f"{place.removesuffix('_mean')}_95")
                if name == baseline and "ratio" in key:
                    interval = None
                value = number(one.get(place))
                is_best = best.get(place) == name and "ratio" not in key
                cells.append((f"{value}{_spread(interval)}", "best" if is_best else ""))
            rows.append((name, cells))
        parts += [_paragraph(title), _table(head, rows)]
    parts += ["<h2>Other scores</h2>", _score_table(results, SCORES)]
    return parts


def _spread(interval: list[float] | None) -> str:
    if interval is None:
        return ""
    low, high = map(number, interval)
    return f'<span class="interval">{low} to {high}</span>'


def _lowest(results: Results, keys: Sequence[str]) -> dict[str, str]:
    best = {}
    for key in keys:
        known = {
            name: one[key] for name, one in filtered(results).items() if one.get(key) is not None
        }
        if known:
            best[key] = min(known, key=lambda name: float(known[name]))
    return best


def _score_table(results: Results, columns: Sequence[tuple[str, str, float]]) -> str:
    rows = [
        (name, [(number(_scaled(one.get(key), factor)), "") for _, key, factor in columns])
        for name, one in results["variants"].items()
    ]
    return _table(["variant", *(heading for heading, _, _ in columns)], rows)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


# --- parameters, innovations, what was dropped -----------------------------------------------------


def _icrs_note(results: Results) -> str:
    sentences = ["In base_link: x forward, y to the left."]
    if "icr_distance_m" in results["series"].get("truth", {}):
        sentences.append("Dots: the truth, while the robot turns.")
    if "differential" in results["variants"]:
        half = 0.5 * results["robot"]["vehicle"]["track_gauge"]
        sentences.append(
            f"Not drawn: differential, whose ICRs are its tracks, at y = ±{number(half)} m."
        )
    return " ".join(sentences)


def _parameters_note(results: Results) -> str:
    if not any(len(one["parameters"]) > 1 for one in results["series"]["variants"].values()):
        return "No variant that was run learns any."
    return (
        "Those that a variant learns, with bands of ±2σ. Lengths and indices are in the paper's axes "
        "(X right, Y forward)."
    )


def _innovations_note(results: Results) -> str:
    if not any(one["innovations"] for one in results["series"]["variants"].values()):
        return "No sensor was judged: there are no innovations."
    return (
        "Measured less expected, over the standard deviation that it should have. Of a filter whose "
        "uncertainty is right, 95 % lie within ±2 (dashed) and 99.7 % within ±3; those beyond ±10 are "
        "not shown."
    )


def _innovation_table(results: Results) -> str:
    names = list(
        dict.fromkeys(
            component
            for one in results["series"]["variants"].values()
            for component in one["innovations"]
        )
    )
    if not names:
        return ""
    rows = []
    for name, one in results["series"]["variants"].items():
        if not one["innovations"]:
            continue
        cells: list[Cell] = []
        for component in names:
            values = one["innovations"].get(component, {}).get("normalised", [])
            known = [abs(value) for value in values if value is not None]
            if not known:
                cells.append(("–", ""))
                continue
            beyond = [100.0 * sum(size > edge for size in known) / len(known) for edge in (2, 3)]
            cells.append((f"{beyond[0]:.1f} %<span class=interval>{beyond[1]:.1f} %</span>", ""))
        rows.append((name, cells))
    title = "Share beyond ±2, and beneath it beyond ±3, of the innovations shown (ideal: 4.6 % and 0.3 %)"
    return _paragraph(title) + _table(["variant", *(one.replace("_", " ") for one in names)], rows)


def _dropped(results: Results) -> list[str]:
    dropped = results["log"]["dropped"]
    lines = [f"{count} × {what}" for what, count in dropped.items()]
    parts = [
        _paragraph("When the log was read:" if lines else "Nothing when the log was read."),
        _list(lines),
        _paragraph("By each filter:"),
    ]
    rows = []
    for name, one in filtered(results).items():
        used = ", ".join(f"{count} × {what}" for what, count in one["used"].items() if count)
        rejected = (
            ", ".join(f"{count} × {what}" for what, count in one["rejected"].items()) or "none"
        )
        nis = ", ".join(f"{what} {number(value)}" for what, value in one["nis"].items() if value)
        cells = [(html.escape(text), "wrap") for text in (used, rejected, nis)]
        cells.append((str(one["standstill_updates"]), ""))
        rows.append((name, cells))
    head = [
        "variant",
        "used",
        "rejected",
        "mean NIS per degree of freedom, ideal 1",
        "standstill updates",
    ]
    return [*parts, _table(head, rows)]


def _origin(results: Results) -> Results:
    return {key: results[key] for key in ("versions", "seed", "inputs", "format")}
