"""When sensors sample: times in seconds since the start of a run, and stamps."""

from __future__ import annotations

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps

EPOCH = 1_700_000_000_000_000_000


def sample_times(duration: float, rate: float) -> Floats:
    """Times (n,) [s] from zero to duration, both included where the rate allows."""
    return np.asarray(np.arange(int(np.floor(duration * rate + 1e-6)) + 1) / rate)


def to_stamps(times: Floats) -> Stamps:
    """Stamps (n,) [ns] of times (n,) [s] since the start of the run, which is at `EPOCH`."""
    return EPOCH + np.rint(times * 1e9).astype(np.int64)
