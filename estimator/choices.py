"""Choosing between numbers without a branch, so that the same lines serve one filter and many lanes."""

from __future__ import annotations

from typing import Any


def select(condition: Any, yes: Any, no: Any) -> Any:
    """One number or the other; both are worked out. For plain Python and for numba."""
    return yes if condition else no
