"""Field paths such as «wheels.left.rate» or «data[0]», for messages of any type."""

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.replay.base.errors import ReplayError

SHORT = 8  # most elements of an array that are listed one by one
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


def number_paths(message: Any, depth: int = 3) -> dict[str, str]:
    """List the numbers of a message to a depth: paths and the texts that name them.

    Such a text is in the same message, as of a device, or in a list of the same length, as of joints.
    """
    names = getattr(message, "__dataclass_fields__", ())
    fields = {name: getattr(message, name) for name in names if name[:2] != "__"}
    own = [value for value in fields.values() if isinstance(value, str)]
    lists = [value for value in fields.values() if isinstance(value, list) and value]
    lists = [value for value in lists if all(isinstance(one, str) for one in value)]
    paths: dict[str, str] = {}
    for name, value in fields.items():
        elements = [(name, value, "")]
        if isinstance(value, list | tuple | np.ndarray) and len(value) <= SHORT:
            texts = next((one for one in lists if len(one) == len(value)), [""] * len(value))
            elements = [(f"{name}[{k}]", value[k], text) for k, text in enumerate(texts)]
        for path, element, text in elements:
            if isinstance(element, int | float | np.number):
                paths[path] = " ".join([*own, text, ""])
            elif depth > 1:
                for inner, inner_text in number_paths(element, depth - 1).items():
                    paths[f"{path}.{inner}"] = " ".join([*own, text, inner_text])
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
