"""Newton's iteration for stationary motions, one after the other, compiled."""

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import WRONG_SIZE
from icreckon.estimator.tracing.jit_kernel import compiled
from icreckon.simulation.contact.contact_forces import (
    COLUMNS,
    Ground,
    PointLoads,
    add_steady_balance,
    solve_3,
)

SUFFICIENT_DECREASE = 1e-4
SMALLEST_STEP = 1e-6


@compiled
def newton_of_many(
    ground: Ground, V: Floats, steps: int, tolerance: float, twist: Floats, residual: Floats
) -> None:
    """Newton's iteration with step halving, until solved, stuck, or out of steps.

    Args:
        ground: the contact.
        V: (n, 2) track speeds [m/s].
        steps: evaluations of the balance after the first.
        tolerance: largest component of the residual of a solved pair, as a share of the weight
            (moments: of the weight times half the gauge).
        twist: (n, 3) guesses; overwritten with the best twist found [m/s, m/s, rad/s].
        residual: (n,) overwritten with the largest component of the residual, in these shares.

    Raises:
        ValueError: an array has the wrong size.
    """
    if V.shape != (len(V), 2) or twist.shape != (len(V), 3) or residual.shape != (len(V),):
        raise ValueError(WRONG_SIZE)
    unit = np.array([1.0, 1.0, 1.0 / ground.half_gauge]) / ground.weight
    count = len(ground.x)
    pressing = PointLoads(np.empty(count), np.empty(count), np.empty(count))
    values, jacobian = np.empty(3), np.empty((3, COLUMNS))
    step, trial = np.empty(3), np.empty(3)
    for k in range(len(V)):
        size, merit = 1.0, np.inf
        trial[:] = twist[k]
        step[:] = 0.0
        for _ in range(steps + 1):
            values[:] = 0.0
            jacobian[:] = 0.0
            at, speeds = (trial[0], trial[1], trial[2]), (V[k, 0], V[k, 1])
            add_steady_balance(ground, at, speeds, pressing, values, jacobian)
            values *= unit
            found = (values * values).sum()
            if found < (1.0 - SUFFICIENT_DECREASE * size) * merit:
                merit = found
                twist[k] = trial
                residual[k] = np.abs(values).max()
                if residual[k] <= tolerance:
                    break
                for row in range(3):
                    jacobian[row] *= unit[row]
                solve_3(jacobian, values, step)
                size = 1.0
            else:
                size *= 0.5
                if size <= SMALLEST_STEP:
                    break
            trial[:] = twist[k] - size * step
