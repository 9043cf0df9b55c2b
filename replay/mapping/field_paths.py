"""Field paths such as «wheels.left.rate» or «data[0]», for messages of any type."""

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.replay.base.errors import ReplayError

SHORT = 4  # most elements of an array that are listed one by one
STEP = re.compile(r"\.?([A-Za-z_]\w*)|\[(\d+)\]")


def field_getter(path: str) -> Callable[[Any], float]:
    """Build a getter of a field of a message as a number.

    Args:
        path: names separated by dots, and indices of arrays.

    Raises:
        ReplayError: the path is invalid. The getter raises it if a field is missing or not a number, and
            IndexError if an array is too short.
    """
    steps: list[str | int] = []
    position = 0
    while position < len(path):
        step = STEP.match(path, position)
        if step is None or (step.group(0).startswith(".") and not steps):
            raise ReplayError(f"{path!r} is no path of a field; write it as wheels.left or data[0]")
        steps.append(step.group(1) or int(step.group(2)))
        position = step.end()

    def get(message: Any) -> float:
        value = message
        for step in steps:
            if isinstance(step, int):
                value = value[step]
            elif hasattr(value, step):
                value = getattr(value, step)
            else:
                within = "" if step == path else f" of {path!r}"
                raise ReplayError(f"no field {step!r}{within}{_fields_of(value)}")
        try:
            return float(value)
        except (TypeError, ValueError):
            raise ReplayError(f"field {path!r} is no number{_fields_of(value)}") from None

    return get


def _fields_of(value: Any) -> str:
    names = [name for name in getattr(value, "__dataclass_fields__", ()) if name[:2] != "__"]
    kind = getattr(value, "__msgtype__", type(value).__name__)
    return f"; {kind} has {', '.join(names)}" if names else f"; it is of type {kind}"


def number_paths(message: Any, depth: int = 3) -> list[str]:
    """List the paths of the numbers of a message to a depth, and of short arrays."""
    paths: list[str] = []
    for name in getattr(message, "__dataclass_fields__", ()):
        value = getattr(message, name)
        parts = [(name, value)]
        if isinstance(value, list | tuple | np.ndarray) and len(value) <= SHORT:
            parts = [(f"{name}[{place}]", part) for place, part in enumerate(value)]
        for path, part in parts:
            if isinstance(part, int | float | np.number) and name[:2] != "__":
                paths.append(path)
            elif depth > 1:
                paths += [f"{path}.{inner}" for inner in number_paths(part, depth - 1)]
    return paths


def field_reader(
    names: Sequence[str], make: Callable[[Floats], Floats] | None = None
) -> Callable[[Any], tuple[float, ...]]:
    """Build a reader of a message: a row made of the fields at some paths.

    The paths are read with the first message: of a topic of JointState they are names of joints, which
    may have any characters. `make` converts the values (1, k) to rows (1, m).
    """
    getters: list[Callable[[Any], float]] = []

    def read(message: Any) -> tuple[float, ...]:
        if not getters:
            getters.extend(map(field_getter, names))
        values = [get(message) for get in getters]
        return tuple(values if make is None else make(np.array([values]))[0].tolist())

    return read
