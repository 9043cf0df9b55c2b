"""Tune the slip and the walk of each filter variant on its own, each to its own best.

Runs every variant over simulated runs with friction as truth (two trajectories, seeds kept for tuning:
the demo's and the scoring seeds are others) for a grid of settings, and prints the drift after 30 s
without fixes, as mean % of distance, with the pose NEES (3 is ideal). The defaults in
`estimator/robot/variants.py` are the best rows of this table, or the next best where NEES says that the
best is overconfident.

    python benchmarks/tune_variants.py [--runs 4]
"""

from __future__ import annotations

import argparse
import itertools
import os
from concurrent.futures import ProcessPoolExecutor

import msgspec
import numpy as np

from icreckon.estimator.log.scores import drift, pose_nees, without_fixes
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import DEFAULT_ADAPTATION, DEFAULT_SLIP, VARIANTS
from icreckon.estimator.streaming.run import run
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

TUNING_SEED = 100_000
TRAJECTORIES = ("random", "aggressive")
TIME_CONSTANTS = (0.2, 0.5, 1.0)
SIZES = (0.5, 1.0, 2.0)
WALKS = (0.02, 0.1)

Job = tuple[str, float, float, float, str, int]


def score(job: Job) -> tuple[float, float]:
    """Drift [%] and mean pose NEES of one run."""
    name, time_constant, size, walk, trajectory, index = job
    robot = load_robot("auriga-alpha")
    scenario = Scenario(
        trajectory=trajectory, duration=200.0, seed=TUNING_SEED, outages=((80.0, 200.0),)
    )
    log = simulate(scenario, robot, run_index=index)
    model = VARIANTS[name].model
    default = DEFAULT_SLIP[model]
    shares = {
        field: size * getattr(default, field)
        for field in default.__struct_fields__
        if field.startswith(("turning", "driving"))
    }
    settings = Settings(
        slip=msgspec.structs.replace(default, time_constant=time_constant, **shares),
        adaptation=msgspec.structs.replace(DEFAULT_ADAPTATION[model], walk=walk),
    )
    result = run(log, robot, name, settings=settings)
    assert log.truth is not None  # noqa: S101 - the scenario includes it
    assert log.fixes is not None  # noqa: S101
    free = without_fixes(log.fixes.stamps, log.start, log.end, 10.0)
    drifted = drift(result.trajectory.pose_series, log.truth.poses, 30.0, within=free)
    return drifted.percent_mean, float(np.mean(pose_nees(result.trajectory, log.truth.poses)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=4, help="runs for each trajectory")
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS))
    arguments = parser.parse_args()
    cells = [
        (name, time_constant, size, walk)
        for name in arguments.variants
        for time_constant, size, walk in itertools.product(TIME_CONSTANTS, SIZES, WALKS)
        if VARIANTS[name].online or walk == WALKS[0]
    ]
    jobs = [
        (*cell, trajectory, index)
        for cell in cells
        for trajectory in TRAJECTORIES
        for index in range(arguments.runs)
    ]
    per_cell = len(TRAJECTORIES) * arguments.runs
    print(f"{'variant':16s} {'tau':>5s} {'size':>5s} {'walk':>5s}", end="")
    print("".join(f"  {name + ' %':>12s} {'NEES':>5s}" for name in TRAJECTORIES))
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        scores = pool.map(score, jobs, chunksize=per_cell)
        for name, time_constant, size, walk in cells:
            rows = np.array([next(scores) for _ in range(per_cell)]).reshape(-1, arguments.runs, 2)
            means = "".join(f"  {d:12.2f} {nees:5.1f}" for d, nees in rows.mean(axis=1))
            print(f"{name:16s} {time_constant:5.1f} {size:5.1f} {walk:5.2f}{means}", flush=True)


if __name__ == "__main__":
    main()
