"""Numbers and tables that a person put into a proposed robot file, kept."""

from __future__ import annotations

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any

from icreckon.replay.base.errors import ReplayError
from icreckon.replay.inspection.guess_topics import PLACEHOLDER_SIGMA

TABLE = re.compile(r"\[([^\[\]]+)\]\s*(?:#.*)?$")
KEY = re.compile(r"(\w+)\s*=\s*([^#]*?)\s*(?:#\s*(.*))?$")
MARK = re.compile("fill in|check it|as filled in before")
# Placeholders of an earlier proposal; a gauge stands in for the one that only a person can measure.
UNTOUCHED_GAUGE = re.compile(
    r"^track_gauge = ([\d.e+-]+) *# .*the effective track \(\1\).*$", re.MULTILINE
)
UNTOUCHED = re.compile(
    rf"^(?:max_track_speed = 2\.0|offset_deg = 0\.0|position = \[0\.0, 0\.0, 0\.0\]"
    rf"|(?:position_)?sigma = {PLACEHOLDER_SIGMA}) +# .*fill in.*$",
    re.MULTILINE,
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
        former_text = _without_placeholders(path.read_text(encoding="utf-8"))
        former = tomllib.loads(former_text)
    except (ValueError, OSError) as problem:
        raise ReplayError(
            f"{path}: what was filled in cannot be read: {problem}; mend or move the file"
        ) from None
    before, now = _remarks(former_text), _remarks(proposed)
    lines, taken, table = [], [], ""

    def take_over(key: str, value: str) -> None:
        lines.append(f"{key} = {value}    # as filled in before")
        taken.append(f"{table}.{key}")

    for line in proposed.splitlines():
        if found := TABLE.match(line):
            table = found[1]
            lines.append(line)
            for (of, name), remark in before.items():
                own = MARK.search(remark) or not (remark or table.startswith("log"))
                value = _value(former, table, name)
                if of == table and (of, name) not in now and own and value is not None:
                    take_over(name, value)
            continue
        key = KEY.match(line)
        value = None if key is None else _value(former, table, key[1])
        if key is None or value is None or value == key[2]:
            lines.append(line)
        elif _is_filled_in(before.get((table, key[1])), key[3] or ""):
            take_over(key[1], value)
        else:
            lines.append(line)
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
        former = tomllib.loads(_without_placeholders(path.read_text(encoding="utf-8")))
    except (ValueError, OSError):
        return None
    found = _value(former, "vehicle", "track_gauge")
    return None if found is None or float(found) <= 0.0 else float(found)


def _without_placeholders(text: str) -> str:
    return UNTOUCHED.sub("", UNTOUCHED_GAUGE.sub("", text))


def _remarks(text: str) -> dict[tuple[str, str], str]:
    """Comment beside each key, by table and key."""
    return {
        (table, key[1]): key[3] or ""
        for table, lines in _tables(text).items()
        for line in lines
        if (key := KEY.match(line))
    }


def _is_filled_in(before: str | None, now: str) -> bool:
    """Return True if a value is a person's, by the comments beside it before and now."""
    if before is None:
        return False
    return bool(MARK.search(before) or MARK.search(now) or (now and not before))


def _value(former: dict[str, Any], table: str, key: str) -> str | None:
    """Value of a key as TOML, None if it is no number or text that was filled in."""
    found: Any = former
    for name in [*table.split("."), key]:
        if not isinstance(found, dict) or name not in found:
            return None
        found = found[name]
    numbers = found if isinstance(found, list) else [found]
    if not isinstance(found, str) and not all(
        isinstance(one, int | float) and math.isfinite(one) for one in numbers
    ):
        return None
    return json.dumps(found, ensure_ascii=False)


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
