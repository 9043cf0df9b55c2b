"""Dead reckoning on the sample logs, all variants, no fixes: a table in Markdown.

    python benchmarks/sample_logs.py DATA

DATA is a folder with these logs (public, BSD licences): warthog_grass_2024_8_8_15h56s39,
warthog_grass_2024_8_8_16h11s19, warthog_grass_2024_7_29_14h46s15, warthog_asphalt_2024_9_25_12h8s57,
marmotte_part1 and husky_deflated_part1, as MCAP bags. The figures are the mean position error after
30 s (10 s), in % of the distance.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from estimator.robot import load_robot
from estimator.scores import drift
from estimator.variants import VARIANTS
from replay.bags import read_log
from replay.comparison import compare

LOGS = {
    "warthog_grass_2024_8_8_15h56s39": "warthog",
    "warthog_grass_2024_8_8_16h11s19": "warthog",
    "warthog_grass_2024_7_29_14h46s15": "warthog",
    "warthog_asphalt_2024_9_25_12h8s57": "warthog",
    "marmotte_part1": "marmotte",
    "husky_deflated_part1": "husky-deflated",
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path)
    arguments = parser.parse_args()
    print(f"| log | {' | '.join(f'`{name}`' for name in VARIANTS)} |")
    print("| --- " * (len(VARIANTS) + 1) + "|")
    for name, robot_name in LOGS.items():
        robot = load_robot(robot_name)
        log = read_log(arguments.data / name, robot)
        comparison = compare(log, robot, list(VARIANTS), workers=os.cpu_count() or 1)
        if comparison.log.truth is None:
            raise ValueError(f"{name} holds no truth")
        truth = comparison.log.truth.poses
        cells = []
        for one in comparison.runs.values():
            ten, thirty = (
                drift(one.trajectory.pose_series, truth, horizon) for horizon in (10.0, 30.0)
            )
            cells.append(f"{thirty.percent_mean:.2f} ({ten.percent_mean:.2f})")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
