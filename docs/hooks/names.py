"""Names of the API: a table in each section of the pages, and on the site their docstrings, too.

    python docs/hooks/names.py

brings the texts of the tables in `docs/reference/api` up to date with the docstrings. A new name needs a
row with its name alone.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec

import icreckon

DESCRIBED_ELSEWHERE = {
    "EncoderSpec": "encoders",
    "InertialSpec": "gyro-accelerometer",
    "FixSpec": "fixes",
}
"""Structures whose fields a page describes: name and heading there."""
PAGES = Path(__file__).parents[1] / "reference" / "api"
ROW = re.compile(r"^\| `icreckon\.(\w+)` \|.*\|$", re.MULTILINE)
TABLE = re.compile(r"(?:^\|.*\|\n)+", re.MULTILINE)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Put the docstrings of all names behind their table."""
    if "reference/api/" not in page.file.src_uri:
        return markdown
    return TABLE.sub(lambda found: found[0] + "\n" + entries(found[0]), markdown)


def entries(table: str) -> str:
    """Entries of mkdocstrings for the names of a table."""
    return "".join(map(_entry, ROW.findall(table)))


def _entry(name: str) -> str:
    """Entry of a name under that name, with the defaults of a structure, which have no signature."""
    found, home = getattr(icreckon, name), ".".join(icreckon._HOMES[name])
    if inspect.isclass(found) or inspect.isfunction(found):
        # A function may be in a module of its own name.
        home = f"{found.__module__}.{found.__qualname__}"
    options = "" if home.rpartition(".")[2] == name else f"      heading: {name}\n"
    if inspect.ismodule(found):
        # Members with an entry of their own have it once.
        own = [one for module, one in icreckon._HOMES.values() if module == home]
        options += f"      filters: {json.dumps(['!^_', *(f'!^{one}$' for one in own)])}\n"
    entry = f"::: {home}\n" + (f"    options:\n{options}" if options else "") + "\n"
    if not (inspect.isclass(found) and issubclass(found, msgspec.Struct)):
        return entry
    if name in DESCRIBED_ELSEWHERE:
        entry += f"Its fields: [keys of a scenario](../scenario-file.md#{DESCRIBED_ELSEWHERE[name]}).\n\n"
    known = [
        f"`{one.name} = {text}`" for one in msgspec.structs.fields(found) if (text := _default(one))
    ]
    return entry + (f"Defaults: {', '.join(known)}.\n\n" if known else "")


def _default(field: Any) -> str:
    """Default of a field as Python; empty if it is required, or a structure of its own."""
    value = field.default
    if value is msgspec.NODEFAULT and field.default_factory is not msgspec.NODEFAULT:
        value = field.default_factory()
    return "" if value is msgspec.NODEFAULT or isinstance(value, msgspec.Struct) else repr(value)


def first_line(name: str) -> str:
    """First line of the docstring of a public name."""
    home, original = icreckon._HOMES[name]
    found = getattr(icreckon, name)
    if inspect.isclass(found) or inspect.isroutine(found) or inspect.ismodule(found):
        return (inspect.getdoc(found) or "").splitlines()[0]
    body = ast.parse(inspect.getsource(import_module(home))).body
    for line, after in pairwise(body):
        names = line.targets if isinstance(line, ast.Assign) else [getattr(line, "target", None)]
        is_it = any(isinstance(one, ast.Name) and one.id == original for one in names)
        if is_it and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            return str(after.value.value).splitlines()[0]
    raise LookupError(f"{home}.{original} has no docstring")


def up_to_date(page: str) -> str:
    """Text of a page with the first lines of the docstrings in its tables."""
    return ROW.sub(lambda row: f"| `icreckon.{row[1]}` | {first_line(row[1])} |", page)


def main() -> None:
    """Bring all pages up to date."""
    for path in sorted(PAGES.glob("*.md")):
        path.write_text(up_to_date(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
