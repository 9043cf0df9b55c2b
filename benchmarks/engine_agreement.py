"""The streaming and the side-by-side engine against each other, in everything that results.json holds.

    python benchmarks/engine_agreement.py [DATA] [--runs 2] [--studies NAME,NAME] [--work DIR]

Each shipped study, and each sample log with a truth where DATA is given (see accuracy.py), is worked
through by both engines, each command in a process of its own that begins with an empty compile cache.
Printed are, for each of them, how many figures there are, how many differ by more than rounding, and the
largest relative difference. Counts must be the same, all else within TOLERANCE.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from _figures import count, differences, figures, run_command
from _logs import WITH_TRUTH
from _study import table

from icreckon.simulation.study.plan import study_names

# Differences that rounding can make of sums over some 10^5 samples.
TOLERANCE = 1e-6
ENGINES = ("streaming", "batch")


def command_in_fresh_cache(work: Path, arguments: list[str]) -> Path:
    """Run a command with an empty compile cache; return the folder of its results."""
    out = Path(tempfile.mkdtemp(dir=work)) / "results"
    with tempfile.TemporaryDirectory(dir=work) as cache:
        run_command([*arguments, "--out", str(out)], NUMBA_CACHE_DIR=cache)
    return out


def compared(name: str, work: Path, arguments: list[str]) -> list[str]:
    """Run a command with each engine; return a row of the table."""
    one, other = (
        figures(command_in_fresh_cache(work, [*arguments, "--engine", engine]))
        for engine in ENGINES
    )
    found = [each for each in differences(one, other) if each.relative > TOLERANCE]
    largest = max((each.relative for each in differences(one, other)), default=0.0)
    for each in found[:10]:
        print(f"  {name}{each.path}: {each.one} and {each.other}")
    return [name, str(count(one)), str(len(found)), f"{largest:.1e}"]


def main() -> None:
    """Print the table; exit with 1 where the engines differ."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--studies", default=",".join(study_names()))
    parser.add_argument("--work", type=Path)
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(dir=options.work) as folder:
        work = Path(folder)
        studies, runs = filter(None, options.studies.split(",")), ["--runs", str(options.runs)]
        rows += [compared(name, work, ["study", name, *runs]) for name in studies]
        if options.data is not None:
            for name, robot in WITH_TRUTH.items():
                log = str((options.data / name).resolve())
                arguments = ["replay", log, "--robot", robot, "--formats", "none"]
                rows.append(compared(name, work, arguments))
    table(["input", "figures", "different", "largest difference"], rows)
    if any(row[2] != "0" for row in rows):
        sys.exit(1)


if __name__ == "__main__":
    main()
