"""Conversion of plain Python data to the declared types of fields, and bounds."""

import os
from functools import cache
from typing import Any

import msgspec
import numpy as np

from icreckon.estimator.base.checks import check_bounds
from icreckon.simulation.base.errors import SimulationError


def settle_types(data: msgspec.Struct, field: str = "{}") -> None:
    """Convert every field of a new structure to its declared type, if lossless.

    Integers become floats, lists become tuples, paths become strings, NumPy's values plain numbers.

    Args:
        data: the structure, as in its `__post_init__`; changed in place.
        field: template of a field's name in messages about bounds, as "{} of a patch".

    Raises:
        SimulationError: a value of another type or out of its bounds; the message names the field.
    """
    for name, kind in _fields(type(data)):
        try:
            value = msgspec.convert(_plain(getattr(data, name)), kind)
        except msgspec.ValidationError as problem:
            raise SimulationError(f"{name} of a {type(data).__name__}: {problem}") from None
        msgspec.structs.force_setattr(data, name, value)
    check_bounds(data, field, SimulationError)


@cache
def _fields(kind: type[msgspec.Struct]) -> list[tuple[str, Any]]:
    """Names and types of a structure's fields; cached, as finding them is slow."""
    return [(field.name, field.type) for field in msgspec.structs.fields(kind)]


def _plain(value: Any) -> Any:
    """Value in plain Python types, as msgspec converts them."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, list | tuple):
        return tuple(_plain(part) for part in value)
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    return value
