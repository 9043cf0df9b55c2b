"""Array types, and the unit of stamps."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
# Times in int64 nanoseconds.
Stamps = NDArray[np.int64]
NANOSECOND = 1e-9
