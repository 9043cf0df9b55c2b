"""Self-contained HTML page of a study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from icreckon.report.pages import Picture, render
from icreckon.report.study import text as study_text
from icreckon.simulation.study.results import Results

PROVENANCE = ("versions", "seed", "engine", "runs", "true_motions", "format")


def study_page(results: Results, figures: Sequence[Picture]) -> str:
    """Render the page as HTML."""
    return render(
        "study.html",
        title=results["name"],
        subtitle=results["description"].strip(),
        failures=study_text.failures(results),
        same_results=study_text.same_results(results),
        headline=study_text.headline(results),
        tables=study_text.summary_tables(results),
        error=study_text.ERROR,
        notes=study_text.notes(results),
        figures=figures,
        configuration=_given(results["configuration"]),
        provenance=_given({key: results[key] for key in PROVENANCE}),
    )


def _given(data: Any) -> Any:
    """Remove keys without content."""
    if not isinstance(data, dict):
        return data
    nested = {key: _given(value) for key, value in data.items()}
    return {key: value for key, value in nested.items() if value not in (None, {}, [])}
