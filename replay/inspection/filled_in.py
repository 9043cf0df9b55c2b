"""Preservation of values and tables that a person put into a proposed robot file."""

import math
import re
import textwrap
import tomllib
from pathlib import Path
from typing import Any
from zlib import crc32

from icreckon.estimator.robot.robot_toml import toml_value
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.inspection.log_estimates import NO_SIZES, Sizes

TABLE = re.compile(r"\[([^\[\]]+)\]\s*(?:#.*)?$")
KEY = re.compile(r"(\w+)\s*=")
# A gauge stands in for the one that only a person can measure.
STAND_IN_GAUGE = re.compile(
    r"^track_gauge = ([\d.e+-]+) *# .*the effective track \(\1\).*$", re.MULTILINE
)
# Keys that belong together: fields and units are those of one topic.
TOPIC_KEYS = {"topic", "right_topic", "left", "right", "unit", "wrap"}
MARK = "#~"
MARKS = f"# Values as proposed, by marks ({MARK}): inspect --overwrite keeps all others."


def with_filled_in(proposed: str, path: Path) -> tuple[str, list[str]]:
    """Take over from an earlier proposal what a person filled in, changed or added.

    The text has a mark of each proposed value, by which the next proposal recognises those of a person.
    The list names what was taken over, as "vehicle.mass", or "[soil]" for a table.

    Raises:
        ReplayError: the earlier file is no TOML file.
    """
    former_text, filled_in = _read_filled_in(path)
    proposed_values = _values(tomllib.loads(proposed))
    lines, kept, table = [], [], ""

    def keep(key: str) -> None:
        """Write a person's value of this table."""
        lines.append(f"{key} = {toml_value(filled_in[table][key])}    # as filled in before")
        kept.append(f"{table}.{key}".lstrip("."))

    for line in proposed.splitlines():
        header, assignment = TABLE.match(line), KEY.match(line.removeprefix("# "))
        key = assignment[1] if assignment else ""
        if header:
            table = header[1]
            lines.append(line)
            for added_key in filled_in.get(table, {}):
                if added_key not in proposed_values.get(table, {}):
                    keep(added_key)
        elif key not in filled_in.get(table, {}):
            lines.append(line)
        elif not line.startswith("#"):
            # A value whose proposed line is commented out was added at the top of its table already.
            keep(key)
    for name, table_lines in _tables(former_text).items():
        if name not in _tables(proposed) and name in filled_in:
            lines += ["", *table_lines]
            kept.append(f"[{name}]")
    marks = []
    for table, values in proposed_values.items():
        own = values.keys() - filled_in.get(table, {}).keys()
        marks += [_mark(table, key, values[key]) for key in values if key in own]
    # Space for "#~ " remains in lines of 100 characters.
    lines += ["", MARKS, *(f"{MARK} {line}" for line in textwrap.wrap(" ".join(marks), 97))]
    return "\n".join(lines) + "\n", kept


def has_stand_in_gauge(proposed: str) -> bool:
    """Return True if the track gauge of a proposal is the effective track of the log."""
    return STAND_IN_GAUGE.search(proposed) is not None


def filled_in_sizes(path: Path) -> Sizes:
    """Lengths and streams by a person in an earlier proposal; none if unreadable."""
    try:
        text, filled_in = _read_filled_in(path)
    except ReplayError:
        return NO_SIZES

    def length(table: str, key: str) -> float | None:
        value = filled_in.get(table, {}).get(key)
        return value if isinstance(value, float | int) and value > 0.0 else None

    log = {}
    for table, values in _values(tomllib.loads(text)).items():
        if table.startswith("log.") and table in filled_in:
            # If a person changed one of the topic keys of a stream, the proposed others hold, too.
            topic_keys = {key: value for key, value in values.items() if key in TOPIC_KEYS}
            log[table.removeprefix("log.")] = topic_keys | filled_in[table]
    gauge, radius = length("vehicle", "track_gauge"), length("vehicle", "sprocket_radius")
    return Sizes(gauge, radius, length("log.tracks", "gauge"), log)


def _read_filled_in(path: Path) -> tuple[str, dict[str, dict[str, Any]]]:
    """Text of an earlier proposal, and a person's values in it by table and key."""
    # A value is a person's if it is set and has no mark. Without the file there are none.
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        former = _values(tomllib.loads(text))
    except (ValueError, OSError) as problem:
        raise ReplayError(
            f"{path}: what was filled in cannot be read: {problem}; correct or move the file"
        ) from None
    marks = {mark for line in text.splitlines() if line.startswith(MARK) for mark in line.split()}
    filled_in: dict[str, dict[str, Any]] = {}
    for table, values in former.items():
        for key, value in values.items():
            if _is_set(value) and _mark(table, key, value) not in marks:
                filled_in.setdefault(table, {})[key] = value
    return text, filled_in


def _values(table: dict[str, Any], name: str = "") -> dict[str, dict[str, Any]]:
    """Values of a table and its subtables, by dotted table names and keys."""
    tables: dict[str, dict[str, Any]] = {name: {}}
    for key, value in table.items():
        if isinstance(value, dict):
            tables |= _values(value, f"{name}.{key}".lstrip("."))
        else:
            tables[name][key] = value
    return tables


def _mark(table: str, key: str, value: Any) -> str:
    """Checksum of a proposed value, which shows later that nobody changed it."""
    return f"{crc32(f'{table}.{key} = {toml_value(value)}'.encode()) & 0xFFFFF:05x}"


def _is_set(value: Any) -> bool:
    """Return True for texts, finite numbers and lists of them; NaN is a placeholder."""
    parts = value if isinstance(value, list) else [value]
    is_known = (isinstance(part, str | int | float) for part in parts)
    return all(is_known) and all(math.isfinite(part) for part in parts if isinstance(part, float))


def _tables(text: str) -> dict[str, list[str]]:
    """Lines of each table of a TOML file, by name, without marks and last blank lines."""
    tables: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if header := TABLE.match(line):
            lines = tables.setdefault(header[1], [])
        if not line.startswith((MARKS, MARK)):
            lines.append(line)
    for lines in tables.values():
        while lines and not lines[-1].strip():
            lines.pop()
    return tables
