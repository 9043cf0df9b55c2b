"""Checked configuration from TOML; errors name the nearest valid key."""

import re
import tomllib
import types
import typing
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from icreckon.estimator.base.errors import IcreckonError, nearest_hint

T = TypeVar("T", bound=msgspec.Struct)

AT = re.compile(r" - at `\$\.?(.*)`$", re.DOTALL)
ANY_KEY = "[...]"
STEP = re.compile(r"\[[^\]]*\]|[^.\[\]]+")
EXPECTED, GOT = re.compile(r"^Expected `([^`]*)`"), re.compile(r", got `([^`]*)`")
NO_CHOICE = "Invalid enum value "
MISSING = re.compile(r"^Object missing required field (`[^`]*`)")
KINDS = {
    "object": "a table",
    "array": "a list",
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
}
"""Types of msgspec's messages in words."""


def read_toml(path: Path, error: type[IcreckonError]) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        error: the file is missing, unreadable, not valid TOML, or has lists that are too deep.
    """
    try:
        # Editors of Windows begin a file with a mark of its encoding.
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except OSError as problem:
        raise error(f"{path}: cannot be read: {problem}") from None
    except UnicodeDecodeError:
        raise error(
            f"{path}: cannot be read: it is not UTF-8; `iconv -f latin1 -t utf-8` converts it"
        ) from None
    try:
        return tomllib.loads(text)
    except ValueError as problem:
        # Of TOML, or of Python for a number of thousands of digits.
        raise error(f"{path}: not a valid TOML file: {problem}") from None
    except RecursionError:
        raise error(
            f"{path}: not a valid TOML file: tables or lists within each other, too deep"
        ) from None


def convert(data: dict[str, Any], kind: type[T], source: str, error: type[IcreckonError]) -> T:
    """Convert nested dictionaries, as read from TOML, to a checked msgspec structure.

    `source` is the file name or option, for messages.

    Raises:
        error: an unknown key (the message names the nearest valid one), a wrong type or a bad value.
    """
    _refuse_unknown_keys(data, kind, source, "", error)
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as problem:
        raise error(f"{source}: {in_words(str(problem), data, kind)}") from None


def in_words(problem: str, data: dict[str, Any], kind: type[msgspec.Struct]) -> str:
    """Rephrase a validation error, as "[gyro] bias_walk: expected a number"."""
    end = AT.search(problem)
    text, path = (problem[: end.start()], end.group(1)) if end else (problem, "")
    text = EXPECTED.sub(lambda parts: f"expected {_kinds(parts[1])}", text)
    text = GOT.sub(lambda parts: f", found {_kinds(parts[1])}", text)
    text = MISSING.sub(r"\1 is missing", text)
    if text.startswith(NO_CHOICE):
        choices = ", ".join(_choices(kind, STEP.findall(path)))
        text = f"expected one of {choices}, found {text.removeprefix(NO_CHOICE)}"
    steps, value = _steps_to_value(STEP.findall(path), data)
    table_steps = steps if isinstance(value, dict) else steps[:-1]
    names = [step for step in table_steps if not step.startswith("[")]
    leaf = "" if isinstance(value, dict) or not steps else steps[-1]
    if leaf.startswith("["):
        # An item of a list: the key is that of the list.
        leaf, names = (names[-1], names[:-1]) if names else ("", names)
    numbers = [f"number {int(step[1:-1]) + 1}" for step in steps if step[1:-1].isdigit()]
    table = f"[{'.'.join(names)}]" if names else ""
    where = " ".join(filter(None, [table, leaf, *numbers]))
    return f"{where}: {text}" if where else text


def _steps_to_value(path: list[str], data: Any) -> tuple[list[str], Any]:
    """Steps of a path, as ["log", "tracks", "[0]"], and the value where it ends."""
    steps, value = [], data
    for step in path:
        key: Any = step
        if step == ANY_KEY:
            # The key of a free table is not in the message.
            key = next(iter(value)) if len(value) == 1 else None
        elif step[1:-1].isdigit():
            key = int(step[1:-1])
        steps.append(str(key) if step == ANY_KEY and key is not None else step)
        value = value[key] if key is not None and isinstance(value, dict | list) else {}
    return steps, value


def _choices(annotation: Any, steps: list[str]) -> list[str]:
    """Texts that a field allows, in quotes; the steps lead to it from a structure."""
    for step in steps:
        for struct in _structs_in(annotation):
            annotation = typing.get_type_hints(struct).get(step, annotation)
    if typing.get_origin(annotation) is typing.Literal:
        return [repr(text) for text in typing.get_args(annotation)]
    return [text for part in typing.get_args(annotation) for text in _choices(part, [])]


def _kinds(names: str) -> str:
    """Types of a message in words, without the null of optional ones."""
    return " or ".join(KINDS.get(name, name) for name in names.split(" | ") if name != "null")


def _refuse_unknown_keys(
    data: dict[str, Any], kind: Any, source: str, table: str, error: type[IcreckonError]
) -> None:
    """Reject keys that a structure lacks, in nested tables and lists of tables, too."""
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
    for key, value in data.items():
        if key not in fields:
            where = f" in [{table}]" if table else ""
            raise error(f"{source}: unknown key {key!r}{where}{nearest_hint(key, list(fields))}")
        annotation, path = fields[key], f"{table}.{key}" if table else key
        nested = [(path, item) for item in (value if isinstance(value, list) else [value])]
        if typing.get_origin(annotation) is dict and isinstance(value, dict):
            annotation = typing.get_args(annotation)[1]
            nested = [(f"{path}.{name}", item) for name, item in value.items()]
        for nested_kind, (nested_path, item) in product(_structs_in(annotation), nested):
            if isinstance(item, dict):
                _refuse_unknown_keys(item, nested_kind, source, nested_path, error)


def _structs_in(annotation: Any) -> list[Any]:
    """Structures that a field of this type may hold, through unions and lists."""
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    if typing.get_origin(annotation) in (typing.Union, types.UnionType, list, tuple):
        return [kind for part in typing.get_args(annotation) for kind in _structs_in(part)]
    return []
