"""Scoreboard of the filter: healthy drives, faults, real logs, cost.

    python benchmarks/scoreboard.py [--quick] [--write FILE] [--check FILE]
    python benchmarks/scoreboard.py --page benchmarks/scoreboard.json

Every change of the filter must pass it. Each part is a set of cells with fixed seeds that no tuning uses:

- healthy: eight robots on 15 grounds, four ways of driving, four IMU grades (`_scoreboard_drives.py`)
- faults: each fault of docs/explanation/proof, simulated and put into two real logs
  (`_scoreboard_faults.py`)
- real: the sample logs in blind folds, by accuracy.py (`_scoreboard_real.py`)
- cost: time of a step over filterpy's, lines, numbers (`_scoreboard_cost.py`)

`--quick` runs a fixed subset with the same seeds; of the real logs, whether their healthy sensors are
excluded. Without sample logs these cells are skipped, and the command says so. Finished runs are kept in
`scoreboard.cache.jsonl` beside the result, under the digest of the sources, so that an interrupted run
goes on. `--check` compares the cells that both have with a file, but not a part of which the file
has the estimates of estimates.json; exit 1 if one is worse beyond its noise:

- healthy: drift above the interval of the file and by more than a tenth; 0.1 points more of the readings
  excluded by rules, 0.5 points more by gates; more flags than chance gives; NEES over 2 and half as much
  again; or drift over all cells that is larger by 1 % or more, beyond its interval
- faults: more runs neither within own 3 sigma nor within twice the error without the fault, or errors
  that are a quarter larger and beyond the spread of the runs
- real: drift outside of the interval of the file; more exclusions or flags
- cost: half as slow again as in the file, against filterpy in the same run
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

import _scoreboard_drives as drives
import _scoreboard_faults as faults
import _scoreboard_real as real
from _digests import ESTIMATES, digest
from _scoreboard_cells import RULES, VARIANTS, Cache, depends_on, rounded, work_off
from _scoreboard_check import worse
from _scoreboard_cost import cost
from _scoreboard_file import read_results, write_results
from _scoreboard_page import write_page
from _study import script_parser

HERE = Path(__file__).resolve().parent
CACHE = HERE / "scoreboard.cache.jsonl"
SENTINELS = (
    "auriga-alpha | plane 10° to 30° | on the spot | tactical",
    "marmotte | plane 10° to 30° | gentle | consumer",
    "marmotte | ice after fixes | gentle | consumer",
)
"""Cells of the quick subset in which a version of the filter excluded a healthy gyro, or drifted most."""
DIGITS = 3
PARTS = ("healthy", "faults", "real", "cost")


def main() -> None:
    """Run the parts; write, check, draw."""
    parser = script_parser(__doc__)
    parser.add_argument("--quick", action="store_true", help="a fixed subset, at most 3 minutes")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument(
        "--without", nargs="+", choices=RULES, default=[], help="disable rules for faults"
    )
    parser.add_argument("--write", type=Path, help="write or update a file of results")
    parser.add_argument("--check", type=Path, help="compare with a file of results")
    parser.add_argument("--cache", type=Path, default=CACHE)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--page", type=Path, help="make the page from a file; run nothing")
    given = parser.parse_args()
    if given.page:
        write_page(read_results(given.page))
        return
    begin = time.monotonic()
    results: dict[str, Any] = {}
    before = read_results(given.check) if given.check else {}
    for part in given.parts:
        if part != "cost" and before.get(part, {}).get("of") == digest(*depends_on(part)):
            text = f"{part}: {given.check} has these estimates, see {ESTIMATES}"
            print(text, file=sys.stderr, flush=True)
            continue
        started = time.monotonic()
        results[part] = rounded(run_part(part, given), DIGITS)
        print(f"{part}: {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)
    if given.write:
        write_results(given.write, results)
    print(f"{time.monotonic() - begin:.0f} s in all", file=sys.stderr)
    if given.check:
        found = worse(results, before)
        print("\n".join(found) or f"no cell is worse than in {given.check}")
        sys.exit(bool(found))


def run_part(part: str, given: argparse.Namespace) -> dict[str, Any]:
    """Figures of the cells of a part, by name."""
    without = tuple(sorted(given.without))
    results = Cache(given.cache, part)
    if part == "healthy":
        picked = quick_cells() if given.quick else drives.cells()
        jobs = list(drives.jobs(picked, VARIANTS, without))
        found = work_off(jobs, drives.score, results, given.workers)
        by_cell: dict[str, list[Any]] = {}
        for job in jobs:
            by_cell.setdefault(job.cell, []).append(found[job])
        return {cell: drives.summary(runs) for cell, runs in by_cell.items()}
    if part == "cost":
        return cost(quick=given.quick)
    if part == "real":
        jobs = list(real.jobs(VARIANTS, without))
        if not jobs:
            text = "real: SKIPPED, there are no sample logs; ICRECKON_DATA names their folder"
            print(text, file=sys.stderr, flush=True)
        if given.quick:
            jobs = [job for job in jobs if job.cell.startswith(real.HEALTH)]
        found = work_off(jobs, real.score, results, given.workers)
        return real.summary([(job, found[job]) for job in jobs])
    jobs = list(faults.jobs(quick=given.quick, variants=VARIANTS, without=without))
    found = work_off(jobs, faults.score, results, given.workers)
    return faults.summary([(job.cell, found[job]) for job in jobs])


def quick_cells() -> list[drives.Cell]:
    """A subset: each robot three times, each ground once or twice, and `SENTINELS`."""
    every, grounds = drives.cells(), list(drives.GROUNDS)
    place = {(one.robot, one.ground, k % 2): one for k, one in enumerate(every)}
    balanced = [
        place[drives.ROBOTS[(k + k // 8) % 8], grounds[(k * 4) % 15], (k // 4) % 2]
        for k in range(24)
    ]
    return balanced + [drives.Cell(*name.split(" | ")) for name in SENTINELS]


if __name__ == "__main__":
    main()
