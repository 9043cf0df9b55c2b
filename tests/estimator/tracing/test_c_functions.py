"""Plain Python functions as C: what has no form is an error."""

import math
from typing import Any

import pytest

from icreckon.estimator.tracing.c_functions import Functions


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
