"""The demo's scenario over many seeds: drift of each variant, and paired ratios, with intervals.

    python benchmarks/demo_runs.py [--runs 20]

Intervals are 95 % percentile bootstrap intervals over runs; a ratio is that of the means over the same
runs.
"""

from __future__ import annotations

import numpy as np
from _study import bootstrap, drift_and_nees, ratio_of_sums, spread, study_parser, table

from icreckon.cli.demo import DURATION, demo_scenario
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.streaming.run import run
from icreckon.simulation.simulate import simulate

SCORING_SEED = 1
BASELINE = "constant-online"
VARIANTS = ("gyro", BASELINE, "inertia-online")


def score(job: tuple[str, int]) -> tuple[float, float]:
    """Drift after 30 s without fixes [%], and mean pose NEES, of one run."""
    variant, index = job
    robot = load_robot("auriga-alpha")
    log = simulate(demo_scenario(SCORING_SEED, DURATION, "random"), robot, run_index=index)
    return drift_and_nees(run(log, robot, variant).trajectory, log)


def cells(value: float, low: float, high: float) -> list[str]:
    """A figure, and its interval."""
    return [f"{value:.2f}", f"{low:.2f} to {high:.2f}"]


def main() -> None:
    """Print the table."""
    arguments = study_parser(__doc__, 20, VARIANTS).parse_args()
    variants = arguments.variants
    jobs = [(variant, index) for variant in variants for index in range(arguments.runs)]
    scores = np.array(spread(score, jobs, arguments.workers))
    drifts, nees = scores.reshape(len(variants), arguments.runs, 2).transpose(2, 0, 1)
    baseline = drifts[variants.index(BASELINE)]
    table(
        ["variant", "drift 30 s, %", "95 %", f"ratio to {BASELINE}", "95 %", "pose NEES (3)"],
        [
            [
                f"`{variant}`",
                *cells(*bootstrap(lambda x: x[..., 0].mean(axis=-1), drifted[:, None])),
                *cells(*bootstrap(ratio_of_sums, np.stack([drifted, baseline], axis=-1))),
                f"{of_run.mean():.1f}",
            ]
            for variant, drifted, of_run in zip(variants, drifts, nees, strict=True)
        ],
    )


if __name__ == "__main__":
    main()
