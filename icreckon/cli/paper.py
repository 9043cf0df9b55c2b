"""`icreckon paper`: the paper's numbers, tables and figures, reproduced."""

import numpy as np
from msgspec import to_builtins

from icreckon.cli.common.console import results_folder, show, working
from icreckon.cli.common.options import Json, Out, Overwrite, Wide
from icreckon.estimator.base.plain_data import json_types
from icreckon.replay.base.outputs import write_text
from icreckon.replay.comparison.results import FORMAT, Results, versions, write_results
from icreckon.report.pages import unless_missing
from icreckon.report.paper.tables import LEVELS, paper_page, paper_tables
from icreckon.report.replay.folder import FIGURE_FILE, PAGE_FILE, RESULTS_FILE
from icreckon.simulation.paper.dynamic_map import VelocityErrors, write_motions
from icreckon.simulation.paper.fits import LARGEST_INERTIA
from icreckon.simulation.paper.published import published_errors
from icreckon.simulation.paper.reproduction import (
    CONTACT,
    Reproduction,
    check_intercepts,
    reproduce,
    table_2_with_published_parameters,
    within,
)

DEFAULT_FOLDER = "icreckon-paper"
# Width of a terminal from which on a table says where a number is in the paper [characters].
WIDE_FROM = 100
MOTIONS_FILE = "motions.csv"
PACKAGES = ("icreckon", "numpy", "scipy", "matplotlib", "msgspec")


def command(
    out: Out = None, as_json: Json = False, wide: Wide = False, overwrite: Overwrite = False
) -> None:
    """Reproduce the paper: its numbers, its Table II, its figures."""
    with results_folder(out, DEFAULT_FOLDER, overwrite=overwrite) as folder:
        with working("reproducing tables and figures"):
            reproduced = reproduce()
        summary = json_types(_summary(reproduced))
        write_motions(folder / MOTIONS_FILE, reproduced.mapped)
        with working("drawing figures"), unless_missing():
            from icreckon.report.paper.figures import write_figures

            write_figures(folder, reproduced, FIGURE_FILE)
        write_results(folder / RESULTS_FILE, summary)
        write_text(folder / PAGE_FILE, paper_page(summary, folder))
        show(folder, paper_tables, summary, WIDE_FROM, as_json=as_json, wide=wide)


def _summary(reproduced: Reproduction) -> Results:
    """Content of `results.json`."""
    mapped, printed = reproduced.mapped, [row for row in reproduced.rows if not row.read_off]
    by_published = table_2_with_published_parameters(mapped)
    return {
        "format": FORMAT,
        "command": "paper",
        "configuration": {"contact": to_builtins(CONTACT), "largest_inertia_N": LARGEST_INERTIA},
        "seed": None,
        "versions": versions(PACKAGES),
        "published": [to_builtins(row) for row in reproduced.rows],
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
        },
    }


def _errors(errors: VelocityErrors) -> Results:
    units = {"v_x": "m_s", "v_y": "m_s", "w": "rad_s"}
    return {
        model: {f"rmse_{part}_{units[part]}": value for part, value in twist._asdict().items()}
        for model, twist in errors._asdict().items()
    }
