"""Numbers and tables that a person put into a proposed robot file, kept."""

import math
import re
import textwrap
import tomllib
from pathlib import Path
from typing import Any
from zlib import crc32

from icreckon.estimator.robot.robot_toml import toml_value
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.inspection.robot_file import NO_SIZES, Sizes

TABLE = re.compile(r"\[([^\[\]]+)\]\s*(?:#.*)?$")
KEY = re.compile(r"(\w+)\s*=")
# A gauge stands in for the one that only a person can measure.
STAND_IN_GAUGE = re.compile(
    r"^track_gauge = ([\d.e+-]+) *# .*the effective track \(\1\).*$", re.MULTILINE
)
OF_TOPICS = {"topic", "right_topic", "left", "right", "unit", "wrap"}
MARK = "#~"
MARKS = f"# Values as proposed, by marks ({MARK}): inspect --overwrite keeps all others."


def with_filled_in(proposed: str, path: Path) -> tuple[str, list[str]]:
    """Take over from an earlier proposal what a person filled in, changed or added.

    Returns:
        The text with a mark of each proposed value, by which the next proposal recognises those of a
        person, and the names of what was taken over, as "vehicle.mass", or "[soil]" for a table.

    Raises:
        ReplayError: the earlier file is no TOML file.
    """
    text, own = _own(path)
    new, lines, taken = _values(tomllib.loads(proposed)), [], []

    def keep_own_value(table: str, key: str) -> None:
        lines.append(f"{key} = {toml_value(own[table][key])}    # as filled in before")
        taken.append(f"{table}.{key}".lstrip("."))

    table = ""
    for line in proposed.splitlines():
        key = KEY.match(line.removeprefix("# "))
        if found := TABLE.match(line):
            table = found[1]
            lines.append(line)
            for name in own.get(table, {}):
                if name not in new.get(table, {}):
                    keep_own_value(table, name)
        elif key is not None and key[1] in own.get(table, {}):
            # A key that the proposal comments out was written at the top of its table above.
            if not line.startswith("#"):
                keep_own_value(table, key[1])
        else:
            lines.append(line)
    for name, of_table in _tables(text).items():
        if name not in _tables(proposed) and name in own:
            lines += ["", *of_table]
            taken.append(f"[{name}]")
    marks = [
        _mark(table, key, value)
        for table, values in new.items()
        for key, value in values.items()
        if key not in own.get(table, {})
    ]
    lines += [
        "",
        MARKS,
        *textwrap.wrap(
            " ".join(marks), 100, initial_indent=f"{MARK} ", subsequent_indent=f"{MARK} "
        ),
    ]
    return "\n".join(lines) + "\n", taken


def has_stand_in_gauge(proposed: str) -> bool:
    """Return True if the track gauge of a proposal is the effective track of the log."""
    return STAND_IN_GAUGE.search(proposed) is not None


def filled_in_sizes(path: Path) -> Sizes:
    """Lengths and streams that a person filled in; none if the file cannot be read."""
    try:
        text, own = _own(path)
    except ReplayError:
        return NO_SIZES
    former = _values(tomllib.loads(text))
    vehicle, tracks = own.get("vehicle", {}), own.get("log.tracks", {})
    lengths = (vehicle.get("track_gauge"), vehicle.get("sprocket_radius"), tracks.get("gauge"))
    gauge, radius, of_controller = (
        length if isinstance(length, float | int) and length > 0.0 else None for length in lengths
    )
    # Keys of a person belong to the topics of the same table, in any log.
    log = {
        name[4:]: {key: former[name][key] for key in OF_TOPICS & {*former[name]}} | keys
        for name, keys in own.items()
        if name.startswith("log.")
    }
    return Sizes(gauge, radius, of_controller, log)


def _own(path: Path) -> tuple[str, dict[str, dict[str, Any]]]:
    """Text of an earlier proposal, and the values that a person set, by table and key."""
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        former = _values(tomllib.loads(text))
    except (ValueError, OSError) as problem:
        raise ReplayError(
            f"{path}: what was filled in cannot be read: {problem}; correct or move the file"
        ) from None
    marks = {mark for line in text.splitlines() if line.startswith(MARK) for mark in line.split()}
    own = {
        table: {
            key: value
            for key, value in values.items()
            if _is_set(value) and _mark(table, key, value) not in marks
        }
        for table, values in former.items()
    }
    return text, {table: values for table, values in own.items() if values}


def _values(table: dict[str, Any], name: str = "") -> dict[str, dict[str, Any]]:
    """Values of all tables, by their dotted names and keys."""
    found: dict[str, dict[str, Any]] = {name: {}}
    for key, value in table.items():
        if isinstance(value, dict):
            found |= _values(value, f"{name}.{key}".lstrip("."))
        else:
            found[name][key] = value
    return found


def _mark(table: str, key: str, value: Any) -> str:
    """Checksum of a proposed value, which reveals later that a person changed it."""
    return f"{crc32(f'{table}.{key} = {toml_value(value)}'.encode()) & 0xFFFFF:05x}"


def _is_set(value: Any) -> bool:
    """Return True for texts and finite numbers, and lists of them."""
    parts = value if isinstance(value, list) else [value]
    return all(
        isinstance(one, str | int) or (isinstance(one, float) and math.isfinite(one))
        for one in parts
    )


def _tables(text: str) -> dict[str, list[str]]:
    """Lines of each table of a TOML file, by its name, without trailing blank lines."""
    found: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if name := TABLE.match(line):
            lines = found.setdefault(name[1], [])
        if not line.startswith((MARKS, MARK)):
            lines.append(line)
    for lines in found.values():
        while lines and not lines[-1].strip():
            lines.pop()
    return found
