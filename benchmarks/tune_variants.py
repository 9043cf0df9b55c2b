"""Tune the slip and the walk of each filter variant on its own, each to its own best.

Runs every variant over simulated runs with friction as truth (two trajectories, seeds kept for tuning:
the demo's and the scoring seeds are others) for a grid of settings, and prints the drift after 30 s
without fixes, as mean % of distance, with the pose NEES (3 is ideal). The defaults in
`estimator/robot/variants.py` are the best rows of this table, or the next best where NEES says that the
best is overconfident.

    python benchmarks/tune_variants.py [--runs 4]
"""

from __future__ import annotations

import itertools

import msgspec
import numpy as np
from _study import drift_and_nees, spread, study_parser, table

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
    return drift_and_nees(run(log, robot, name, settings=settings).trajectory, log)


def main() -> None:
    """Print the table."""
    arguments = study_parser(__doc__, 4, tuple(VARIANTS)).parse_args()
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
    scores = np.array(spread(score, jobs, arguments.workers))
    means = scores.reshape(len(cells), len(TRAJECTORIES), arguments.runs, 2).mean(axis=2)
    figures = [f"{trajectory}, {what}" for trajectory in TRAJECTORIES for what in ("%", "NEES")]
    table(
        ("variant", "time constant, s", "size", "walk", *figures),
        (
            [*map(str, cell), *(f"{one:.2f}" for one in found.ravel())]
            for cell, found in zip(cells, means, strict=True)
        ),
    )


if __name__ == "__main__":
    main()
