"""Drift on the next log before and after `icreckon calibrate` on one short log.

    python benchmarks/short_calibration.py [--data DATA] [--seeds 10] [--workers 2]

Simulated: each seed is another robot, which is not quite that of its file, on a drive of 60 s to
calibrate from, and on another one of 120 s that is scored. With DATA, the folder of the sample logs (see
accuracy.py): pieces of 60 s, each scored on the 120 s behind it, from the makers' figures and from the
files that ship with icreckon. Errors over 30 s are summed over all runs; the ratio has a 95 % bootstrap
interval over them. `worse` counts the runs in which a calibration makes the drift larger by a tenth or
more.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _logs import WITH_TRUTH
from _study import script_parser, table
from accuracy import as_made

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.calibration import calibrate
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.replay.comparison.bootstrap import paired_drift
from icreckon.replay.comparison.compare import compare
from icreckon.replay.mapping.topics import topic_map
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

VARIANTS = ("gyro", "constant-fixed", "constant-online", "inertia-online")
MODELS = ("constant", "inertia")
DRIVES = ("random", "aggressive", "arcs", "slalom")
SHORT, NEXT, HORIZON = 60.0, 120.0, "30s"
DRAWS = 2000


class Job(NamedTuple):
    """A robot file, a log to calibrate from, and one to score."""

    name: str
    robot: Robot
    short: Log
    next: Log


def simulated(seed: int) -> Job:
    """A robot of which only its file is known, on two drives."""
    robot, drive = load_robot("auriga-alpha"), DRIVES[seed % len(DRIVES)]
    first = Scenario(trajectory=drive, duration=SHORT, seed=seed, fix_rate=0.0)
    second = Scenario(
        trajectory="random",
        trajectory_options={"hold": 4.0},
        duration=NEXT,
        seed=seed,
        fix_rate=0.0,
    )
    return Job(f"{drive} {seed}", robot, simulate(first, robot), simulate(second, robot))


def pieces(data: Path, name: str, robot: Robot) -> Iterator[Job]:
    """Pieces of a sample log, each with what follows."""
    log = read_log(data / name, robot)
    start = 0.0
    while start + SHORT + NEXT <= log.duration:
        middle = start + SHORT
        yield Job(name, robot, log.part(start, middle), log.part(middle, middle + NEXT))
        start += SHORT


def with_robot(log: Log, old: Robot, new: Robot) -> Log:
    """A log as it would be read with another robot file."""
    ratio = new.vehicle.sprocket_radius / old.vehicle.sprocket_radius
    later = _latency(new) - _latency(old)
    tracks = replace(
        log.tracks,
        stamps=log.tracks.stamps - round(later / NANOSECOND),
        speeds=log.tracks.speeds * ratio,
    )
    return replace(log, tracks=tracks)


def _latency(robot: Robot) -> float:
    tracks = topic_map(robot).tracks
    return 0.0 if tracks is None else tracks.latency


def drifts(log: Log, robot: Robot) -> tuple[Floats, float]:
    """Summed errors of each variant [m], and the distance [m]."""
    found = compare(log, robot, VARIANTS).drifts[HORIZON]
    paired = paired_drift({name: found[name] for name in VARIANTS})
    return paired.errors.sum(axis=1), float(paired.distances.sum())


def worked(job: Job) -> tuple[str, Floats, Floats, float] | None:
    """Errors before and after [m], and the distance [m]; None if it cannot be calibrated."""
    try:
        found = calibrate([job.short], job.robot, models=MODELS)
    except EstimatorError as problem:
        print(f"{job.name}: {problem}", flush=True)
        return None
    before, distance = drifts(job.next, job.robot)
    after, _ = drifts(with_robot(job.next, job.robot, found.robot), found.robot)
    return job.name, before, after, distance


def seeded(seed: int) -> tuple[str, Floats, Floats, float] | None:
    """Work on a simulated robot."""
    return worked(simulated(seed))


def report(rows: list[tuple[str, Floats, Floats, float]]) -> None:
    """Print the table of some runs."""
    before, after = (np.array([row[at] for row in rows]) for at in (1, 2))
    distance = np.array([row[3] for row in rows])
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(rows), (DRAWS, len(rows)))
    lines = []
    for at, name in enumerate(VARIANTS):
        ratios = after[drawn, at].sum(axis=1) / before[drawn, at].sum(axis=1)
        low, high = np.quantile(ratios, (0.025, 0.975))
        lines.append(
            [
                f"`{name}`",
                f"{100.0 * before[:, at].sum() / distance.sum():.2f}",
                f"{100.0 * after[:, at].sum() / distance.sum():.2f}",
                f"{after[:, at].sum() / before[:, at].sum():.2f} ({low:.2f} to {high:.2f})",
                f"{int((after[:, at] > 1.1 * before[:, at]).sum())} of {len(rows)}",
            ]
        )
    table(["% after 30 s", "file", "calibrated", "ratio", "worse"], lines)


def main() -> None:
    """Print the tables."""
    parser = script_parser(__doc__)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    with ProcessPoolExecutor(given.workers) as pool:
        if given.seeds:
            report([one for one in pool.map(seeded, range(given.seeds)) if one is not None])
        for title, file in (("makers' figures", as_made), ("shipped", load_robot)):
            if given.data is None:
                break
            robots = {name: file(robot) for name, robot in WITH_TRUTH.items()}
            jobs = [job for name in robots for job in pieces(given.data, name, robots[name])]
            rows = [one for one in pool.map(worked, jobs) if one is not None]
            for name in dict.fromkeys(row[0] for row in rows):
                print(f"\n{name}, {title}\n")
                report([row for row in rows if row[0] == name])
            print(f"\nall logs, {title}\n", flush=True)
            report(rows)


if __name__ == "__main__":
    main()
