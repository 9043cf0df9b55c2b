"""Cost of a `track_gauge` that is wrong by a tenth, on real logs.

    python benchmarks/wrong_gauge.py LOGS

Each log is replayed without fixes by the robot file of its robot, and with a gauge 10 % smaller and
larger, all else as it is: so the effective track `eta0 track_gauge` is wrong at the start, too. In the
second pair `eta0` is set so that the effective track stays, as `icreckon inspect` does with the gauge it
is given. The numbers are medians of the drift after 30 s, in per cent of the distance.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import msgspec
from _logs import WITH_TRUTH

from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.replay.comparison.compare import compare
from icreckon.replay.comparison.fixes import scored_intervals
from icreckon.replay.comparison.scores import scores, truths_of
from icreckon.replay.reading.read_log import read_log

LOGS = ("husky_deflated_part1", "marmotte_part1", "warthog_grass_2024_8_8_15h56s39")
VARIANTS = ("gyro", "inertia-online")
CHANGES = (("right", 1.0, False), *((f"{f:g}", f, False) for f in (0.9, 1.1)),
           *((f"{f:g}, same eta0 track_gauge", f, True) for f in (0.9, 1.1)))  # fmt: skip


def with_gauge(robot: Robot, factor: float, *, keeps_track: bool) -> Robot:
    """The robot with a gauge that is wrong by a factor.

    Args:
        robot: the robot.
        factor: the factor.
        keeps_track: `eta0` is changed, too, so that the effective track stays.
    """
    replace = msgspec.structs.replace
    vehicle = replace(robot.vehicle, track_gauge=factor * robot.vehicle.track_gauge)
    indices = robot.indices
    if keeps_track:
        indices = replace(indices, eta0=max(1.0, indices.eta0 / factor))
    return replace(robot, vehicle=vehicle, indices=indices)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs", type=Path)
    given = parser.parse_args()
    print(f"log | gauge | {' | '.join(VARIANTS)}")
    for name in LOGS:
        own = load_robot(WITH_TRUTH[name])
        for label, factor, keeps in CHANGES:
            robot = with_gauge(own, factor, keeps_track=keeps)
            found = compare(read_log(given.logs / name, robot), robot, VARIANTS, engine="batch")
            truths, scored = truths_of(found), scored_intervals(found.log)
            drifts = [
                scores(one, truths[variant], scored)["drift_percent_30s_median"]
                for variant, one in found.runs.items()
            ]
            cells = " | ".join(f"{drift:.2f}" for drift in drifts)
            print(f"{name} | {label} | {cells}", flush=True)


if __name__ == "__main__":
    main()
