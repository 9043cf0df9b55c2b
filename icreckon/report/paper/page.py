"""Self-contained HTML page of the reproduction, from its results and figures."""

from __future__ import annotations

from pathlib import Path

from icreckon.replay.comparison.results import Results
from icreckon.report.pages import Picture, render
from icreckon.report.paper.tables import all_tables, contradiction_text, counts_text, origin_text

# Figures of a folder, the first at the top of the page; those with panels side by side are wide.
CAPTIONS = {
    "figure": "Differences between the published numbers and the reproduced ones.",
    "figure-3": "Figure 3, redrawn: ICRs of the tracks at the stationary motions.",
    "figure-5": "Figure 5, redrawn: magnitude of the force of inertia over both track speeds.",
    "figure-6": "Figure 6, redrawn: sliding, eccentricity and steering efficiency index over both track "
    "speeds.",
    "figure-7": "Figure 7, redrawn: the indices and their polynomials over the force of inertia.",
    "figure-8": "Figure 8, redrawn: ICRs of the tracks by the inertia-based model.",
}
WIDE = ("figure", "figure-6", "figure-7", "figure-8")
ORIGIN = ("versions", "seed", "format")


def paper_page(results: Results, folder: Path) -> str:
    """Render the page as HTML."""
    pictures = [
        Picture(name, caption, (folder / f"{name}.png").read_bytes(), name in WIDE)
        for name, caption in CAPTIONS.items()
        if (folder / f"{name}.png").exists()
    ]
    return render(
        "paper.html",
        title="The paper, reproduced",
        subtitle=f"icreckon paper · {results['map']['pairs']} simulated stationary motions",
        headline=counts_text(results),
        remarks=[origin_text(results), contradiction_text(results)],
        pictures=pictures,
        tables=all_tables(results),
        configuration=results["configuration"],
        origin={key: results[key] for key in ORIGIN},
    )
