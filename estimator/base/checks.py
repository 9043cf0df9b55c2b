"""Checks of values in settings and robot files, for Python and TOML alike.

A failed check raises a `SettingError`, or the error class that it is given.
"""

import math
import numbers
from collections.abc import Iterable
from functools import cache
from types import NoneType
from typing import Annotated, Any, ClassVar, NamedTuple, cast, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import SettingError, nearest_hint


def is_number(value: object) -> bool:
    """Return True for a real number, NaN and infinity included, but not for a bool."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def is_finite(value: object) -> bool:
    """Return True for a finite real number within the range of a float."""
    try:
        return is_number(value) and math.isfinite(value)  # type: ignore[arg-type]
    except OverflowError:
        return False


# Largest coordinate or standard deviation of a start [m, rad]: its square is far from overflow.
LARGEST_START = 1e10
# Largest size and least positive value of a number in a file: no robot has others, and their squares and
# ratios do not overflow.
LARGEST_NUMBER, LEAST_POSITIVE = 1e9, 1e-12


class Bound(NamedTuple):
    """Allowed numbers of a field, as `Annotated[float, Bound("at least 1 s", 1.0)]`.

    Without an upper bound, numbers of a size beyond `LARGEST_NUMBER` are rejected. With a lower bound of
    zero, positive numbers below `LEAST_POSITIVE` are.
    """

    wanted: str  # description of them, for messages
    least: float = -math.inf  # lower bound
    most: float = math.inf  # upper bound
    above: bool = False  # numbers must be above the lower bound, not equal to it

    def require(self, name: str, value: object, error: type[Exception]) -> None:
        """Reject a value that is not an allowed finite number; `name` is for the message."""
        if is_number(value) and value != value:  # NaN, the placeholder in a new robot file
            raise error(f"{name} must be {self.wanted}, found nan: it is not filled in")
        # All else that is not a finite number is compared as NaN, which lies within no bounds.
        number = float(value) if is_finite(value) else math.nan  # type: ignore[arg-type]
        is_inside = self.least <= number <= self.most
        if not is_inside or (self.above and number == self.least):
            raise error(f"{name} must be {self.wanted}, found {value!r}")
        limit = ""
        if abs(number) > LARGEST_NUMBER and self.most == math.inf:
            limit = f"no larger than {LARGEST_NUMBER:g}"
        elif self.least == 0.0 < number < LEAST_POSITIVE:
            limit = f"no smaller than {LEAST_POSITIVE:g}"
        if limit:
            raise error(f"{name} must be {self.wanted}, {limit}, found {value!r}")


Finite = Annotated[float, Bound("finite")]
Positive = Annotated[float, Bound("a positive number", 0.0, above=True)]
NotNegative = Annotated[float, Bound("zero or a positive number", 0.0)]
# Size of a robot, and radius of its wheels [m].
RobotSize = Annotated[
    float, Bound("metres, more than 0 and 30 at most (not millimetres)", 0.0, 30.0, above=True)
]
Radius = Annotated[
    float, Bound("metres, more than 0 and 5 at most (not millimetres)", 0.0, 5.0, above=True)
]
# Part of another quantity; the standard deviation of a factor [-].
Share = Annotated[float, Bound("zero or a positive number, 100 at most", 0.0, 100.0)]
# Standard deviation of a factor near 1 [-].
SmallShare = Annotated[float, Bound("from 0 to 1 (0.05 is 5 %)", 0.0, 1.0)]
# Coordinate of a place on the robot [m].
OnRobot = Annotated[float, Bound("a number of metres, 100 at most", -100.0, 100.0)]
# Standard deviation and correlation time of fixes that wander [m, s].
WanderSigma = Annotated[float, Bound("from 0 to 1000 m", 0.0, 1000.0)]
WanderTime = Annotated[float, Bound("from 0 to 1e6 s", 0.0, 1e6)]
# Latency of stamps; later ones come from another clock [s].
Latency = Annotated[float, Bound("a number of seconds, 10 at most", -10.0, 10.0)]


def check_bounds(
    data: msgspec.Struct, name: str = "{}", error: type[Exception] = SettingError
) -> None:
    """Reject a structure with a number outside of the `Bound` of its field.

    Fields may be optional, or tuples. `name` is the format of their names in messages.
    """
    for field, (bound, hint) in _bounds(type(data)).items():
        value = getattr(data, field)
        for number in value if get_origin(hint) is tuple else [value]:
            if number is not None or NoneType not in get_args(hint):
                bound.require(name.format(field), number, error)


class Bounded(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of structures that `check_bounds` checks as they are made.

    Raises:
        SettingError: a number is outside of the `Bound` of its field.
    """

    NAMES: ClassVar[str] = "{}"
    """Format of the names of fields in messages."""

    def __post_init__(self) -> None:
        check_bounds(self, self.NAMES)


