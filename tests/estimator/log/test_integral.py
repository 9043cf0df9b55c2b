"""The running integral is scipy's, and exact where samples change steadily."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.integral import running_integral


@pytest.mark.parametrize("shape", [(), (2,)])
@pytest.mark.parametrize("kind", [float, complex])
def test_it_is_the_trapezoidal_rule_at_uneven_stamps(shape: tuple[int, ...], kind: type) -> None:
    rng = np.random.default_rng(1)
    stamps = 1_700_000_000 * 10**9 + np.cumsum(rng.integers(1, 10**8, 50))
    values = rng.normal(size=(50, *shape)).astype(kind)
    if kind is complex:
        values += 1j * rng.normal(size=values.shape)
    seconds = (stamps - stamps[0]) * NANOSECOND
    expected = cumulative_trapezoid(values, seconds, axis=0, initial=0.0)
    assert running_integral(stamps, values) == pytest.approx(expected, abs=1e-12)


def test_whole_numbers_have_fractions_and_no_sample_has_no_integral() -> None:
    found = running_integral(np.array([0, 500_000_000]), np.array([0, 1]))
    assert found.tolist() == [0.0, 0.25]
    assert running_integral(np.zeros(0, np.int64), np.zeros(0)).shape == (0,)
