"""Time of the stationary solver for the paper's 441 pairs and a 201 x 201 map, beside scipy's root.

Both solve the same function (`simulation.contact.contact.steady_balance`) from the same kinematic guess.
scipy goes pair by pair: for the 441 all of them, for the large map an even sample, whose time is scaled
up (`--all` solves every pair; it takes minutes). It is given the analytic Jacobian, and its failures are
counted, not mended.

    python benchmarks/steady_map.py [--sample 1000] [--all] [--repeat 5]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from icreckon.estimator.motion.icr import PaperTwist
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.simulation.contact.contact import steady_balance
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.contact.steady_state import (
    CONVERGED,
    TYPICAL_ETA,
    solve_steady,
    track_speed_grid,
)

AURIGA = contact_of(load_robot("auriga-alpha"))
GAUGE = AURIGA.geometry.gauge
METHODS = ("hybr", "lm")


def solve_one(V_l: float, V_r: float, method: str) -> tuple[NDArray[np.float64], float]:
    """The twist (3,) that scipy finds for one pair, and the largest part of the balance left."""
    left, right = np.array([V_l]), np.array([V_r])
    scale = np.array([1.0, 1.0, 2.0 / GAUGE]) / AURIGA.body.weight

    def balance(twist: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        wrench = steady_balance(PaperTwist(*twist[:, None]), left, right, AURIGA)
        return scale * wrench.values[:, 0], scale[:, None] * wrench.jacobian[:, :, 0]

    w = (V_r - V_l) / (TYPICAL_ETA * GAUGE)
    start = np.array([AURIGA.body.y_CM * w, 0.5 * (V_l + V_r), w])
    found = root(balance, start, jac=True, method=method, tol=1e-12)
    return found.x, float(np.abs(balance(found.x)[0]).max())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sample", type=int, default=1000, help="pairs of the large map for scipy")
    parser.add_argument(
        "--all", action="store_true", help="scipy solves all pairs of the large map"
    )
    parser.add_argument("--repeat", type=int, default=5, help="best of so many runs of ours")
    arguments = parser.parse_args()
    row = "{:>9s} {:>7s} {:>10s} {:>9s} {:>11s} {:>8s} {:>9s} {:>7s}"
    head = ("map", "method", "scipy s", "solved", "failed", "ours s", "failed", "ratio")
    print(row.format(*head))
    for count in (21, 201):
        V_l, V_r = track_speed_grid(1.0, count)
        seconds = []
        for _ in range(arguments.repeat):
            start = time.perf_counter()
            ours = solve_steady(V_l, V_r, AURIGA, strict=False)
            seconds.append(time.perf_counter() - start)
        pairs = np.column_stack([V_l.ravel(), V_r.ravel()])
        if len(pairs) > arguments.sample and not arguments.all:
            pairs = pairs[np.linspace(0, len(pairs) - 1, arguments.sample).astype(int)]
        for method in METHODS:
            start = time.perf_counter()
            left = [solve_one(*pair, method)[1] for pair in pairs]
            scipy_seconds = (time.perf_counter() - start) * V_l.size / len(pairs)
            cells = (
                f"{count} x {count}",
                method,
                f"{scipy_seconds:.2f}",
                str(len(pairs)),
                str(sum(rest > CONVERGED for rest in left)),
                f"{min(seconds):.4f}",
                str(int(np.sum(~ours.converged))),
                f"{scipy_seconds / min(seconds):.0f}",
            )
            print(row.format(*cells), flush=True)


if __name__ == "__main__":
    main()