@cache
def _bounds(kind: type[msgspec.Struct]) -> dict[str, tuple[Bound, Any]]:
    """Fields with a bound, their bounds and types."""
    return {
        field: (bound, hint)
        for field, hint in get_type_hints(kind, include_extras=True).items()
        for part in (hint, *get_args(hint))
        for bound in getattr(part, "__metadata__", ())
        if isinstance(bound, Bound)
    }


def require_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Reject a value that is not one of the choices; the message gives the nearest."""
    if not (isinstance(value, str) and value in choices):
        raise SettingError(f"{name} cannot be {value!r}{nearest_hint(str(value), list(choices))}")


def require_flag(name: str, value: object) -> None:
    """Reject a value that is neither True nor False."""
    if not isinstance(value, bool | np.bool_):
        raise SettingError(f"{name} must be True or False, found {value!r}")


def require_kind(
    name: str, value: object, kind: type, *, or_none: bool = False, shown: bool = True
) -> None:
    """Reject a value that is not an instance of a structure, nor None if `or_none`.

    With `shown` False the message omits the value, which may be long.
    """
    if isinstance(value, kind) or (or_none and value is None):
        return
    wanted = f"{kind.__name__}(...){' or None' if or_none else ''}"
    found = f"{type(value).__name__} {value!r}" if shown else type(value).__name__
    raise SettingError(f"{name} must be {wanted}, found {found}")


def require_nanoseconds(first: int, last: int, count: int) -> None:
    """Reject `count` stamps from `first` to `last` [ns] if they are too dense.

    Mean intervals are at least 1 µs, or 25 µs of 500 stamps or more. Fewer than 30 may be a burst.
    """
    if count >= 30 and 0 < last - first < (25_000 if count >= 500 else 1000) * (count - 1):
        raise SettingError(
            f"stamps must be nanoseconds (round(seconds * 1e9)): {count} lie within {last - first} ns"
        )


def require_wander(sigma_name: str, sigma: float, time_name: str, time: float) -> None:
    """Reject a wander of fixes without its standard deviation [m] or its time [s]."""
    if sigma > 0.0 and not time > 0.0:
        raise SettingError(
            f"{sigma_name} = {sigma!r} needs {time_name}, the correlation time in seconds"
        )
    if time > 0.0 and not sigma > 0.0:
        raise SettingError(
            f"{time_name} = {time!r} needs {sigma_name}, the standard deviation in metres"
        )


def three_numbers(
    name: str, value: object, wanted: str, least: float = -math.inf
) -> tuple[float, float, float]:
    """Convert a tuple, list or array of three finite numbers to plain floats.

    Raises:
        SettingError: they are not three, or one is not a finite number, below `least`, or beyond
            `LARGEST_START`; the message has their `name`, and `wanted`, their description.
    """
    # An array without dimensions is an Iterable by its type, but cannot be iterated over.
    is_iterable = isinstance(value, Iterable) and getattr(value, "ndim", 1) > 0
    items: list[Any] = list(cast(Iterable[Any], value)) if is_iterable else []
    if len(items) != 3 or not all(is_finite(item) and item >= least for item in items):
        raise SettingError(f"{name} must be {wanted}, found {value!r}")
    x, y, yaw = (float(item) for item in items)
    if max(abs(x), abs(y), abs(yaw)) > LARGEST_START:
        wanted = f"{wanted}, none beyond {LARGEST_START:g}"
        raise SettingError(f"{name} must be {wanted}, found {value!r}")
    return x, y, yaw


def clipped_correlations(covariance: Floats) -> Floats:
    """Correlations of a finite matrix with positive variances, clipped to -2 to 2.

    Clipped ones are finite, and still beyond the ±1 of a covariance.
    """
    sigmas = np.sqrt(covariance.diagonal())
    with np.errstate(over="ignore"):
        return np.clip(covariance / sigmas / sigmas[:, None], -2.0, 2.0)
