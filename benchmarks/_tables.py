"""Tables of the pages whose figures come from a command, each marked with it and with a digest.

    <!-- figures: python benchmarks/NAME.py OPTIONS; of: DIGEST -->

stands before such a table. The digest is that of the script, and of the estimates of the filter (see
estimates.py), when the table was made; DATA in a command is the folder of the sample logs.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from _digests import HEIGHTS, ROOT, WITH_FAULTS, WITHOUT_FAULTS, digest

DOCS = ROOT / "docs" / "explanation"
PAGES = (ROOT / "README.md", DOCS / "proof.md", *sorted((DOCS / "proof").glob("*.md")))
MARK = re.compile(r"<!-- figures: (?P<command>.*); of: (?P<of>\w+) -->")
SCRIPT = re.compile(r"benchmarks/\w+\.py")
SCOREBOARD = "benchmarks/scoreboard.py"
OF_FAULTS = ("broken_input.py", "long_run.py", "peers.py", "wander.py")
"""Scripts of tables with faults: the other ones depend on the estimates of runs without faults."""
OF_HEIGHTS = ("three_dimensions.py",)
"""Those of tables with heights."""
RULE = re.compile(r"^\|( ?:?-+:? ?\|)+$")
Rows = list[tuple[str, ...]]


@dataclass(frozen=True)
class Table:
    """A table of a page.

    Attributes:
        page: the page.
        line: index of its head among the lines of the page.
        head: cells of its head.
        rows: cells of its rows.
        command: command that gives its figures; None if it has no mark.
        of: digest of the sources when it was made; None if it has no mark.
    """

    page: Path
    line: int
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    command: str | None = None
    of: str | None = None

    @property
    def name(self) -> str:
        """Page and line, for people."""
        return f"{self.page.relative_to(ROOT)}:{self.line + 1}"

    @property
    def is_stale(self) -> bool:
        """True if its sources have changed since it was made."""
        return self.command is not None and self.of != current(self.command)


def current(command: str) -> str:
    """Digest of the sources that the figures of a command depend on, as they are now."""
    script = SCRIPT.search(command)
    if script is None:
        raise ValueError(f"no script of benchmarks in {command!r}")
    if script[0] == SCOREBOARD:
        from _scoreboard_cells import depends_on

        return digest(*depends_on(command.split()[-1]))
    name = script[0].split("/")[-1]
    if name in OF_HEIGHTS:
        return digest(HEIGHTS, script[0])
    return digest(WITH_FAULTS if name in OF_FAULTS else WITHOUT_FAULTS, script[0])


def cells(line: str) -> tuple[str, ...]:
    """Cells of a line of a table."""
    return tuple(
        cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")
    )


def tables_in(lines: Sequence[str]) -> Iterator[tuple[int, tuple[str, ...], Rows]]:
    """Index of the head, its cells, and the rows of each table in Markdown."""
    for place, line in enumerate(lines):
        if place and RULE.match(line):
            rows = itertools.takewhile(lambda one: one.startswith("|"), lines[place + 1 :])
            yield place - 1, cells(lines[place - 1]), [cells(row) for row in rows]


def tables(page: Path) -> list[Table]:
    """Tables of a page."""
    lines = page.read_text(encoding="utf-8").splitlines()
    found = []
    for place, head, rows in tables_in(lines):
        table = Table(page, place, head, tuple(rows))
        mark = MARK.fullmatch(lines[place - 2]) if place >= 2 and not lines[place - 1] else None
        found.append(replace(table, command=mark["command"], of=mark["of"]) if mark else table)
    return found


def all_tables() -> Iterator[Table]:
    """All tables of all pages."""
    for page in PAGES:
        yield from tables(page)


def plain(cell: str) -> str:
    """Text of a cell without markup and punctuation, to compare it."""
    return " ".join(re.sub(r"[`*\[\],()]", " ", cell).lower().split())


def _places(head: Sequence[str], of: Sequence[str]) -> list[int] | None:
    """Places of the columns of a head within another; None if it lacks one.

    A page may have them in an order of its own if their names are unique.
    """
    found, begin = [], 0
    for cell in head:
        if cell not in of[begin:]:
            is_unique = len({*of}) == len(of) and {*head} <= {*of}
            return [of.index(one) for one in head] if is_unique else None
        found.append(of.index(cell, begin))
        begin = found[-1] + 1
    return found


def renewed(table: Table, output: str) -> Rows | None:
    """Rows of a table from the output of its command, which may have more rows and columns.

    Rows are found by their first cells, as many as are needed to tell the rows of the output apart.

    Returns:
        The rows; None if no table of the output has all columns and rows of this one.
    """
    head = [plain(cell) for cell in table.head]
    for _, other, rows in tables_in(output.splitlines()):
        places = _places(head, [plain(cell) for cell in other])
        if places is None:
            continue
        picked = [tuple(row[place] for place in places) for row in rows]
        for count in range(1, len(head)):
            by_key: dict[tuple[str, ...], Rows] = {}
            for row in picked:
                by_key.setdefault(tuple(map(plain, row[:count])), []).append(row)
            keys = [tuple(map(plain, row[:count])) for row in table.rows]
            if len(set(keys)) == len(keys) and all(len(by_key.get(key, [])) == 1 for key in keys):
                return [
                    (*row[:count], *by_key[key][0][count:])
                    for key, row in zip(keys, table.rows, strict=True)
                ]
    return None


def put(table: Table, rows: Rows) -> None:
    """Replace the rows of a table in its page, and its digest by the current one."""
    if table.command is None:
        raise ValueError(f"{table.name} has no mark")
    lines = table.page.read_text(encoding="utf-8").splitlines()
    lines[table.line - 2] = f"<!-- figures: {table.command}; of: {current(table.command)} -->"
    begin = table.line + 2
    text = ["| " + " | ".join(row) + " |" for row in rows]
    lines[begin : begin + len(table.rows)] = text
    table.page.write_text("\n".join(lines) + "\n", encoding="utf-8")
