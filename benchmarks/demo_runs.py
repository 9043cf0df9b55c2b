"""The demo's scenario over many seeds: drift of each variant, and paired ratios, with intervals.

    python benchmarks/demo_runs.py [--runs 20] [--trajectory random] [--rolling-resistance 0]

Prints a table in Markdown. Intervals are 95 % percentile bootstrap intervals over runs; a ratio is that
of the means over the same runs.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor

import msgspec
import numpy as np

from icreckon.cli.demo import DURATION, demo_scenario
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.scores import drift, pose_nees, without_fixes
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.run import run
from icreckon.simulation.simulate import simulate

SCORING_SEED = 1
BASELINE = "constant-online"
BOOTSTRAPS = 10_000


def score(job: tuple[str, float | None, str, int]) -> tuple[float, float]:
    """Drift after 30 s without fixes [%], and mean pose NEES, of one run."""
    trajectory, rolling, variant, index = job
    robot = load_robot("auriga-alpha")
    if rolling is not None:
        soil = msgspec.structs.replace(robot.contact.soil, rolling_resistance=rolling)
        robot = msgspec.structs.replace(robot, soil=soil)
    log = simulate(demo_scenario(SCORING_SEED, DURATION, trajectory), robot, run_index=index)
    result = run(log, robot, variant)
    if log.truth is None or log.fixes is None:
        raise ValueError("the demo's scenario has truth and fixes")
    free = without_fixes(log.fixes.stamps, log.start, log.end, 10.0)
    drifted = drift(result.trajectory.pose_series, log.truth.poses, 30.0, within=free)
    return drifted.percent_mean, float(np.mean(pose_nees(result.trajectory, log.truth.poses)))


def interval(samples: Floats) -> str:
    """95 % percentile interval."""
    low, high = np.percentile(samples, (2.5, 97.5))
    return f"{low:.2f} to {high:.2f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--trajectory", default="random")
    parser.add_argument("--rolling-resistance", type=float, help="the robot file's where left out")
    arguments = parser.parse_args()
    jobs = [
        (arguments.trajectory, arguments.rolling_resistance, variant, index)
        for variant in VARIANTS
        for index in range(arguments.runs)
    ]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        scores = np.array(list(pool.map(score, jobs)))
    drifts, nees = scores.reshape(len(VARIANTS), arguments.runs, 2).transpose(2, 0, 1)
    picks = np.random.default_rng(0).integers(0, arguments.runs, (BOOTSTRAPS, arguments.runs))
    resampled = drifts[:, picks].mean(axis=2)
    baseline = list(VARIANTS).index(BASELINE)
    print(f"| variant | drift 30 s, % | 95 % | ratio to {BASELINE} | 95 % | pose NEES (3) |")
    print("| --- | --- | --- | --- | --- | --- |")
    for row, variant in enumerate(VARIANTS):
        mean = drifts[row].mean()
        ratio = mean / drifts[baseline].mean()
        ratios = resampled[row] / resampled[baseline]
        print(
            f"| `{variant}` | {mean:.2f} | {interval(resampled[row])} | {ratio:.2f} "
            f"| {interval(ratios)} | {nees[row].mean():.1f} |"
        )


if __name__ == "__main__":
    main()
