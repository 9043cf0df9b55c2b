"""Sample times of sensors in seconds since the start of a run, and their stamps."""

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps

# Stamp of the start of every run [ns]: a date as in real logs, since zero often means "no stamp".
EPOCH = 1_700_000_000_000_000_000


def sample_times(duration: float, rate: float) -> Floats:
    """Sample times (n,) [s] from zero to duration, both included if the rate allows."""
    # The margin keeps the last sample where duration * rate is rounded to just below its index.
    return np.asarray(np.arange(int(np.floor(duration * rate + 1e-6)) + 1) / rate)


def to_stamps(times: Floats) -> Stamps:
    """Convert times (n,) [s] since the start of the run, `EPOCH`, to stamps (n,) [ns]."""
    return EPOCH + np.rint(times * 1e9).astype(np.int64)
