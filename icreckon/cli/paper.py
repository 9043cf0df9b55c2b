"""`icreckon paper`: the paper's numbers, tables and figures, reproduced."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from icreckon.cli.console import messages, progress, results, results_folder
from icreckon.replay.comparison.results import FORMAT, Results, json_types, write_results
from icreckon.report.paper.figures import write_figures
from icreckon.report.replay.folder import FIGURE_FILE, RESULTS_FILE
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.paper.contact import PaperContact, as_toml, load_paper_contact
from icreckon.simulation.paper.dynamic_map import VelocityErrors
from icreckon.simulation.paper.published import published_errors
from icreckon.simulation.paper.reproduction import (
    Reproduction,
    check_intercepts,
    reproduce,
    table_2_with_published_parameters,
    within,
)

DEFAULT_FOLDER = "icreckon-paper"
# Width of a terminal from which on a table says where a number is in the paper [characters].
WIDE_FROM = 100
CONTACT_FILE = "contact.toml"
PACKAGES = ("icreckon", "numpy", "scipy", "matplotlib", "msgspec")
LEVELS = (5.0, 10.0, 20.0)


def run_paper(
    *, identify: bool, seed: int | None, out: Path | None, as_json: bool, overwrite: bool
) -> None:
    """Run `icreckon paper`; arguments as in its help."""
    if seed is not None and not identify:
        raise SimulationError("--seed is that of the search; give --identify, too, or leave it out")
    seed = seed or 0
    with results_folder(out, DEFAULT_FOLDER, overwrite=overwrite) as folder:
        guess, found = load_paper_contact(), None
        if identify:
            guess, found = _identify(seed)
        reproduced = reproduce(guess)
        summary = _summary(reproduced, seed if identify else None, found)
        comment = "Contact of Auriga-alpha and reading of the paper, as `icreckon paper` used them."
        if identify:
            comment = f"Found by: icreckon paper --identify --seed {seed}"
        text = as_toml(guess, comment)
        (folder / CONTACT_FILE).write_text(text, encoding="utf-8")
        write_figures(folder, reproduced, FIGURE_FILE)
        write_results(folder / RESULTS_FILE, json_types(summary))
        if as_json:
            typer.echo((folder / RESULTS_FILE).read_text(encoding="utf-8"), nl=False)
        else:
            console = results()
            console.print(_tables(summary, narrow=console.width < WIDE_FROM))


def _identify(seed: int) -> tuple[PaperContact, Results]:
    from icreckon.simulation.paper.ablation import ablate
    from icreckon.simulation.paper.search import identify

    with progress(f"identifying contact and soil, seed {seed}") as done:
        identified = identify(seed=seed, progress=done)
    messages().print(
        f"drew {identified.samples} contacts, of which {identified.failed} gave no numbers, and "
        f"refined {len(identified.refined)}"
    )
    guess = identified.best.guess
    with progress("what each choice changes") as done:
        rows = ablate(guess, progress=done)
    return guess, {
        "samples": identified.samples,
        "failed": identified.failed,
        "cost": identified.best.cost,
        "candidates": [
            {
                "cost": candidate.cost,
                "far": candidate.far,
                "guess": msgspec.to_builtins(candidate.guess),
            }
            for candidate in identified.refined
        ],
        "ablation": [msgspec.to_builtins(row) for row in rows],
    }


def _summary(reproduced: Reproduction, seed: int | None, found: Results | None) -> Results:
    """Content of `results.json`."""
    mapped, guess = reproduced.mapped, reproduced.guess
    printed = reproduced.printed_rows
    by_published = table_2_with_published_parameters(mapped, guess.reading)
    return {
        "format": FORMAT,
        "command": "paper",
        "configuration": {"identify": found is not None, **msgspec.to_builtins(guess)},
        "seed": seed,
        "versions": {"python": platform.python_version()}
        | {name: version(name) for name in PACKAGES},
        "published": [msgspec.to_builtins(row) for row in reproduced.rows],
        "counts": {
            "printed": len(printed),
            **{f"within_{level:.0f}_percent": within(printed, level) for level in LEVELS},
            "round_to_published": sum(row.rounds_to_published for row in printed),
        },
        "table_2": {
            "published": _errors(
                VelocityErrors(published_errors("inertia"), published_errors("constant"))
            ),
            "our_parameters": _errors(reproduced.errors),
            "published_parameters": {
                inertia: _errors(errors) for inertia, errors in by_published.items()
            },
        },
        "contradiction": check_intercepts(mapped)._asdict(),
        "map": {
            "pairs": int(mapped.motion.V_l.size),
            "largest_residual": float(np.max(mapped.motion.residual)),
            "tipping": int(mapped.motion.tipping.sum()),
            "largest_inertia_N": float(np.max(mapped.magnitude)),
        },
        "identification": found,
    }


def _errors(errors: VelocityErrors) -> Results:
    units = {"v_x": "m_s", "v_y": "m_s", "w": "rad_s"}
    return {
        model: {f"rmse_{part}_{units[part]}": value for part, value in twist._asdict().items()}
        for model, twist in errors._asdict().items()
    }


def _tables(summary: Results, *, narrow: bool) -> Group:
    counts, check = summary["counts"], summary["contradiction"]
    parts: list[Any] = [_numbers_table(summary, narrow=narrow), _table_2(summary)]
    if summary["identification"]:
        parts.append(_ablation_table(summary["identification"]["ablation"]))
    low, high = check["needed_range"]
    parts.append(
        Text(
            f"Of {counts['printed']} printed numbers {counts['within_5_percent']} are within 5 %, "
            f"{counts['within_10_percent']} within 10 %, {counts['within_20_percent']} within 20 %; "
            f"{counts['round_to_published']} round to the published digits.\n"
            "The published epsilon0 and mean ICRs contradict each other: by least squares the mean "
            f"of s|F| would be {check['needed']:.0f} N ({low:.1f} to {high:.1f} N with rounding); "
            f"the published parameters give {check['of_published_model']:+.0f} N, the motions here "
            f"{check['of_map']:+.0f} N."
        )
    )
    return Group(*parts)


def _numbers_table(summary: Results, *, narrow: bool) -> Table:
    table = Table(title="The paper's numbers", title_justify="left")
    table.add_column("number", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for heading in ("published", "reproduced", "off\n%"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("rounds", no_wrap=True)
    if not narrow:
        table.add_column("where", no_wrap=True)
    for row in summary["published"]:
        table.add_row(
            row["name"],
            row["unit"],
            row["printed"],
            f"{row['reproduced']:.5g}",
            f"{row['difference_percent']:+.1f}",
            "yes" if row["rounds_to_published"] else "",
            *(() if narrow else (row["where"],)),
        )
    return table


def _table_2(summary: Results) -> Table:
    table = Table(title="Table II: RMSE in mm/s, mm/s, mrad/s", title_justify="left")
    table.add_column("truth and parameters")
    for model in ("inertia", "constant"):
        for part in ("v_x", "v_y", "w"):
            table.add_column(f"{model}\n{part}", justify="right", no_wrap=True)
    of = summary["table_2"]
    rows = [("as published", of["published"]), ("our map, our fits", of["our_parameters"])]
    rows += [
        (f"our map, published parameters, |F| {inertia}", errors)
        for inertia, errors in of["published_parameters"].items()
    ]
    for label, errors in rows:
        cells = [1e3 * value for model in errors.values() for value in model.values()]
        table.add_row(label, *(f"{cell:.1f}" for cell in cells))
    return table


def _ablation_table(rows: list[Results]) -> Table:
    title = "What each choice changes: printed numbers within 5 / 10 / 20 %, and the farthest off"
    table = Table(title=title, title_justify="left")
    table.add_column("choice made otherwise")
    for heading in ("all else\nas it is", "contact\nrefitted"):
        table.add_column(heading, justify="right", no_wrap=True)
        table.add_column("farthest off", no_wrap=True)
    for row in rows:
        cells = []
        for which in ("unchanged", "refitted"):
            count = row[which]
            cells.append(" / ".join(str(count[f"within_{level:.0f}_percent"]) for level in LEVELS))
            cells.append(f"{count['worst']} {count['worst_percent']:+.0f} %")
        table.add_row(row["choice"], *cells)
    return table
