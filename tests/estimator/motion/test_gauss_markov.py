"""Transition and noise of a Gauss-Markov process over a step."""

import math

import pytest
from scipy.integrate import quad

from icreckon.estimator.motion.propagation import SHORT, gauss_markov


@pytest.mark.parametrize("ratio", [0.3 * SHORT, 0.999 * SHORT, SHORT, 1.001 * SHORT, 1.0, 7.0])
def test_it_is_what_the_integrals_of_the_process_are(ratio: float) -> None:
    tau = 0.7
    dt = ratio * tau
    found = gauss_markov(dt, tau)

    def left(age: float) -> float:
        """Share of a disturbance that is in the integral after its age [s]."""
        return tau * (1.0 - math.exp(-age / tau))

    def of(share: object) -> float:
        return 2.0 / tau * quad(share, 0.0, dt, epsabs=0.0, epsrel=1e-12)[0]

    assert found.decay == pytest.approx(math.exp(-ratio), rel=1e-14)
    assert found.mean == pytest.approx(left(dt) / dt, rel=1e-11)
    assert found.integral == pytest.approx(of(lambda age: left(age) ** 2), rel=1e-10)
    assert found.cross == pytest.approx(of(lambda age: left(age) * math.exp(-age / tau)), rel=1e-10)
    assert found.final == pytest.approx(of(lambda age: math.exp(-2.0 * age / tau)), rel=1e-10)


def test_no_time_changes_nothing() -> None:
    assert gauss_markov(0.0, 0.5) == (1.0, 1.0, 0.0, 0.0, 0.0)
