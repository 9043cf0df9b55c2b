"""The demo's scenario over many seeds: drift of each variant, and paired ratios, with intervals.

    python benchmarks/demo_runs.py [--runs 20] [--trajectory random] [--rolling-resistance 0]
    python benchmarks/demo_runs.py --conditions

Prints a table in Markdown, with `--conditions` that of ratios under other conditions. Intervals are 95 %
percentile bootstrap intervals over runs; a ratio is that of the means over the same runs.
"""

from __future__ import annotations

import argparse
import os

import msgspec
import numpy as np
from _study import bootstrap, ratio_of_sums, spread, table

from icreckon.cli.demo import DURATION, demo_scenario
from icreckon.estimator.log.scores import drift, pose_nees, without_fixes
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.run import run
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.simulate import simulate

SCORING_SEED = 1
BASELINE = "constant-online"
CONDITIONS = {
    "everyday driving, above": ("random", None),
    "everyday, without rolling resistance (`--rolling-resistance 0`)": ("random", 0.0),
    "full speed range (`--trajectory aggressive`)": ("aggressive", None),
}
COMPARED = ("gyro", BASELINE, "inertia-online")


def score(job: tuple[str, float | None, str, int]) -> tuple[float, float]:
    """Drift after 30 s without fixes [%], and mean pose NEES, of one run."""
    trajectory, rolling, variant, index = job
    robot = load_robot("auriga-alpha")
    if rolling is not None:
        soil = msgspec.structs.replace(contact_of(robot).soil, rolling_resistance=rolling)
        robot = msgspec.structs.replace(robot, soil=soil)
    log = simulate(demo_scenario(SCORING_SEED, DURATION, trajectory), robot, run_index=index)
    result = run(log, robot, variant)
    if log.truth is None or log.fixes is None:
        raise ValueError("the demo's scenario has truth and fixes")
    free = without_fixes(log.fixes.stamps, log.start, log.end, 10.0)
    drifted = drift(result.trajectory.pose_series, log.truth.poses, 30.0, within=free)
    return drifted.percent_mean, float(np.mean(pose_nees(result.trajectory, log.truth.poses)))


def cells(value: float, low: float, high: float) -> list[str]:
    """A figure, and its interval."""
    return [f"{value:.2f}", f"{low:.2f} to {high:.2f}"]


def conditions_row(name: str, runs: int) -> list[str]:
    """Ratios of drift under a condition; that of `gyro` without its interval."""
    jobs = [(*CONDITIONS[name], variant, index) for variant in COMPARED for index in range(runs)]
    scores = np.array(spread(score, jobs, os.cpu_count() or 1))
    gyro, baseline, *others = scores[:, 0].reshape(len(COMPARED), runs)
    ratios = [
        cells(*bootstrap(ratio_of_sums, np.stack([one, baseline], axis=-1)))
        for one in (gyro, *others)
    ]
    return [name, ratios[0][0], *ratios[1]]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--trajectory", default="random")
    parser.add_argument("--rolling-resistance", type=float, help="the robot file's where left out")
    parser.add_argument("--conditions", action="store_true", help="a row for each condition")
    arguments = parser.parse_args()
    if arguments.conditions:
        head = ("conditions", "`gyro`", "`inertia-online`", "95 %")
        table(head, (conditions_row(name, arguments.runs) for name in CONDITIONS))
        return
    jobs = [
        (arguments.trajectory, arguments.rolling_resistance, variant, index)
        for variant in VARIANTS
        for index in range(arguments.runs)
    ]
    scores = np.array(spread(score, jobs, os.cpu_count() or 1))
    drifts, nees = scores.reshape(len(VARIANTS), arguments.runs, 2).transpose(2, 0, 1)
    baseline = drifts[list(VARIANTS).index(BASELINE)]
    table(
        ["variant", "drift 30 s, %", "95 %", f"ratio to {BASELINE}", "95 %", "pose NEES (3)"],
        [
            [
                f"`{variant}`",
                *cells(*bootstrap(lambda x: x[..., 0].mean(axis=-1), drifted[:, None])),
                *cells(*bootstrap(ratio_of_sums, np.stack([drifted, baseline], axis=-1))),
                f"{of_run.mean():.1f}",
            ]
            for variant, drifted, of_run in zip(VARIANTS, drifts, nees, strict=True)
        ],
    )


if __name__ == "__main__":
    main()
