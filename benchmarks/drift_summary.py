"""Drift on the sample logs, the figures of README: `accuracy.py` for four variants, all in one table.

    python benchmarks/drift_summary.py DATA

DATA is the folder of the sample logs. Figures are those of `accuracy.py`: % of distance after 30 s (10 s)
by robot and ground, the ratio to `gyro` with its 95 % interval, and the NEES of the motion.
"""

from __future__ import annotations

from _study import data_parser, spread, table
from accuracy import Job, folds, results_of, score

VARIANTS = {"gyro": "`gyro`: wheels and gyro"} | {
    name: f"`{name}`" for name in ("constant-online", "inertia-online")
}
ROWS = {
    "Warthog, grass": "Warthog, grass, 3 logs",
    "Warthog, asphalt": "Warthog, asphalt",
    "Marmotte": "Marmotte (tracks)",
    "Husky": "Husky, deflated tyres",
    "all logs": "all",
}


def main() -> None:
    """Print the table."""
    parser = data_parser(__doc__)
    given = parser.parse_args()
    jobs = [Job(given.data, fold, tuple(VARIANTS), less_known=False) for fold in folds()]
    scores = [one for some in spread(score, jobs, given.workers) for one in some]
    results = results_of(scores)

    def both(row: str, name: str, key: str, form: str) -> str:
        thirty, ten = (results[row][name][horizon][key] for horizon in ("30s", "10s"))
        return f"{thirty:{form}} ({ten:{form}})"

    rows = [
        [label, *(both(row, name, "percent", ".2f") for name in VARIANTS)]
        for row, label in ROWS.items()
    ]
    ratios = ["1.00"]
    for name in list(VARIANTS)[1:]:
        figures = results["all logs"][name]["30s"]
        ratio, low, high = (figures[f"{key}_of_gyro"] for key in ("ratio", "low", "high"))
        ratios.append(f"{ratio:.2f} ({low:.2f} to {high:.2f})")
    rows.append(["ratio to `gyro`, 30 s (95 %)", *ratios])
    nees = [both("all logs", name, "nees", ".1f") for name in VARIANTS]
    rows.append(["NEES of the motion (3 is ideal)", *nees])
    table(["", *VARIANTS.values()], rows)


if __name__ == "__main__":
    main()
