"""Errors of sensors sample by sample, for numba; import it inside functions only."""

from __future__ import annotations

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.tracing.jit_kernel import entry


def gauss_markov_of(noise: Floats, decay: float, drive: float) -> None:
    """Turn white noise (n, 3) of unit variance into Gauss-Markov processes, in place.

    Args:
        noise: overwritten.
        decay: what is left of a value after a step [-].
        drive: standard deviation of what a step adds [-].

    Raises:
        ValueError: the array has the wrong size.
    """
    if noise.shape[1] != 3:
        raise ValueError(WRONG_SIZE)
    for k in range(1, len(noise)):
        for axis in range(3):
            noise[k, axis] = decay * noise[k - 1, axis] + drive * noise[k, axis]


def add_inertial_errors(
    true: Floats,
    draws: Floats,
    triad: Floats,
    start: Floats,
    white: float,
    walk: float,
    reading: Floats,
    bias: Floats,
    largest: float,
) -> None:
    """What a sensor reads, and its bias; see `simulation.sensors.imu`.

    Args:
        true: (n, 3) in its axes [unit].
        draws: (n, 2, 3) unit normal: of the white noise, and of the walk of the bias.
        triad: (3, 3) of scale and alignment.
        start: (3,) the bias at turn-on [unit].
        white: noise of a sample [unit].
        walk: of the bias from sample to sample [unit].
        reading: (n, 3) written to [unit].
        bias: (n, 3) holds what else is bias, and is added to [unit].
        largest: that it can read [unit].

    Raises:
        ValueError: an array has the wrong size.
    """
    n = len(true)
    sizes_fit = true.shape == reading.shape == bias.shape == (n, 3) and draws.shape == (n, 2, 3)
    if not sizes_fit or triad.shape != (3, 3) or start.shape != (3,):
        raise ValueError(WRONG_SIZE)
    now = start.copy()
    for k in range(len(true)):
        for axis in range(3):
            if k > 0:
                now[axis] += walk * draws[k, 1, axis]
            bias[k, axis] += now[axis]
            value = white * draws[k, 0, axis] + bias[k, axis]
            for other in range(3):
                value += triad[axis, other] * true[k, other]
            reading[k, axis] = min(max(value, -largest), largest)


gauss_markov_entry = entry(gauss_markov_of)
add_inertial_errors_entry = entry(add_inertial_errors)
