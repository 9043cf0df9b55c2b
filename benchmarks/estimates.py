"""Fingerprint of the estimates: figures of short runs that use all parts of the filter and the simulator.

    python benchmarks/estimates.py [--write]

Compares them with those in estimates.json, or writes that file. Tables of the pages carry its digest: a
change of the code that leaves all these figures the same leaves those of the tables the same, too. So a
part of the estimator or the simulator that a table needs must act in one of the runs.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from _digests import ROOT
from _scoreboard_cells import SEED, data_folder, rounded
from _scoreboard_drives import cells, simulated
from _scoreboard_faults import ROBOTS, faulty, groups, simulated_place
from _scoreboard_put import FAULTS
from _study import script_parser

from icreckon.estimator.base import state as s
from icreckon.estimator.calibration import calibrate
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    HeightFix,
    Measurement,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import FixWander, Settings
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.latencies import Latencies
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run, work_through
from icreckon.estimator.streaming.smoother import smooth
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.running.engines import BATCH
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import load_study
from icreckon.simulation.truth.terrain import Terrain

RESULTS = ROOT / "benchmarks" / "estimates.json"
SECOND = 1_000_000_000
RELATIVE, ABSOLUTE = 1e-4, 1e-6
"""Tolerances: two machines differ by rounding, and by what a filter makes of it within minutes."""
CELLS = {
    ("auriga-alpha", "level"): "gentle",
    ("small", "plane 6° to 120°"): "on the spot",
    ("fast", "changes every 20 s"): "random",
    ("husky", "rolling 5°"): "gentle",
}
"""Ways of driving of healthy cells of the scoreboard, by robot and ground."""
REAL = {
    "warthog_grass_2024_8_8_15h56s39": "warthog",
    "marmotte_part1": "marmotte",
    "husky_test1.bag": "husky",
    "jackal_test2.bag": "jackal",
}
STUDIES = ("driving-style", "imu-grades", "outage-length", "slopes")
HILLS = ("rolling", "plane")
BOTH = ("gyro", "inertia-online")
Figures = dict[str, list[float]]


def of_run(found: Run) -> list[float]:
    """Figures of a run: mean and last state, mean sigmas, twists and indices, rejections.

    The height has tables of its own: no other figure depends on it.
    """
    states, sigmas = (np.delete(one, s.Z, axis=1) for one in (found.states, found.state_sigmas))
    parts = (
        states.mean(axis=0),
        states[-1],
        sigmas.mean(axis=0),
        sigmas[-1],
        found.trajectory.twists.mean(axis=0),
        np.sqrt(found.trajectory.twist_covariances.mean(axis=0).diagonal()),
        found.indices.mean(axis=0),
        [float(sum(found.health.rejections().values()))],
    )
    return [float(one) for part in parts for one in part]


def of_healthy(key: tuple[str, str]) -> Figures:
    """Runs over a healthy drive: streamed, in lanes, smoothed, with all kinds of fixes, late ones too."""
    cell = next(one for one in cells() if (one.robot, one.ground, one.drive) == (*key, CELLS[key]))
    log, robot = simulated(cell, 0)
    log, truth = log.between(log.start, log.start + 130 * SECOND), log.truth
    first = log.between(log.start, log.start + 40 * SECOND)
    found = {f"{name}, lanes": of_run(run(log, robot, name)) for name in VARIANTS}
    found |= {name: of_each(log, robot, name) for name in BOTH}
    start = log.between(log.start, log.start + 15 * SECOND)
    found["late"] = of_late(start, robot, "inertia-online")
    found["smoothed"] = of_run(smooth(first, robot, "inertia-online").smoothed)
    wander = Settings(wander=FixWander(1.0, 60.0))
    found["wander"] = of_run(run(first, robot, "constant-online", settings=wander))
    if truth is not None:
        poses = zip(truth.poses.stamps.tolist(), truth.poses.poses.tolist(), strict=True)
        others = tuple(others_of(list(poses)[: 50 * 40 : 50]))
        found["others"] = of_run(run(replace(first, others=others), robot, "inertia-online"))
    return found


def of_each(log: Log, robot: Robot, variant: str) -> list[float]:
    """Figures of a run whose measurements are fed one by one; those of arrays are `lanes`."""
    return of_run(work_through(log, PoseEstimator(robot, variant), at_row=lambda: None))


def others_of(poses: Sequence[tuple[int, list[float]]]) -> Iterator[Measurement]:
    """Fixes of all other kinds, made of true poses by stamp."""
    spread = ((0.01, 0.002, 0.0), (0.002, 0.02, 0.0), (0.0, 0.0, 0.001))
    for k, (stamp, (x, y, yaw)) in enumerate(poses[10:]):
        kinds: tuple[Measurement, ...] = (
            HeadingFix(stamp, yaw + 0.01, 4e-4),
            PoseFix(stamp, x, y, yaw, spread),
            PositionFix(stamp, x, y, 0.01, 0.2, -0.1),
            BodyVelocity(stamp, 0.3, 0.0, 0.04),
        )
        yield kinds[k % len(kinds)]
    yield ZeroVelocity(poses[2][0])


def of_late(log: Log, robot: Robot, variant: str) -> list[float]:
    """Figures of an estimator whose tracks and fixes come late, and of its motion from mark to mark."""
    estimator = PoseEstimator(
        robot, variant, settings=Settings(history=2.0), latencies=Latencies(estimate_tracks=True)
    )
    late: list[Measurement] = []
    mark, moved = None, np.zeros(6)
    for measurement in log.measurements():
        if isinstance(measurement, PositionFix):
            late.append(measurement)
            continue
        if isinstance(measurement, TrackSpeeds):
            measurement = replace(measurement, stamp=measurement.stamp + SECOND // 10)
        estimator.feed(measurement)
        if late and measurement.stamp - late[0].stamp > SECOND // 3:
            estimator.feed(late.pop(0))
            if mark is not None:
                motion = estimator.relative_motion(mark)
                moved += np.concatenate([motion.pose, np.diag(motion.covariance)])
                estimator.forget(mark)
            mark = estimator.mark()
    sigmas = np.sqrt(np.diag(estimator.pose_covariance))
    return [*estimator.pose.tolist(), *sigmas.tolist(), *moved.tolist()]


def of_faults(drive: tuple[str, str]) -> Figures:
    """Runs over a drive with each of the faults that are put into it."""
    names = groups()[drive]
    place = simulated_place(ROBOTS[0], 0, *drive, names)
    found = {}
    for k, name in enumerate(names):
        log = faulty(place, FAULTS[name], np.random.default_rng([SEED, 0, k]))
        for variant in BOTH:
            found[f"{name}, {variant}"] = of_run(run(log, place.robot, variant))
    return found


def of_real(name: str) -> Figures:
    """Runs over a part of a real log, and its calibration if it has a truth."""
    robot = load_robot(REAL[name])
    log = read_log(Path(data_folder()) / name, robot)
    part = log.between(log.start, log.start + 120 * SECOND)
    found = {variant: of_run(run(part, robot, variant)) for variant in BOTH}
    if log.truth is not None:
        values = calibrate(part, robot).robot
        numbers = (*msgspec.structs.astuple(values.indices), *msgspec.structs.astuple(values.slope))
        found["calibrated"] = [float(one) for one in numbers]
    return found


def of_study(name: str) -> Figures:
    """Two runs of the first and of the last cell of a study, side by side."""
    plan, found = expand(load_study(name)), {}
    for cell in (plan.cells[0], plan.cells[-1]):
        scores = BATCH.block(cell, cell.filters, 0, 2)
        for label, values in zip(plan.labels, scores.values, strict=True):
            found[f"{cell.index} | {label}"] = np.nan_to_num(values).ravel().tolist()
    return found


def of_case(case: tuple[str, Any]) -> Figures:
    """Figures of a case, by name."""
    kind, key = case
    makers: dict[str, Callable[[Any], Figures]] = {
        "healthy": of_healthy,
        "faults": of_faults,
        "real": of_real,
        "study": of_study,
        "height": of_height,
    }
    name = " | ".join((kind, *([key] if isinstance(key, str) else key)))
    return {f"{name}: {part}": rounded(one, 7) for part, one in makers[kind](key).items()}


def of_height(ground: str) -> Figures:
    """Height, roll and pitch over a hill: in lanes, and with fixes of the height."""
    terrain = Terrain(rolling_deg=8.0) if ground == "rolling" else Terrain(slope_deg=8.0)
    robot = load_robot("warthog")
    log = simulate(Scenario(duration=60.0, seed=3, terrain=terrain), robot)
    found = {name: run(log, robot, name) for name in BOTH}
    stamps = log.tracks.stamps[100::200].tolist()
    heights = tuple(HeightFix(stamp, 0.1 * k, 0.04) for k, stamp in enumerate(stamps))
    found["fixes"] = run(replace(log, others=heights), robot, "inertia-online")
    figures: Figures = {}
    for name, one in found.items():
        parts = one.trajectory.spatial, one.trajectory.spatial_sigmas
        rows = [part[at] for part in parts if part is not None for at in (len(part) // 2, -1)]
        figures[name] = [float(value) for row in rows for value in row]
    return figures


def cases() -> list[tuple[str, Any]]:
    """All cases; those on real logs only if there are any."""
    real = REAL if data_folder() else {}
    parts = {"healthy": CELLS, "study": STUDIES, "real": real, "faults": groups(), "height": HILLS}
    return [(kind, key) for kind, keys in parts.items() for key in keys]


def estimates(workers: int | None = None) -> Figures:
    """Figures of all cases."""
    with ProcessPoolExecutor(workers or os.cpu_count()) as pool:
        return {name: one for part in pool.map(of_case, cases()) for name, one in part.items()}


def changed(before: Figures, after: Figures) -> list[str]:
    """Lines on runs whose figures differ, or that one of the two lacks."""
    lines = []
    for name in sorted({*before, *after}):
        if name not in before or name not in after:
            lines.append(f"{name}: {'new' if name in after else 'missing'}")
            continue
        one, other = (np.array(found[name], dtype=float) for found in (before, after))
        if one.shape != other.shape:
            lines.append(f"{name}: {len(one)} figures, now {len(other)}")
        elif not np.allclose(one, other, RELATIVE, ABSOLUTE, equal_nan=True):
            off = np.abs(one - other) / (ABSOLUTE + RELATIVE * np.abs(one))
            off[np.isnan(one) & np.isnan(other)] = 0.0
            k = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
            lines.append(f"{name}: {one[k]:.6g} is {other[k]:.6g} now (figure {k})")
    return lines


def kept() -> Figures:
    """Figures of the file."""
    found: Figures = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Compare, and write the file if asked; exit 1 if figures differ and it is not written."""
    parser = script_parser(__doc__)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    before, after = (kept() if RESULTS.is_file() else {}), estimates()
    if not data_folder():
        print("real logs: SKIPPED, their figures stay; ICRECKON_DATA names the folder of the logs")
        after |= {name: one for name, one in before.items() if name.startswith("real")}
    lines = changed(before, after)
    print("\n".join([*lines, f"{len(lines)} of {len(after)} runs differ"]))
    if lines and given.write:
        rows = (f"{json.dumps(name)}: {json.dumps(one)}" for name, one in sorted(after.items()))
        RESULTS.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")
    sys.exit(bool(lines) and not given.write)


if __name__ == "__main__":
    main()
