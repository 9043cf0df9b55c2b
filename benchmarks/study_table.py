"""Tables of a study in Markdown, as pages have them.

    python benchmarks/study_table.py NAME [--runs N]

Runs or continues `icreckon study NAME` in build/studies.
"""

from __future__ import annotations

import sys

import msgspec
from _digests import FILTER, ROOT, digest
from _study import script_parser, table

from icreckon.report.study.folder import run_study
from icreckon.report.study.text import summary_tables
from icreckon.simulation.study.plan import load_study


def main() -> None:
    """Print the tables."""
    parser = script_parser(__doc__)
    parser.add_argument("name", help="of the study, or its file")
    parser.add_argument("--runs", type=int, help="the study's if left out")
    given = parser.parse_args()
    study = load_study(given.name)
    if given.runs is not None:
        study = msgspec.structs.replace(study, runs=given.runs)
    # A study that another version of the filter has begun does not continue.
    folder = ROOT / "build" / "studies" / f"{study.name}-{study.runs}-{digest(*FILTER)}"
    results = run_study(study, folder, remark=lambda text: print(text, file=sys.stderr))
    for one in summary_tables(results):
        rows = []
        for row in one.rows:
            place, name, rest = row[: one.texts - 1], row[one.texts - 1], row[one.texts :]
            # A cell is named in its first row alone.
            if rows:
                place = tuple(new or old for new, old in zip(place, rows[-1], strict=False))
            rows.append([*place, f"`{name}`", *rest])
        print(f"{one.title}\n")
        table(one.head, rows)
        print()


if __name__ == "__main__":
    main()
