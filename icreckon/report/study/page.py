"""Self-contained HTML page of a study."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from typing import Any

from icreckon.report.study.figures import Figure
from icreckon.report.study.text import (
    ERROR,
    TextTable,
    failures,
    headline,
    notes,
    same_results,
    summary_tables,
)
from icreckon.simulation.study.results import Results

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0 auto;
  padding: 1rem; max-width: 60rem; }
h1 { font-size: 1.5rem; line-height: 1.2; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin-top: 2rem; }
.failures { border-left: 4px solid #b00020; background: #fdecee; padding: .5rem .8rem; }
p.alike { border-left: 4px solid #b36b00; background: #fff6e5; padding: .5rem .8rem; }
.failures li, td.error { overflow-wrap: anywhere; }
td.error { color: #b00020; text-align: left; white-space: normal; }
.headline { font-size: 1.1rem; border-left: 4px solid #0072B2; padding-left: .8rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .6rem; text-align: right; white-space: nowrap; }
th { border-bottom: 2px solid #444; vertical-align: bottom; white-space: normal; }
th.text, td.text { text-align: left; }
tr.first td { border-top: 1px solid #bbb; }
figure { margin: 1.5rem 0; }
img { max-width: 100%; height: auto; }
figcaption, .note { color: #555; font-size: .9rem; }
pre { font-size: .8rem; background: #f5f5f5; padding: .8rem; overflow-x: auto; }
""".strip()


def study_page(results: Results, figures: Sequence[Figure]) -> str:
    """Render the page as HTML.

    Args:
        results: output of `simulation.study.results.study_results`.
        figures: figures of these results.
    """
    name = html.escape(results["name"])
    described = html.escape(results["description"].strip())
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{name}</title>",
        f"<style>\n{STYLE}\n</style></head><body>",
        f"<h1>{name}</h1>",
        f"<p>{described}</p>" if described else "",
        _failures(failures(results)),
        *(f'<p class="alike">{html.escape(line)}</p>' for line in same_results(results)),
        f'<p class="headline">{html.escape(headline(results))}</p>',
        *(_table(one) for one in summary_tables(results)),
        *(f'<p class="note">{html.escape(line)}</p>' for line in notes(results)),
        "<h2>Figures</h2>",
        *(_figure(one) for one in figures),
        "<h2>Configuration</h2>",
        _details("The study, with all that it leaves at its default", results["configuration"]),
        _details("Versions, seed and engine", _provenance(results)),
        "</body></html>",
    ]
    return "\n".join(part for part in parts if part) + "\n"


def _failures(lines: Sequence[str]) -> str:
    if not lines:
        return ""
    items = "".join(f"<li>{html.escape(line)}</li>" for line in lines[1:])
    return (
        f'<div class="failures" role="alert"><strong>{html.escape(lines[0])}</strong>'
        f"<ul>{items}</ul></div>"
    )


def _table(table: TextTable) -> str:
    head = "".join(
        f'<th class="text">{html.escape(one)}</th>'
        if number < table.texts
        else f"<th>{html.escape(one)}</th>"
        for number, one in enumerate(table.head)
    )
    rows = []
    for row in table.rows:
        first = ' class="first"' if row[0] else ""
        words = "".join(f'<td class="text">{html.escape(one)}</td>' for one in row[: table.texts])
        numbers = "".join(f"<td>{html.escape(one)}</td>" for one in row[table.texts :])
        if row[table.texts].startswith(ERROR):
            span = len(row) - table.texts
            error = html.escape(row[table.texts])
            numbers = f'<td class="error" colspan="{span}">{error}</td>'
        cells = words + numbers
        rows.append(f"<tr{first}>{cells}</tr>")
    body = "\n".join(rows)
    return (
        f"<h2>Results {html.escape(table.title)}</h2>\n"
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>'
        "</div>"
    )


def _figure(figure: Figure) -> str:
    data = base64.b64encode(figure.png).decode()
    caption = html.escape(figure.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _details(summary: str, data: Any) -> str:
    text = html.escape(json.dumps(_given(data), indent=1, ensure_ascii=False))
    return f"<details><summary>{html.escape(summary)}</summary><pre>{text}</pre></details>"


def _given(data: Any) -> Any:
    """Remove keys without content."""
    if not isinstance(data, dict):
        return data
    nested = {key: _given(value) for key, value in data.items()}
    return {key: value for key, value in nested.items() if value not in (None, {}, [])}


def _provenance(results: Results) -> dict[str, Any]:
    kept = ("versions", "seed", "engine", "runs", "true_motions", "format")
    return {key: results[key] for key in kept}
