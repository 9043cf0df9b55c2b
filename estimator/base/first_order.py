"""First-order filter of a series at an even step."""

import numpy as np

from icreckon.estimator.base.array_types import Floats


def first_order(inputs: Floats, keep: float) -> Floats:
    """First-order recursive filter, y_k = keep y_(k-1) + x_k, of inputs x (n, m), from y_0 = x_0.

    By doubling: each round adds the sums of as many samples before as are in a sum.
    """
    sums, reach = np.array(inputs, dtype=float), 1
    while reach < len(sums):
        sums[reach:] += keep**reach * sums[:-reach]
        reach *= 2
    return sums
