"""First-order filter of a series at an even step."""

import numpy as np

from icreckon.estimator.base.array_types import Floats


def first_order(inputs: Floats, keep: float) -> Floats:
    """First-order recursive filter: y_k = keep y_(k-1) + x_k, y_0 = x_0.

    Inputs x are (n, m), as are the outputs. By doubling: each round adds to each sum that of as many
    samples before it.
    """
    sums, reach = np.array(inputs, dtype=float), 1
    while reach < len(sums):
        sums[reach:] += keep**reach * sums[:-reach]
        reach *= 2
    return sums
