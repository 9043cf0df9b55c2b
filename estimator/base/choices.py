"""Choosing between numbers without a branch, so that the same lines serve one filter and many lanes."""

from __future__ import annotations

from typing import Any

import numpy as np


def select(condition: Any, yes: Any, no: Any) -> Any:
    """One number or the other; both are worked out. For plain Python and for numba."""
    return yes if condition else no


def every(condition: Any) -> bool:
    """Whether it holds, everywhere if it is an array."""
    return condition is True or (condition is not False and bool(np.all(condition)))


def some(condition: Any) -> bool:
    """Whether it holds, anywhere if it is an array."""
    return condition is True or (condition is not False and bool(np.any(condition)))
