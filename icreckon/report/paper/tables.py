"""Tables and page of the reproduction, made from its results and figures only."""

from pathlib import Path

from rich.console import Group
from rich.text import Text

from icreckon.replay.comparison.results import Results
from icreckon.report.pages import Cell, Picture, Table, render
from icreckon.report.terminal import rich_table

LEVELS = (5.0, 10.0, 20.0)  # shares of the published number that are counted [%]
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


def paper_tables(results: Results, *, narrow: bool) -> Group:
    """Numbers, Table II and verdict, for the terminal; narrow for 80 characters."""
    tables = [rich_table(make(results, narrow=narrow)) for make in (_numbers, _table_2)]
    sentences = (counts_text(results), origin_text(results), contradiction_text(results))
    return Group(*tables, Text("\n".join(sentences)))


def counts_text(results: Results) -> str:
    """Sentence on how many numbers are reproduced."""
    counts = results["counts"]
    return (
        f"Of {counts['printed']} printed numbers {counts['within_5_percent']} are within 5 %, "
        f"{counts['within_10_percent']} within 10 %, {counts['within_20_percent']} within 20 %; "
        f"{counts['round_to_published']} round to the published digits."
    )


def origin_text(results: Results) -> str:
    """Sentences on what is measured, simulated and fitted."""
    return (
        f"Nothing here is measured: all {results['map']['pairs']} motions are simulated, by friction at "
        "contact points. The paper states neither contact nor friction nor the height of the centre of "
        "mass; they were fitted to these numbers. So agreement shows that one ground explains them "
        "together, and no more. Means and fits leave out motions above "
        f"{results['configuration']['largest_inertia_N']:g} N of inertia."
    )


def contradiction_text(results: Results) -> str:
    """Sentence on the published numbers that contradict each other."""
    check = results["contradiction"]
    low, high = check["needed_range"]
    return (
        "The published epsilon0 and mean ICRs contradict each other: by least squares the mean "
        f"of s|F| would be {check['needed']:.0f} N ({low:.1f} to {high:.1f} N with rounding); "
        f"the published parameters give {check['of_published_model']:+.0f} N, all turning motions here "
        f"{check['of_map']:+.0f} N."
    )


def _numbers(results: Results, *, narrow: bool) -> Table:
    """Each published number next to the reproduced one, with its place unless narrow."""
    rows = []
    for row in results["published"]:
        reproduced = f"{row['reproduced']:.5g}"
        difference = f"{row['difference_percent']:+.1f}"
        is_equal = "yes" if row["rounds_to_published"] else ""
        cells = list(map(Cell, (row["printed"], reproduced, difference, row["unit"], is_equal)))
        if not narrow:
            cells.append(Cell(row["where"], "wrap"))
        rows.append((row["name"], cells))
    head = ["number", "published", "reproduced", "difference\n%", "unit", "equal when\nrounded"]
    return Table("The paper's numbers", head if narrow else [*head, "where"], rows)


def _table_2(results: Results, *, narrow: bool) -> Table:
    """Velocity errors: a row for each truth and parameters, or a column if narrow."""
    table, by_inertia = results["table_2"], results["table_2"]["published_parameters"]
    # RMSE by model (inertia, constant) and component (v_x, v_y, w) [m/s, m/s, rad/s].
    errors = [table["published"], table["our_parameters"], *by_inertia.values()]
    values = [
        [f"{1e3 * rmse:.1f}" for components in by_model.values() for rmse in components.values()]
        for by_model in errors
    ]
    parts = [(model, part) for model in ("inertia", "constant") for part in ("v_x", "v_y", "w")]
    title = (
        "Table II: RMSE in mm/s, mm/s, mrad/s. The force |F| is that of the motion (measured), or that "
        "of the model itself, in the paper's form (literal) or the signed one (smooth)"
    )
    if narrow:
        head = ["model", "as pub-\nlished", "our motions,\nour fits"]
        head += [f"published\nfits,\n|F| {inertia}" for inertia in by_inertia]
        labels = [f"{model} {part}" for model, part in parts]
        values = [list(column) for column in zip(*values, strict=True)]
    else:
        head = ["truth and parameters", *(f"{model}\n{part}" for model, part in parts)]
        labels = ["as published", "our motions, our fits"]
        labels += [f"our motions, published parameters, |F| {inertia}" for inertia in by_inertia]
    rows = [(label, list(map(Cell, row))) for label, row in zip(labels, values, strict=True)]
    return Table(title, head, rows)


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
        tables=[_numbers(results, narrow=False), _table_2(results, narrow=False)],
        configuration=results["configuration"],
        origin={key: results[key] for key in ORIGIN},
    )
