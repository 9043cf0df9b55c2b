"""Tables of the pages that are older than their sources: list them, or make them again.

    python benchmarks/all_tables.py [--list] [--only NAME ...] [--data DATA]

NAME is a part of a page's name or of a command. Commands run one after the other, the cheapest first.
The output of each is kept in build/tables under the digest of its sources, so that an interrupted run
goes on. A command that fails is reported and does not stop the others. A table is replaced where its
command prints one with its columns and rows, and is reported otherwise. Exit 1 if some are still stale.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

from _digests import ROOT
from _study import script_parser
from _tables import SCOREBOARD, SCRIPT, Table, all_tables, current, put, renewed

KEPT = ROOT / "build" / "tables"
RESULTS = "benchmarks/scoreboard.json"
CHEAPEST_FIRST = (
    "broken_input",
    "wander",
    "drift_summary",
    "demo_runs",
    "long_run",
    "accuracy",
    "three_dimensions",
    "peers",
    "scoreboard",
)
"""Scripts by the time that their commands take, from 17 seconds to 40 minutes on two cores."""


class CommandError(Exception):
    """A command that failed: its exit code, and the last line of its error output."""


def run(command: str, data: str, output: Path) -> None:
    """Run a command of a mark, and write what it prints to a file when it has ended well.

    Raises:
        CommandError: it failed.
    """
    print(f"{command}: running", file=sys.stderr, flush=True)
    begin, last = time.monotonic(), ""
    arguments = shlex.split(command.replace("DATA", shlex.quote(data)))[1:]
    part = output.with_suffix(".part")
    with (
        part.open("w", encoding="utf-8") as printed,
        subprocess.Popen(
            [sys.executable, *arguments],
            cwd=ROOT,
            env={**os.environ, "ICRECKON_DATA": data},
            stdout=printed,
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        for line in process.stderr or ():
            sys.stderr.write(line)
            last = line.strip() or last
    print(f"{command}: {time.monotonic() - begin:.0f} s", file=sys.stderr, flush=True)
    if process.returncode:
        raise CommandError(f"exit code {process.returncode}: {last}")
    part.rename(output)


def output_of(command: str, data: str) -> str:
    """Output of a command, from an earlier run with the same sources if there is one."""
    slug = re.sub(r"\W+", "-", command.removeprefix("python benchmarks/"))
    kept = KEPT / f"{slug}-{current(command)}.txt"
    if not kept.is_file():
        KEPT.mkdir(parents=True, exist_ok=True)
        run(command, data, kept)
    return kept.read_text(encoding="utf-8")


def renew(table: Table, output: str) -> bool:
    """Replace a table from the output of its command; return False if that has no such table."""
    rows = renewed(table, output)
    if rows is None:
        print(f"{table.name}: no table of the output has its columns and rows", flush=True)
        return False
    changed = sum(tuple(new) != old for new, old in zip(rows, table.rows, strict=True))
    put(table, rows)
    print(f"{table.name}: replaced, {changed} of {len(rows)} rows differ", flush=True)
    return True


def renew_scoreboard(data: str) -> None:
    """Run the scoreboard, which keeps its finished runs, and make its page."""
    KEPT.mkdir(parents=True, exist_ok=True)
    for option in ("--write", "--page"):
        run(f"python {SCOREBOARD} {option} {RESULTS}", data, KEPT / f"scoreboard{option}.txt")
    print("scoreboard.md: made", flush=True)


def renew_all(stale: list[Table], data: str) -> int:
    """Run the commands of tables, and replace these; return the number of tables that are left."""
    left = 0
    for command in sorted({one.command or "" for one in stale}, key=cost):
        of_command = [one for one in stale if one.command == command]
        try:
            output = output_of(command, data)
        except CommandError as problem:
            print(f"{command}: failed with {problem}", flush=True)
            left += len(of_command)
            continue
        left += sum(not renew(one, output) for one in of_command)
    return left


def cost(command: str) -> tuple[int, str]:
    """Key that sorts commands by the time that they take."""
    script = SCRIPT.search(command)
    name = Path(script[0]).stem if script else ""
    known = name in CHEAPEST_FIRST
    return (CHEAPEST_FIRST.index(name) if known else len(CHEAPEST_FIRST)), command


def main() -> None:
    """List or renew the tables."""
    parser = script_parser(__doc__)
    parser.add_argument("--list", action="store_true", help="run nothing")
    parser.add_argument("--only", nargs="+", default=[""], metavar="NAME")
    default = os.environ.get("ICRECKON_DATA", str(ROOT.parent / "shared" / "data"))
    parser.add_argument("--data", default=default, help="folder of the sample logs")
    given = parser.parse_args()
    marked = [one for one in all_tables() if one.command is not None]
    picked = [
        one for one in marked if any(part in f"{one.name} {one.command}" for part in given.only)
    ]
    stale = [one for one in picked if one.is_stale]
    if given.list:
        for one in picked:
            print(f"{'stale  ' if one.is_stale else 'current'} {one.name}: {one.command}")
        print(f"{len(stale)} of {len(picked)} tables are older than their sources")
        return
    data = str(Path(given.data).resolve())
    of_board = [one for one in stale if SCOREBOARD in (one.command or "")]
    left = renew_all([one for one in stale if one not in of_board], data)
    if of_board:
        try:
            renew_scoreboard(data)
        except CommandError as problem:
            print(f"scoreboard: failed with {problem}", flush=True)
            left += len(of_board)
    print(f"{len(stale) - left} of {len(stale)} tables renewed, {left} left")
    sys.exit(left > 0)


if __name__ == "__main__":
    main()
