"""Figures of the main commands before and after a change that is to leave them alone.

    python benchmarks/frozen.py FOLDER [--data DATA]
    python benchmarks/frozen.py --compare A B

The first runs each command with `--out` in a subfolder of FOLDER. With DATA, a folder of sample logs (see
accuracy.py), logs are replayed and calibrated, too. The second compares two such folders: how many
figures each results.json holds, how many differ, and the largest relative difference.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from _figures import count, differences, figures, run_command
from _study import script_parser, table

GRASS = "warthog_grass_2024_8_8_16h11s19"
COMMANDS = {
    "demo": "demo --duration 90",
    "study-imu-grades": "study imu-grades --runs 2",
    "study-outage-length": "study outage-length --runs 2",
    "study-ten-thousand": "study ten-thousand --runs 16",
    "paper": "paper",
}
LOG_COMMANDS = {
    "replay-jackal": "replay jackal_test2.bag --robot jackal --smooth",
    "replay-warthog": f"replay {GRASS} --robot warthog",
    "calibrate": f"calibrate {GRASS} --robot warthog",
}


def freeze(folder: Path, data: Path | None) -> None:
    """Run all commands, in the folder of the logs if there is one."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, command in (COMMANDS | (LOG_COMMANDS if data else {})).items():
        begin = time.monotonic()
        run_command([*command.split(), "--out", str(folder.resolve() / name)], cwd=data)
        print(f"{name}: {time.monotonic() - begin:.0f} s", flush=True)


def compared(name: str, one: Path, other: Path) -> list[str]:
    """Row of the table for the results of a command; its largest differences are printed."""
    if not (one / name).is_dir() or not (other / name).is_dir():
        return [name, "0", "missing", "-"]
    before = figures(one / name)
    found = sorted(differences(before, figures(other / name)), key=lambda each: -each.relative)
    for each in found[:5]:
        print(f"  {name}{each.path}: {each.one} and {each.other}")
    largest = found[0].relative if found else 0.0
    return [name, str(count(before)), str(len(found)), f"{largest:.1e}"]


def main() -> None:
    """Run the commands, or compare two runs; exit with 1 if a figure differs by more than rounding."""
    parser = script_parser(__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("A", "B"))
    parser.add_argument("--tolerance", type=float, default=1e-9)
    options = parser.parse_args()
    if options.compare:
        one, other = options.compare
        names = sorted(
            {path.parent.name for at in (one, other) for path in at.glob("*/results.json")}
        )
        rows = [compared(name, one, other) for name in names]
        table(["command", "figures", "different", "largest difference"], rows)
        within = [row[3] != "-" and float(row[3]) <= options.tolerance for row in rows]
        sys.exit(0 if rows and all(within) else 1)
    if not options.folder:
        parser.error("give a folder, or --compare and two")
    freeze(options.folder, options.data)


if __name__ == "__main__":
    main()
