"""First-order filter: the same as the recursion that defines it."""

import numpy as np
import pytest

from icreckon.estimator.base.first_order import first_order


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.999, 1.0])
@pytest.mark.parametrize("count", [0, 1, 2, 1000])
def test_it_is_the_recursion(keep: float, count: int) -> None:
    inputs = np.random.default_rng(3).standard_normal((count, 2))
    expected, before = np.zeros((count, 2)), np.zeros(2)
    for k, one in enumerate(inputs):
        expected[k] = before = keep * before + one
    found = first_order(inputs, keep)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert not np.shares_memory(found, inputs)
