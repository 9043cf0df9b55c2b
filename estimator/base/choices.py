"""Branch-free selection, so that the same code serves one filter and many lanes."""

from typing import Any

import numpy as np


def select(condition: Any, yes: Any, no: Any) -> Any:
    """Select one of two numbers, both computed; for plain Python and for numba."""
    return yes if condition else no


def every(condition: Any) -> bool:
    """Return True if a condition holds, in every element of an array."""
    return condition is True or (condition is not False and bool(np.all(condition)))


def some(condition: Any) -> bool:
    """Return True if a condition holds, in any element of an array."""
    return condition is True or (condition is not False and bool(np.any(condition)))
