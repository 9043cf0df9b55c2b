"""Array types, the unit of stamps, and runs of a mask."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indexes = NDArray[np.int64]  # of rows of other arrays
Stamps = NDArray[np.int64]  # times in int64 nanoseconds
NANOSECOND = 1e-9


def true_runs(mask: Flags) -> Indexes:
    """First and last rows (k, 2) of the runs of a mask (n,) in which it is set."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))).reshape(-1, 2)
    return ends - (0, 1)
