"""Sensor errors sample by sample, for numba; import it inside functions only."""

from __future__ import annotations

from typing import NamedTuple

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import WRONG_SIZE
from icreckon.estimator.tracing.jit_kernel import entry


def gauss_markov_of(noise: Floats, decay: float, drive: float) -> None:
    """Turn white noise (n, 3) of unit variance into Gauss-Markov processes, in place.

    Args:
        noise: overwritten.
        decay: factor on a value after one step [-].
        drive: standard deviation of the noise added in one step [-].

    Raises:
        ValueError: the array has the wrong size.
    """
    if noise.shape[1] != 3:
        raise ValueError(WRONG_SIZE)
    for k in range(1, len(noise)):
        for axis in range(3):
            noise[k, axis] = decay * noise[k - 1, axis] + drive * noise[k, axis]


class TriadErrors(NamedTuple):
    """Errors of the three axes of an inertial sensor.

    Attributes:
        triad: (3, 3) matrix of scale and alignment.
        start: (3,) bias at turn-on [unit].
        white: standard deviation of a sample's white noise [unit].
        walk: standard deviation of the bias walk per sample [unit].
        largest: range of the sensor [unit].
    """

    triad: Floats
    start: Floats
    white: float
    walk: float
    largest: float


def add_inertial_errors(
    true: Floats, draws: Floats, errors: TriadErrors, reading: Floats, bias: Floats
) -> None:
    """Compute the readings of an inertial sensor, and its bias, from the true values.

    `icreckon.simulation.sensors.imu` describes the error model.

    Args:
        true: (n, 3) true values in the sensor's axes [unit].
        draws: (n, 2, 3) unit normal, for the white noise and for the random walk of the bias.
        errors: errors of the sensor.
        reading: (n, 3) overwritten with the readings [unit].
        bias: (n, 3) other parts of the bias; turn-on bias and walk are added in place [unit].

    Raises:
        ValueError: an array has the wrong size.
    """
    n, (triad, start, white, walk, largest) = len(true), errors
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
