"""Field paths such as «wheels.left.rate» or «data[0]», for messages of any type."""

import re
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.replay.base.errors import ReplayError

STEP = re.compile(r"\.?([A-Za-z_]\w*)|\[(\d+)\]")


def field_getter(path: str) -> Callable[[Any], float]:
    """Build a getter of a field of a message as a number.

    The getter raises `ReplayError` if a field is missing or not a number, and IndexError if an array
    is too short.

    Args:
        path: names separated by dots, and indices of arrays.

    Raises:
        ReplayError: the path is invalid.
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
                raise ReplayError(f"no field {step!r} of {path!r}{_fields_of(value)}")
        try:
            return float(value)
        except (TypeError, ValueError):
            raise ReplayError(f"field {path!r} is no number{_fields_of(value)}") from None

    return get


def _fields_of(value: Any) -> str:
    names = [name for name in getattr(value, "__dataclass_fields__", ()) if name[:2] != "__"]
    kind = getattr(value, "__msgtype__", type(value).__name__)
    return f"; {kind} has {', '.join(names)}" if names else f"; it is of type {kind}"


class FieldReader:
    """Reader of a message: a row made of some of its fields.

    The paths are read with the first message: of a topic of JointState they are names of joints, which
    may have any characters.

    Args:
        names: paths of the fields.
        make: function from the values (1, k) to the rows (1, m); None for the values themselves.
    """

    def __init__(self, names: Sequence[str], make: Callable[[Floats], Floats] | None) -> None:
        self._names, self._make = names, make

    @cached_property
    def _getters(self) -> list[Callable[[Any], float]]:
        return [field_getter(name) for name in self._names]

    def __call__(self, message: Any) -> tuple[float, ...]:  # noqa: D102
        values = [get(message) for get in self._getters]
        return tuple(values if self._make is None else self._make(np.array([values]))[0].tolist())
