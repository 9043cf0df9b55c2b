"""Elementary functions of traced numbers, and traced copies of plain functions."""

import math
from collections.abc import Callable
from types import FunctionType, SimpleNamespace
from typing import Any

from icreckon.estimator.tracing.trace import (
    Traced,
    function_of_exp,
    lift,
    maximum,
    minimum,
    power_of_two,
    rounded,
    select,
)

# Functions of these modules are traced, or compiled, if traced or compiled ones call them.
LIBRARY = "icreckon.estimator."

# pi / 2 in three parts, of which the first two have 33 bits: a whole multiple of up to 2^20 is exact
# (Cody and Waite, Software Manual for the Elementary Functions, 1980, ch. 8).
# In single precision the first two have 12 and 11.
HALF_PI = {
    64: (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    32: (1.5703125, 4.837512969970703125e-4, 7.549789954891882e-8),
}
# ln 2 in two parts, of which the first has 32 bits (16 in single precision), and the number of terms of
# the series on -ln 2 / 2 to ln 2 / 2.
LN_2 = {
    64: (6.93147180369123816490e-01, 1.90821492927058770002e-10, 13),
    32: (0.693145751953125, 1.4286068203094172e-06, 7),
}
# Lower exponents give the number of this one, which is close to the smallest normal number.
LEAST_EXPONENT = {64: -708.0, 32: -87.0}


def exponential(exponent: Any) -> Any:
    """Exponential of a number of zero or less, within two units in the last place."""
    if not isinstance(exponent, Traced):
        return math.exp(exponent)
    if Traced.has_exp:
        return function_of_exp(exponent)
    bits = Traced.bits
    high, low, terms = LN_2[bits]
    exponent = maximum(exponent, LEAST_EXPONENT[bits])
    halvings = rounded(exponent * (1.0 / math.log(2.0)))
    r = exponent - halvings * high - halvings * low
    series = lift(1.0 / math.factorial(terms))
    for k in range(terms - 1, -1, -1):
        series = series * r + 1.0 / math.factorial(k)
    return series * power_of_two(halvings)


def sine_and_cosine(angle: Any) -> tuple[Any, Any]:
    """Sine and cosine of an angle, within two units in the last place of one.

    Angles are up to some 1e5 rad (1e3 in single precision). The Taylor series on -pi/4 to pi/4 ends where
    the rest is below 1e-17.
    """
    if not isinstance(angle, Traced):
        return math.sin(angle), math.cos(angle)
    quadrant = rounded(angle * (2.0 / math.pi))
    r = angle
    for part in HALF_PI[Traced.bits]:
        r = r - quadrant * part
    square = r * r
    sine, cosine = lift(0.0), lift(0.0)
    for k in range(8, 0, -1):
        sine = square * (sine + (-1.0) ** k / math.factorial(2 * k + 1))
        cosine = square * (cosine + (-1.0) ** k / math.factorial(2 * k))
    sine, cosine = r + r * sine, 1.0 + cosine
    fourth = quadrant - 4.0 * rounded(quadrant * 0.25 - 0.375)  # number of the quadrant, 0 to 3
    swaps = (fourth == 1.0) | (fourth == 3.0)
    sine, cosine = select(swaps, cosine, sine), select(swaps, sine, cosine)
    sine = select(fourth >= 2.0, -sine, sine)
    return sine, select((fourth == 1.0) | (fourth == 2.0), -cosine, cosine)


_FUNCTIONS = SimpleNamespace(
    sin=lambda angle: sine_and_cosine(angle)[0],
    cos=lambda angle: sine_and_cosine(angle)[1],
    sqrt=lambda value: value**0.5,
    exp=exponential,
    expm1=math.expm1,
    pi=math.pi,
)
# Names in functions of plain numbers, and their values for traced ones.
PLAIN: dict[str, Any] = {
    "max": maximum,
    "min": minimum,
    "float": lambda value: value,
    "select": select,
    "math": _FUNCTIONS,
    "np": _FUNCTIONS,
}


def traced(function: Callable[..., Any]) -> Any:
    """Copy a branchless function, and those that it calls, for traced numbers."""
    twins: dict[Any, Any] = {}

    def twin(original: Any) -> Any:
        """Copy a function whose global names lead to functions of traced numbers."""
        if original not in twins:
            names = dict(original.__globals__)
            copy = FunctionType(original.__code__, names, original.__name__, original.__defaults__)
            twins[original] = copy
            for name in original.__code__.co_names:
                callee = names.get(name)
                if name in PLAIN:
                    names[name] = PLAIN[name]
                elif isinstance(callee, FunctionType) and callee.__module__.startswith(LIBRARY):
                    names[name] = twin(callee)
        return twins[original]

    return twin(function)
