"""Numbers and tables that a person put into a proposed robot file, kept."""

from __future__ import annotations

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any

from icreckon.replay.base.errors import ReplayError

TABLE = re.compile(r"\[([^\[\]]+)\]\s*(?:#.*)?$")
KEY = re.compile(r"(\w+) = ([^#]*?)(\s*)#(.*(?:fill in|check it).*)$")
# A gauge that stands in for the one that only a person can measure.
UNTOUCHED_GAUGE = re.compile(
    r"^track_gauge = ([\d.e+-]+) *# .*the effective track \(\1\).*$", re.MULTILINE
)


def with_filled_in(proposed: str, path: Path) -> tuple[str, list[str]]:
    """Take over from an earlier proposal what a person filled in or added.

    Args:
        proposed: text of the new proposal.
        path: the earlier one.

    Returns:
        The text, and the names of what was taken over, as "vehicle.mass", or "[soil]" for a table.

    Raises:
        ReplayError: the earlier file is no TOML file.
    """
    try:
        former_text = path.read_text(encoding="utf-8")
        former = _filled_in(former_text)
    except (ValueError, OSError) as problem:
        raise ReplayError(
            f"{path}: what was filled in cannot be read: {problem}; mend or move the file"
        ) from None
    lines, taken, table = [], [], ""
    for line in proposed.splitlines():
        if found := TABLE.match(line):
            table = found[1]
        key = KEY.match(line)
        value = None if key is None else _value(former, table, key[1])
        if key is None or value is None or value == key[2].strip():
            lines.append(line)
            continue
        lines.append(f"{key[1]} = {value}    # as filled in before")
        taken.append(f"{table}.{key[1]}")
    tables = set(_tables(proposed))
    for name, text in _tables(former_text).items():
        if name not in tables:
            lines += ["", *text]
            taken.append(f"[{name}]")
    return "\n".join(lines) + "\n", taken


def has_stand_in_gauge(proposed: str) -> bool:
    """Return True if the track gauge of a proposal is the effective track of the log."""
    return UNTOUCHED_GAUGE.search(proposed) is not None


def filled_in_gauge(path: Path) -> float | None:
    """Track gauge of an earlier proposal [m]; None if there is none that can be read."""
    try:
        former = _filled_in(path.read_text(encoding="utf-8"))
    except (ValueError, OSError):
        return None
    found = _value(former, "vehicle", "track_gauge")
    return None if found is None or float(found) <= 0.0 else float(found)


def _filled_in(text: str) -> dict[str, Any]:
    """Content of an earlier proposal, without a gauge that nobody has filled in."""
    return tomllib.loads(UNTOUCHED_GAUGE.sub("", text))


def _value(former: dict[str, Any], table: str, key: str) -> str | None:
    """Value of a key as TOML, None if it is no number or text that was filled in."""
    found: Any = former
    for name in [*table.split("."), key]:
        if not isinstance(found, dict) or name not in found:
            return None
        found = found[name]
    if isinstance(found, str):
        return json.dumps(found, ensure_ascii=False)
    numbers = found if isinstance(found, list) else [found]
    if not all(isinstance(one, int | float) and math.isfinite(one) for one in numbers):
        return None
    return repr(found)


def _tables(text: str) -> dict[str, list[str]]:
    """Lines of each table of a TOML file, by its name, without trailing blank lines."""
    found: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if name := TABLE.match(line):
            lines = found.setdefault(name[1], [])
        lines.append(line)
    for lines in found.values():
        while lines and not lines[-1].strip():
            lines.pop()
    return found
