"""Digests of the sources that a figure depends on, as short hexadecimal words.

Comments, docstrings and the layout of Python count for nothing.
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
import tokenize
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FILTER = ("estimator", "simulation")
"""Packages that every simulated figure depends on."""
ESTIMATES = "benchmarks/estimates.json"
"""Figures of runs with all parts of the filter: code that leaves them the same makes no table older."""
WITHOUT_FAULTS, WITH_FAULTS = (
    f"{ESTIMATES}#healthy,real,study",
    f"{ESTIMATES}#faults,healthy,real,study",
)
"""Those of the runs without faults, and with them, by the first words of their names."""
HEIGHTS = f"{ESTIMATES}#height"
"""Those of heights, roll and pitch."""
IN_NO_TABLE = ": late", ": smoothed"
"""Ends of the names of runs that estimate the latency of the tracks, or are smoothed."""
KINDS = (".py", ".toml")
LENGTH = 8
LAYOUT = {
    tokenize.COMMENT: "",
    tokenize.NL: "",
    tokenize.NEWLINE: "\n",
    tokenize.INDENT: ">",
    tokenize.DEDENT: "<",
}
"""What stands for tokens of the layout."""


def sources(names: Iterable[str]) -> list[Path]:
    """Source files of folders and files, named from the root of the repository."""
    found: set[Path] = set()
    for name in names:
        path = ROOT / name
        if path.is_dir():
            found |= {one for one in path.rglob("*") if one.suffix in KINDS}
        elif path.is_file():
            found.add(path)
    return sorted(found)


def code_of(source: str) -> str:
    """Python without comments and docstrings, whatever its layout."""
    lines = source.splitlines(keepends=True)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
            node
        ):
            begin, end = node.body[0].lineno - 1, node.body[0].end_lineno
            lines[begin:end] = ["\n"] * len(lines[begin:end])
    words = [
        LAYOUT.get(token.type, token.string)
        for token in tokenize.generate_tokens(iter(lines).__next__)
    ]
    # Python 3.12 takes f-strings apart, without spaces and doubled braces.
    text = re.sub(r"[ \t]|(?<=\{)\{|(?<=\})\}", "", "".join(words))
    return re.sub(r"(?<=import)\((.*)\)", r"\1", re.sub(r",(?=[)\]}])", "", text))


@cache
def digest(*names: str) -> str:
    """Digest of all sources of some folders and files, named from the root of the repository.

    FILE#WORD,... stands for the values of a JSON file whose names begin with one of the words, and do not
    end in one of `IN_NO_TABLE`.
    """
    hashed = hashlib.sha256()
    for name in names:
        file, _, words = name.partition("#")
        if words:
            runs = json.loads((ROOT / file).read_text(encoding="utf-8"))
            chosen = {
                run: runs[run]
                for run in sorted(runs)
                if run.split()[0] in words.split(",") and not run.endswith(IN_NO_TABLE)
            }
            hashed.update(json.dumps(chosen).encode())
    for path in sources(name for name in names if "#" not in name):
        hashed.update(f"{path.relative_to(ROOT)}\0".encode())
        text = path.read_text(encoding="utf-8")
        hashed.update((code_of(text) if path.suffix == ".py" else text).encode())
    return hashed.hexdigest()[:LENGTH]
