"""Transient dynamics: how exact they are, and how much faster than real time.

Each trajectory of 300 s is integrated at 100 Hz output at several tolerances; errors are those of the
twist against a reference whose tolerance is 100 times tighter than the default. With --plot they are
drawn.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from icreckon.estimator.robot.robot_file import load_robot
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.drives.trajectories import make_trajectory
from icreckon.simulation.truth.friction import TOLERANCE, TRACK_LAG, drive, follow

SECONDS, RATE = 300.0, 100.0
TRAJECTORIES = ("random", "aggressive", "slalom", "figure-eight", "spin")
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


def main() -> None:
    """Print the table, draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--robot", default="auriga-alpha")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeat", type=int, default=3, help="best time of so many runs")
    parser.add_argument("--plot", type=Path, help="PNG to write")
    arguments = parser.parse_args()
    robot = load_robot(arguments.robot)
    times = np.arange(int(SECONDS * RATE) + 1) / RATE
    row = "{:>13s} {:>10s} {:>8s} {:>14s} {:>12s} {:>12s} {:>12s}"
    head = ("trajectory", "tolerance", "steps", "x real time", "v_x m/s", "v_y m/s", "w rad/s")
    print(row.format(*head))
    errors: dict[str, list[float]] = {}
    for name in TRAJECTORIES:
        command = make_trajectory(name, SECONDS, robot, np.random.default_rng(arguments.seed))
        speeds, rates = follow(command(times), 1.0 / RATE, TRACK_LAG)

        def run(tolerance: float, speeds: np.ndarray = speeds, rates: np.ndarray = rates):
            return drive(
                contact_of(robot), robot.yaw_inertia, speeds, rates, 1.0 / RATE, tolerance=tolerance
            )

        reference = run(0.01 * TOLERANCE).twists
        errors[name] = []
        for tolerance in TOLERANCES:
            seconds = []
            for _ in range(arguments.repeat):
                start = time.perf_counter()
                found = run(tolerance)
                seconds.append(time.perf_counter() - start)
            worst = np.abs(found.twists - reference).max(axis=0)
            errors[name].append(float(worst.max()))
            cells = (
                name,
                f"{tolerance:.0e}",
                str(found.steps),
                f"{SECONDS / min(seconds):.0f}",
                *(f"{part:.1e}" for part in worst),
            )
            print(row.format(*cells), flush=True)
    if arguments.plot:
        draw(errors, arguments.plot)


def draw(errors: dict[str, list[float]], path: Path) -> None:
    """Largest error of the twist over the tolerance."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 5.0), layout="constrained")
    for (name, values), marker in zip(errors.items(), "osd^v", strict=False):
        axes.loglog(TOLERANCES, values, marker=marker, label=name)
    axes.axvline(TOLERANCE, color="0.5", linestyle=":", zorder=0)
    axes.annotate(
        "default",
        (TOLERANCE, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(4, -12),
        textcoords="offset points",
        color="0.4",
    )
    axes.set_xlabel("tolerance of a step, relative [-]")
    axes.set_ylabel("largest error in 300 s [m/s, rad/s]")
    axes.set_title(
        f"Transient dynamics against a reference of tolerance {0.01 * TOLERANCE:.0e}\n"
        "(100 times tighter than the default), output at 100 Hz",
        fontsize=11,
    )
    axes.grid(visible=True, which="major", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
