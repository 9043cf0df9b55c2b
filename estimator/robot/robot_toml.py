"""Robot file of a robot, as text."""

import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import msgspec

from icreckon.estimator.robot.robot_file import Robot

# Tables of a robot file in order, before those of variants and logs.
TABLES = (
    "vehicle", "indices", "constant_icr", "imu", "tracks", "slope", "undetected_slip", "soil",
)  # fmt: skip
DIGITS = 7  # significant digits of the numbers of a robot, which may be computed
COMMENT_AT = 40  # column at which the comments of short lines are aligned


def robot_toml(
    robot: Robot, comments: Mapping[str, Mapping[str, str]] = MappingProxyType({})
) -> str:
    """Format a robot as the text of a robot file, as input of `load_robot`.

    Comments are by table and key.
    """
    lines = [f"name = {toml_value(robot.name)}", f"format = {robot.format}"]
    if robot.note:
        lines.append(f"note = {toml_value(robot.note)}")
    for name in TABLES:
        values = getattr(robot, name)
        if values is not None:
            lines += _table_lines(name, values, comments.get(name, {}))
    for variant, slip in robot.slip.items():
        lines += _table_lines(f"slip.{_key(variant)}", slip, {})
    for name, table in robot.log.items():
        lines += _tree_lines(f"log.{_key(name)}", table)
    return "\n".join(lines) + "\n"


def _table_lines(name: str, values: msgspec.Struct, comments: Mapping[str, str]) -> list[str]:
    """Lines of a table after a blank one; a value of None is left out."""
    fields = ((key, _rounded(getattr(values, key))) for key in values.__struct_fields__)
    lines = [_line(key, value, comments.get(key, "")) for key, value in fields if value is not None]
    return ["", f"[{name}]", *lines]


def _tree_lines(name: str, table: Any) -> list[str]:
    """Format a table of the mapping, nested tables last."""
    plain = {key: value for key, value in table.items() if not isinstance(value, dict)}
    lines = ["", f"[{name}]", *(_line(_key(key), value, "") for key, value in plain.items())]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += _tree_lines(f"{name}.{_key(key)}", value)
    return lines


def _line(key: str, value: Any, comment: str) -> str:
    """Line of a key and its value, with a comment if there is one."""
    line = f"{key} = {toml_value(value)}"
    return f"{line:{COMMENT_AT}} # {comment}" if comment else line


def _key(name: str) -> str:
    """Key, in quotes if it needs them."""
    return name if name.replace("-", "").replace("_", "").isalnum() else json.dumps(name)


def _rounded(value: Any) -> Any:
    """Round a number, or a tuple of numbers, to `DIGITS` significant digits."""
    if isinstance(value, tuple):
        return tuple(map(_rounded, value))
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def toml_value(value: Any) -> str:
    """Format a value; numbers are exact."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, int):
        return str(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    # JSON's escapes are a subset of TOML's.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
