"""Figures need matplotlib; results, tables and pages do without it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def unless_missing() -> Iterator[None]:
    """Run code that draws; warn in one line if matplotlib cannot be imported."""
    try:
        yield
    except ImportError as problem:
        if not (problem.name or "").startswith(("matplotlib", "kiwisolver", "contourpy", "PIL")):
            raise
        warnings.warn(
            f"no figures: matplotlib cannot be imported ({problem}); all else is written. "
            "`pip install matplotlib` brings them",
            stacklevel=1,
        )
