"""Array types, and the unit of stamps."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indexes = NDArray[np.int64]  # of rows of other arrays
Stamps = NDArray[np.int64]  # times in int64 nanoseconds
NANOSECOND = 1e-9
