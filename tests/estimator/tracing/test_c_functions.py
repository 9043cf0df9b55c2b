"""Plain Python functions as C: numbers, and what has no form; tests/estimator/embedded has the rest."""

import math
from typing import Any

import pytest

from icreckon.estimator.tracing.c_functions import Functions
from icreckon.estimator.tracing.c_kernel import literal


def listed(x: float) -> float:
    return [x, x][0]


def called_from_outside(x: float) -> float:
    return math.fsum([x])


def in_strides(x: float) -> float:
    for _ in range(0, 6, 2):
        x += 1.0
    return x


def with_an_else(x: float) -> float:
    while x < 0.0:
        x += 1.0
        if x > -0.5:
            break
    else:
        x = -x
    return 2.0 * x


@pytest.mark.parametrize("function", [listed, called_from_outside, in_strides, with_an_else])
def test_what_has_no_form_is_named(function: Any) -> None:
    with pytest.raises(NotImplementedError, match=rf"{function.__name__}: .*has no form in C"):
        Functions(64, {}, {}, {}).translate(function)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.5, "0.5"),
        (1e300, "1e+300"),
        (math.inf, "INFINITY"),
        (-math.inf, "-INFINITY"),
        (math.nan, "NAN"),
    ],
)
def test_numbers_in_c(value: float, text: str) -> None:
    assert literal(value, 64) == text
    assert literal(0.5, 32) == "0.5f"
