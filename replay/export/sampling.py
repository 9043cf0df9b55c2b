"""Samples at a lower rate, for messages and maps."""

from __future__ import annotations

from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Stamps


def thinned(stamps: Stamps, rate: float) -> Any:
    """Select rows (m,) of stamps [ns], at most `rate` a second; even stamps stay even."""
    if not len(stamps):
        return np.zeros(0, int)
    slot = np.floor((stamps - stamps[0]) * NANOSECOND * rate + 1e-6).astype(np.int64)
    return np.flatnonzero(np.diff(slot, prepend=-1))
