"""Constants of a step that depend on its length, see `layout.STEP_CONSTANTS`.

Written for plain Python and for numba (`estimator.tracing.jit_kernel`).
"""

from __future__ import annotations

from typing import Any

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.layout import STEP_CONSTANTS
from icreckon.estimator.filter.ekf import REGRESSOR_SMOOTHING
from icreckon.estimator.motion.propagation import fading, gauss_markov_noise
from icreckon.estimator.sensors.held_tracks import smoothing_share
from icreckon.estimator.tracing.jit_kernel import entry

PER_STEP, SMOOTHING = len(STEP_CONSTANTS), STEP_CONSTANTS.index("smoothing")
# Columns of a table of constants, with the interval of the IMU last.
STEP_COLUMNS = PER_STEP + 1


def step_constants(dt: float, time_constant: float) -> Any:
    """Compute the values of `STEP_CONSTANTS`.

    Args:
        dt: length of the step [s].
        time_constant: time constant of the slip [s].
    """
    decay, mean = fading(dt, time_constant)
    integral, cross, final = gauss_markov_noise(dt, time_constant)
    return dt, smoothing_share(dt, REGRESSOR_SMOOTHING), decay, mean, integral, cross, final


def fill_table(
    table: Floats, starts: Stamps, ends: Stamps, intervals: Floats, time_constant: float
) -> None:
    """Fill the constants of each step, the interval of the IMU last.

    Args:
        table: (n, k) written to.
        starts: stamps of the starts of the steps [ns].
        ends: stamps of their ends [ns].
        intervals: time between IMU samples [s].
        time_constant: time constant of the slip [s].

    Raises:
        ValueError: an array has the wrong size.
    """
    count = min(len(ends), len(intervals), len(table))
    if count < len(starts) or table.shape[1] != STEP_COLUMNS:
        raise ValueError(WRONG_SIZE)
    for k in range(len(starts)):
        elapsed = ends[k] - starts[k]
        if k == 0 or elapsed != ends[k - 1] - starts[k - 1]:
            constants = step_constants(elapsed * NANOSECOND, time_constant)
            for c in range(PER_STEP):
                table[k, c] = constants[c]
        else:
            for c in range(PER_STEP):
                table[k, c] = table[k - 1, c]
        table[k, PER_STEP] = intervals[k]


fill_step_constants = entry(fill_table)
