"""Plain Python functions as C: the same results, and a clear error for what has no form."""

import ctypes
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_filters import compiled
from icreckon.estimator.embedded.c_filter import SOURCE
from icreckon.estimator.tracing.c_functions import Functions
from icreckon.estimator.tracing.c_types import Type

HEAD = """#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
typedef double real;
"""
FIVE = Type("array", "real", shape=(5,))


def powers(x: float, y: float) -> float:
    return x**2 + y**0.5 - 2.0 * (x - y) / (1.0 + abs(x))


def chained(x: float, y: float) -> bool:
    return 0.0 < x <= y < 3.0 or x == y


def summed(values: Any) -> float:
    total, count = 0.0, 0
    for value in values:
        if 0.0 <= value <= 100.0:
            total += value
            count += 1
    return total / max(1, count)


def reversed_weights(values: Any) -> float:
    total = 0.0
    for k in range(len(values) - 1, 0, -1):
        total = 0.5 * total + values[k]
    while total > 4.0:
        total -= 1.5
    return total


def turned(x: float, y: float) -> float:
    z = complex(x, y) * complex(math.cos(0.3), math.sin(0.3)) - 0.5
    w = z * z.conjugate() + 1j * x
    return w.real + 2.0 * w.imag


def counted(x: float, n: int) -> int:
    sign = 1 if x >= 0.0 else -1
    return sign * min(n, 7) + int(x) + abs(n - 3)


def defaulted(x: float, step: float = 0.25) -> float:
    found = np.zeros(3)
    found[1] = x
    found[:] = found[1] + step
    return found[0] + found[2]


NUMBERS = [(0.5, 2.0), (2.0, 2.0), (-1.5, 0.25), (2.5, 2.75), (4.0, 9.0), (0.0, 0.0)]
ARRAYS = [[1.0, 2.0, 3.0, 4.0, 5.0], [-1.0, 7.0, 200.0, 3.0, 9.0], [0.0] * 5, [9.0] * 5]


def in_c(function: Any, folder: Path, **types: Type) -> Any:
    functions = Functions(64, {}, {}, {})
    functions.translate(function, **types)
    source = SOURCE.read_text(encoding="utf-8")
    arithmetic = source[source.index("typedef struct {\n    real re") : source.index("@TUPLES@")]
    parts = [HEAD, arithmetic, *functions.tuples.values(), *functions.text]
    text = "\n".join(parts).replace(
        f"static {_kind(function)} {function.__name__}(", _open(function)
    )
    return getattr(compiled(text, folder), function.__name__)


def _kind(function: Any) -> str:
    return {float: "real", bool: "bool", int: "int64_t"}[function.__annotations__["return"]]


def _open(function: Any) -> str:
    return f"{_kind(function)} {function.__name__}("


@pytest.mark.parametrize("function", [powers, chained, turned])
def test_functions_of_numbers(function: Any, tmp_path: Path) -> None:
    of_c = in_c(function, tmp_path)
    of_c.argtypes = [ctypes.c_double] * 2
    of_c.restype = ctypes.c_bool if function is chained else ctypes.c_double
    for pair in NUMBERS:
        assert of_c(*pair) == pytest.approx(function(*pair), rel=1e-14), pair


@pytest.mark.parametrize("function", [summed, reversed_weights])
def test_loops_over_arrays(function: Any, tmp_path: Path) -> None:
    of_c = in_c(function, tmp_path, values=FIVE)
    of_c.restype = ctypes.c_double
    for values in ARRAYS:
        assert of_c((ctypes.c_double * 5)(*values)) == pytest.approx(function(values)), values


def test_whole_numbers_and_defaults(tmp_path: Path) -> None:
    of_c = in_c(counted, tmp_path)
    of_c.argtypes, of_c.restype = [ctypes.c_double, ctypes.c_int64], ctypes.c_int64
    for x, n in ((2.7, 3), (-2.7, 9), (0.0, -4)):
        assert of_c(x, n) == counted(x, n)
    halves = in_c(defaulted, tmp_path)
    halves.argtypes, halves.restype = [ctypes.c_double] * 2, ctypes.c_double
    assert halves(1.5, 0.5) == defaulted(1.5, 0.5)


def listed(x: float) -> float:
    return [x, x][0]


def lettered(x: float) -> float:
    return float(f"{x}")


def first_whole(x: float) -> float:
    found = 1
    for _ in range(2):
        found = x
    return found


def called_from_outside(x: float) -> float:
    return math.fsum([x])


def with_a_context(x: float) -> float:
    with np.errstate(all="ignore"):
        return x


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


def of_a_builtin(x: float) -> float:
    return x if max is sum else -x


@pytest.mark.parametrize(
    "function",
    [
        in_strides,
        with_an_else,
        of_a_builtin,
        listed,
        lettered,
        first_whole,
        called_from_outside,
        with_a_context,
    ],
)
def test_what_has_no_form_is_named(function: Any) -> None:
    with pytest.raises(NotImplementedError, match=rf"{function.__name__}: .*has no form in C"):
        Functions(64, {}, {}, {}).translate(function)
