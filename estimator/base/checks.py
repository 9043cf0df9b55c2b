"""Checks of values in settings and robot files, for Python and TOML alike."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable
from typing import Any, cast

import numpy as np

from icreckon.estimator.base.errors import SettingError, nearest_hint


def is_number(value: object) -> bool:
    """Return True for a real number, NaN and infinity included, but not for a bool."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """Return True for a whole number, but not for a bool."""
    return isinstance(value, numbers.Integral) and is_number(value)


def is_finite(value: object) -> bool:
    """Return True for a finite real number within the range of a float."""
    try:
        return is_number(value) and math.isfinite(value)  # type: ignore[arg-type]
    except OverflowError:
        return False


def require_finite(name: str, *values: object) -> None:
    """Reject values that are not finite numbers.

    Raises:
        SettingError: one of the values is not.
    """
    for value in values:
        if not is_finite(value):
            raise SettingError(f"{name} must be finite, found {value!r}")


def require_positive(name: str, value: object) -> None:
    """Reject a value that is not a finite number above zero.

    Raises:
        SettingError: the value is not.
    """
    if is_number(value) and value != value:
        raise SettingError(f"{name} must be a positive number, found nan: it is not filled in")
    require_from(name, value, 0.0, "a positive number", beyond=True)


def require_not_negative(name: str, value: object) -> None:
    """Reject a value that is not zero or a finite positive number.

    Raises:
        SettingError: the value is not.
    """
    require_from(name, value, 0.0, "zero or a positive number")


def require_from(
    name: str, value: object, least: float, wanted: str, *, beyond: bool = False
) -> None:
    """Reject a value that is not a finite number of at least `least`.

    Args:
        name: name of the value, for the message.
        value: the value.
        least: lower bound.
        wanted: description of valid values, for the message.
        beyond: True to exclude the bound itself.

    Raises:
        SettingError: the value is out of range.
    """
    if is_finite(value):
        number = float(value)  # type: ignore[arg-type]
        if number > least or (number == least and not beyond):
            return
    raise SettingError(f"{name} must be {wanted}, found {value!r}")


def require_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Reject a value that is not one of the choices.

    Raises:
        SettingError: the message names the nearest, or all.
    """
    if not (isinstance(value, str) and value in choices):
        raise SettingError(f"{name} cannot be {value!r}{nearest_hint(str(value), list(choices))}")


def require_flag(name: str, value: object) -> None:
    """Reject a value that is neither True nor False.

    Raises:
        SettingError: the value is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise SettingError(f"{name} must be True or False, found {value!r}")


def require_kind(name: str, value: object, kind: type, *, or_none: bool = False) -> None:
    """Reject a value that is not an instance of a structure.

    Args:
        name: name of the field, for the message.
        value: its value.
        kind: the structure.
        or_none: True to allow None, too.

    Raises:
        SettingError: the value has another type.
    """
    if isinstance(value, kind) or (or_none and value is None):
        return
    leave_out = " or None" if or_none else ""
    raise SettingError(
        f"{name} must be {kind.__name__}(...){leave_out}, found {type(value).__name__} {value!r}"
    )


def three_numbers(
    name: str, value: object, wanted: str, least: float = -math.inf
) -> tuple[float, float, float]:
    """Convert three finite numbers to plain floats.

    Args:
        name: name of the argument, for the message.
        value: a tuple, list or array of three.
        wanted: description of the three, for the message.
        least: lower bound of each.

    Raises:
        SettingError: they are not three, or one is not a finite number or too small.
    """
    listed = isinstance(value, Iterable) and getattr(value, "ndim", 1) > 0
    items: list[Any] = list(cast(Iterable[Any], value)) if listed else []
    if len(items) != 3 or not all(is_finite(item) and item >= least for item in items):
        raise SettingError(f"{name} must be {wanted}, found {value!r}")
    x, y, yaw = (float(item) for item in items)
    return x, y, yaw
