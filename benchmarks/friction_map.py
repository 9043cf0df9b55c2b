"""The friction index model's table against the solver: errors, time to make it, time to read it.

Errors are those of the twist at random track speeds up to the robot's fastest: RMS as a share of the
twist's own RMS, and the largest, with where it is. Beside it, eta (effective over geometric track) by
friction and in the robot file.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from estimator.friction_map import FrictionMap
from estimator.robot import load_robot, robot_names
from estimator.steady import solve_steady

SLIGHT = 1e-6
UNITS = (("v_x", "mm/s"), ("v_y", "mm/s"), ("w", "mrad/s"))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--robots", nargs="+", default=robot_names())
    parser.add_argument("--pairs", type=int, default=20_000)
    arguments = parser.parse_args()
    rng = np.random.default_rng(1)
    for name in arguments.robots:
        robot = load_robot(name)
        top, gauge = robot.vehicle.max_track_speed, robot.vehicle.track_gauge
        solve_steady(0.1, 0.2, robot.contact)  # compiles where nothing is cached yet
        begin = time.perf_counter()
        table = FrictionMap(robot.contact, top)
        made = time.perf_counter() - begin
        V = rng.uniform(-top, top, (2, arguments.pairs))
        expected = np.array(solve_steady(*V, robot.contact).twist)
        zeta, epsilon, eta = table.at(*V).indices
        w = (V[1] - V[0]) / (gauge * eta)
        error = np.abs(np.array([w * zeta, V.mean(axis=0) - w * epsilon, w]) - expected)
        pairs = V[:, :2000].T.tolist()
        begin = time.perf_counter()
        for left, right in pairs:
            table.at(left, right)
        read = (time.perf_counter() - begin) / len(pairs)
        print(
            f"{name}: made in {made:.2f} s, read in {1e6 * read:.1f} µs; eta at a crawl "
            f"{table.reference.eta:.3f}, in the robot file {robot.constant_indices.eta0:.3f}"
        )
        left, right = (
            table.at(top / 2.0 - turn, top / 2.0 + turn).indices.epsilon
            for turn in (SLIGHT, -SLIGHT)
        )
        print(f"  epsilon straight ahead: {left:.3f} m turning left, {right:.3f} m turning right")
        for row, (part, unit) in enumerate(UNITS):
            share = np.sqrt(np.mean(error[row] ** 2) / np.mean(expected[row] ** 2))
            worst = int(error[row].argmax())
            print(
                f"  {part}: RMS error {share:.1e}, at most {1e3 * error[row, worst]:.2f} {unit} at "
                f"V_l {V[0, worst]:.2f}, V_r {V[1, worst]:.2f} m/s"
            )


if __name__ == "__main__":
    main()
