"""Numbers of kernels in C; the kernels are compared in tests/estimator/embedded."""

import numpy as np
import pytest

from icreckon.estimator.tracing.c_kernel import literal


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.5, "0.5"),
        (1e300, "1e+300"),
        (np.inf, "INFINITY"),
        (-np.inf, "-INFINITY"),
        (np.nan, "NAN"),
    ],
)
def test_numbers_in_c(value: float, text: str) -> None:
    assert literal(value, 64) == text
    assert literal(0.5, 32) == "0.5f"
