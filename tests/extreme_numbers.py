"""Every number of a configuration, by its types, in place of which a test puts extreme ones."""

import copy
import itertools
import types
import typing
from collections.abc import Iterator
from typing import Any

import msgspec

Path = tuple[str | int, ...]

EXTREMES = (
    1e-308, -1e-308, 1e308, -1e308, 2**63 - 1, -(2**63), 1e-12, 1e12, -0.0, float("inf"),
    float("-inf"), float("nan"),
)  # fmt: skip


def number_paths(kind: Any, path: Path = (), name: str = "name") -> Iterator[Path]:
    """Yield the path of each number of a type: keys of tables and places in lists.

    Tables with keys of any name have one of the given name.
    """
    if typing.get_origin(kind) is typing.Annotated:
        kind = typing.get_args(kind)[0]
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if kind in (int, float):
        yield path
    elif isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        for field, hint in typing.get_type_hints(kind, include_extras=True).items():
            yield from number_paths(hint, (*path, field), name)
    elif origin in (typing.Union, types.UnionType):
        for part in parts:
            yield from number_paths(part, path, name)
    elif origin is tuple:
        inner = parts[:1] if parts[-1] is Ellipsis else parts
        for place, part in enumerate(inner):
            yield from number_paths(part, (*path, place), name)
    elif origin is dict:
        yield from number_paths(parts[1], (*path, name), name)


def with_number(data: dict[str, Any], path: Path, value: float) -> dict[str, Any]:
    """Copy of nested tables and lists with another number at a path."""
    result = copy.deepcopy(data)
    place: Any = result
    for key, after in itertools.pairwise(path):
        if isinstance(place, dict):
            place = place.setdefault(key, [] if isinstance(after, int) else {})
        else:
            place += [{}] * (int(key) + 1 - len(place))
            place = place[key]
    last = path[-1]
    if isinstance(place, list):
        # Of pairs the first is smaller.
        place += [float(k) for k in range(len(place), int(last) + 1)]
    place[last] = value
    return result


def shown(path: Path) -> str:
    """The path as a name of a test."""
    return ".".join(map(str, path))
