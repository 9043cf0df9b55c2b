"""Size of what an installation of icreckon brings, and which part of it needs what.

    python benchmarks/dependency_weight.py

Run it with the Python of a fresh virtual environment that holds icreckon and nothing else. Each
distribution is printed with the size of its files, without compiled bytecode, and with its use: imported
by the library (a pose estimator that is fed), by a replay of a bag, or by a page with figures.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from importlib.metadata import distributions, packages_distributions

from _study import table

LIBRARY = """
import icreckon as i
estimator = i.PoseEstimator(i.load_robot("auriga-alpha"))
estimator.feed(i.TrackSpeeds(0, 0.3, 0.6))
estimator.feed(i.ImuSample(10_000_000, (0.0, 0.0, 0.2), (0.0, 0.1, 9.81)))
estimator.feed(i.PositionFix(20_000_000, 0.0, 0.0, 0.01))
"""
REPLAY = """
import icreckon as i
robot = i.load_robot("auriga-alpha")
i.write_log(i.simulate(i.Scenario(duration=10.0, fix_rate=0.0), robot), "bag", "mcap", robot)
compared = i.compare(i.read_log("bag", robot), robot, "inertia-online")
results = i.summarise(compared, robot, command="replay", configuration={})
"""
PAGE = (
    REPLAY
    + """
import os
os.mkdir("page")
i.write_report("page", compared, results, robot)
"""
)
USES = {"library": LIBRARY, "replay": REPLAY, "page": PAGE}
LIST = "\nimport json, sys\nprint(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"


def imported(code: str) -> set[str]:
    """Names of the distributions that code imports, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-c", code + LIST],
            capture_output=True,
            text=True,
            check=True,
            cwd=folder,
        )
    homes = packages_distributions()
    modules = json.loads(done.stdout.splitlines()[-1])
    return {distribution for module in modules for distribution in homes.get(module, ())}


def sizes() -> dict[str, float]:
    """Size of each distribution's files [MB], without compiled bytecode."""
    found = {}
    for distribution in distributions():
        paths = [distribution.locate_file(file) for file in distribution.files or ()]
        files = [path for path in paths if path.suffix != ".pyc" and path.is_file()]
        found[distribution.metadata["Name"]] = sum(path.stat().st_size for path in files) / 1e6
    return found


def main() -> None:
    """Print the table."""
    weights = sizes()
    needed = {use: imported(code) for use, code in USES.items()}
    marks = {name: ["yes" if name in needed[use] else "" for use in USES] for name in weights}
    largest = sorted(weights, key=weights.__getitem__, reverse=True)
    body = [
        [name, f"{weights[name]:.1f}", *marks[name]] for name in largest if weights[name] >= 1.0
    ]
    rest = [name for name in largest if weights[name] < 1.0]
    body.append([f"{len(rest)} others", f"{sum(weights[name] for name in rest):.1f}", "", "", ""])
    totals = [
        f"{sum(weights[name] for name in weights if name in needed[use]):.0f}" for use in USES
    ]
    body.append(["all, MB", f"{sum(weights.values()):.0f}", *totals])
    table(["distribution", "MB", *USES], body)


if __name__ == "__main__":
    main()
