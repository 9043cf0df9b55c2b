"""What settings and robot files may hold, checked where they are made, in Python as from a file."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable
from typing import Any, cast

import numpy as np

from icreckon.estimator.base.errors import SettingError, nearest_hint


def is_number(value: object) -> bool:
    """Whether it is a real number, NaN and infinity among them; True and False are none."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """Whether it is a whole number; True and False are none."""
    return isinstance(value, numbers.Integral) and is_number(value)


def is_finite(value: object) -> bool:
    """Whether it is a finite real number, not beyond what a float can hold."""
    try:
        return is_number(value) and math.isfinite(value)  # type: ignore[arg-type]
    except OverflowError:
        return False


def require_finite(name: str, *values: object) -> None:
    """Refuse what is no finite number.

    Raises:
        SettingError: one of the values is none.
    """
    for value in values:
        if not is_finite(value):
            raise SettingError(f"{name} must be finite, found {value!r}")


def require_positive(name: str, value: object) -> None:
    """Refuse what is no finite number above zero.

    Raises:
        SettingError: the value is none.
    """
    if is_number(value) and value != value:
        raise SettingError(f"{name} must be a positive number, found nan: it is not filled in")
    require_from(name, value, 0.0, "a positive number", beyond=True)


def require_not_negative(name: str, value: object) -> None:
    """Refuse what is no finite number from zero on.

    Raises:
        SettingError: the value is none.
    """
    require_from(name, value, 0.0, "zero or a positive number")


def require_from(
    name: str, value: object, least: float, wanted: str, *, beyond: bool = False
) -> None:
    """Refuse what is no finite number from some value on.

    Args:
        name: of the figure, for the message.
        value: the figure.
        least: the smallest that it may be.
        wanted: what it must be, for the message.
        beyond: whether it must be more than that.

    Raises:
        SettingError: the value is not so.
    """
    if is_finite(value):
        number = float(value)  # type: ignore[arg-type]
        if number > least or (number == least and not beyond):
            return
    raise SettingError(f"{name} must be {wanted}, found {value!r}")


def require_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Refuse what is none of the choices.

    Raises:
        SettingError: the message names the nearest, or all.
    """
    if not (isinstance(value, str) and value in choices):
        raise SettingError(f"{name} cannot be {value!r}{nearest_hint(str(value), list(choices))}")


def require_flag(name: str, value: object) -> None:
    """Refuse what is neither True nor False.

    Raises:
        SettingError: the value is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise SettingError(f"{name} must be True or False, found {value!r}")


def require_kind(name: str, value: object, kind: type, *, or_none: bool = False) -> None:
    """Refuse what is not made by the structure that belongs there.

    Args:
        name: of the field, for the message.
        value: its value.
        kind: the structure.
        or_none: whether None will do, too.

    Raises:
        SettingError: the value is something else.
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
    """Three finite numbers as plain floats.

    Args:
        name: of the argument, for the message.
        value: a tuple, list or array of three.
        wanted: what the three are, for the message.
        least: the smallest that they may be.

    Raises:
        SettingError: they are not three, or one is no finite number or too small.
    """
    listed = isinstance(value, Iterable) and getattr(value, "ndim", 1) > 0
    items: list[Any] = list(cast(Iterable[Any], value)) if listed else []
    if len(items) != 3 or not all(is_finite(item) and item >= least for item in items):
        raise SettingError(f"{name} must be {wanted}, found {value!r}")
    x, y, yaw = (float(item) for item in items)
    return x, y, yaw
