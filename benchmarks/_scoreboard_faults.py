"""Faults of the scoreboard: errors at their end and 30 s later, own uncertainty, flags in health.

Each fault begins after 60 s, or before the first drive, in the same log that is also run without it.
Simulated: random driving of two robots on level ground. Real: two logs, with fixes made of their truth
and white noise of 5 cm, from 60 s before the fault on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from _logs import GRASS
from _scoreboard_cells import SEED, Job, data_folder, excluded, flags, rules_disabled
from _scoreboard_drives import robot_of
from _scoreboard_put import BEFORE, FAULTS, MOVING, NEVER, POWER_UP, RTK, SECOND, Fault
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import FixSeries, PoseSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import run
from icreckon.replay.comparison.truth_alignment import align_truth
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import FixSpec
from icreckon.simulation.simulate import simulate

BEGINS, LATER, POLL = 60.0, 30.0, 0.25
RUNS = 3
"""Runs of a fault, each with a drive of its own."""
ROBOTS = ("auriga-alpha", "warthog")
QUICK = ROBOTS[:1]
REAL = {GRASS[0]: "warthog", "marmotte_part1": "marmotte"}
FIX_SIGMA = 0.05
REST = 10.0
"""Rest before the first drive, or around the begin of a fault [s]."""
SIGMAS, TWICE = 3.0, 2.0
FLOOR, YAW_FLOOR = 0.1, math.radians(1.0)
"""Errors that count as without the fault, however small those are [m, rad]."""
GATED = 3
"""Further rejections by gates that count as a flag."""


class Place(NamedTuple):
    """A drive into which faults are put.

    Attributes:
        log: the drive, from its start.
        robot: its robot file.
        truth: true poses.
        start: pose at its start, and standard deviations.
        begin: stamp at which faults begin [ns].
    """

    log: Log
    robot: Robot
    truth: PoseSeries
    start: tuple[float, float, float]
    start_sigma: tuple[float, float, float]
    begin: int


def groups() -> dict[tuple[str, str], list[str]]:
    """Faults by the drive that they are put into: when they begin, and which fixes there are."""
    found: dict[tuple[str, str], list[str]] = {}
    for name, fault in FAULTS.items():
        found.setdefault((fault.when, fault.fixes), []).append(name)
    return found


def jobs(*, quick: bool, variants: tuple[str, ...], without: tuple[str, ...]) -> Iterator[Job]:
    """Jobs: a drive of a robot, or of a real log, with all faults that are put into it."""
    for when, fixes in groups():
        for robot in QUICK if quick else ROBOTS:
            for index in range(RUNS):
                yield Job("faults", f"{robot} | {when} | {fixes}", index, variants, without)
    if quick or not data_folder():
        return
    for log in REAL:
        for fixes in (BEFORE, "under"):
            for index in range(RUNS):
                yield Job("faults", f"{log} | {MOVING} | {fixes}", index, variants, without)


def score(job: Job) -> dict[str, Any]:
    """Figures of each fault and variant in a drive."""
    where, when, fixes = job.cell.split(" | ")
    names = groups()[when, fixes]
    if where in REAL:
        names = [name for name in names if FAULTS[name].real]
        place = recorded_place(where, job.run, fixes)
    else:
        place = simulated_place(where, job.run, when, fixes, names)
    found: dict[str, Any] = {name: {} for name in names}
    with rules_disabled(job.without):
        for variant in job.variants:
            ends = sorted({FAULTS[name].lasts for name in names})
            clean = reckoned(place, place.log, variant, ends)
            for k, name in enumerate(names):
                rng = np.random.default_rng([SEED, job.run, k])
                log = faulty(place, FAULTS[name], rng)
                one = reckoned(place, log, variant, [FAULTS[name].lasts])
                found[name][variant] = compared(FAULTS[name], one, clean)
    return found


def faulty(place: Place, fault: Fault, rng: Generator) -> Log:
    """The log of a drive with a fault."""
    end = place.begin + round(fault.lasts * SECOND)
    return fault.put(place.log, place.begin, place.log.end + 1 if fault.goes_on else end, rng)


class Reckoned(NamedTuple):
    """A run: errors and own sigmas of position and yaw by time [m, rad]; counts of health by time."""

    errors: dict[float, tuple[float, float, float, float]]
    counts: list[tuple[dict[str, float], dict[str, int], int]]


def reckoned(place: Place, log: Log, variant: str, ends: Sequence[float]) -> Reckoned:
    """Run a variant over a log up to `LATER` after the last of some ends of faults [s]."""
    estimator = PoseEstimator(
        place.robot,
        variant,
        settings=Settings(history=0.0),
        start=place.start,
        start_sigma=place.start_sigma,
    )
    errors: dict[float, tuple[float, float, float, float]] = {}
    counts = []
    times = iter(sorted({at for end in ends for at in (end, end + LATER)}))
    due, poll = next(times), 0.0
    for measurement in log.measurements():
        since = (measurement.stamp - place.begin) / SECOND
        if since > due:
            errors[due] = errors_at(place, estimator)
            due = next(times, math.inf)
            if due == math.inf:
                break
        estimator.feed(measurement)
        if since >= poll:
            health = estimator.health
            rules, gates = excluded(health)
            counts.append((flags(health), rules, sum(gates.values())))
            poll += POLL
    if due != math.inf:
        errors[due] = errors_at(place, estimator)
    return Reckoned(errors, counts)


def errors_at(place: Place, estimator: PoseEstimator) -> tuple[float, float, float, float]:
    """Errors of position and yaw of an estimate, each with its own standard deviation."""
    stamp = estimator.stamp
    off = estimator.pose - interpolate_poses(place.truth, np.array([stamp]))[0]
    P = estimator.pose_covariance
    position = float(np.hypot(*off[:2])), float(np.sqrt(max(P[0, 0] + P[1, 1], 0.0)))
    return (*position, abs(float(wrap_angle(off[2]))), float(np.sqrt(max(P[2, 2], 0.0))))


def compared(fault: Fault, found: Reckoned, clean: Reckoned) -> dict[str, Any]:
    """Errors with and without a fault, and when which flag was raised that is not raised without it."""
    delay, raised = None, set[str]()
    last = int(fault.lasts / POLL) + int(LATER / POLL)
    for k, (now, then) in enumerate(zip(found.counts, clean.counts, strict=False)):
        if k > last:
            break
        new = {name for name in now[0] if now[0][name] > then[0].get(name, 0.0)}
        new |= {name for name in now[1] if now[1][name] > then[1].get(name, 0)}
        if now[2] >= then[2] + GATED:
            new.add("gates")
        if new and delay is None:
            delay = k * POLL
        raised |= new
    at = fault.lasts, fault.lasts + LATER
    return {
        "with": [found.errors[one] for one in at],
        "without": [clean.errors[one] for one in at],
        "delay": delay,
        "raised": sorted(raised),
    }


def simulated_place(robot_name: str, index: int, when: str, fixes: str, names: list[str]) -> Place:
    """A simulated drive."""
    robot = robot_of(robot_name, sloped=False)
    longest = max(FAULTS[name].lasts for name in names)
    begins = 0.0 if when == POWER_UP else BEGINS
    duration = begins + longest + LATER + 1.0
    rate, sigma = (5.0, 0.02) if fixes == RTK else (1.0, FIX_SIGMA)
    outages = {BEFORE: ((begins - 0.5, duration),), NEVER: ((0.0, duration),)}.get(fixes, ())
    scenario = Scenario(
        trajectory="random" if when == MOVING else "recorded",
        duration=duration,
        seed=SEED + 1,
        truth_rate=20.0,
        fix_rate=rate,
        fixes=FixSpec(sigma=sigma),
        outages=outages,
    )
    recording = None
    if when != MOVING:
        rest = (0.0, REST) if when == POWER_UP else (begins - 0.5 * REST, begins + 0.5 * REST)
        rng = np.random.default_rng([SEED, index])
        recording = with_rest(robot, rng, duration, rest)
    log = simulate(scenario, robot, run_index=index, recording=recording)
    if log.truth is None:
        raise ValueError("a simulated log has a truth")
    begin = log.start + round(begins * SECOND)
    zero = (0.0, 0.0, 0.0)
    return Place(log, robot, log.truth.poses, zero, zero, begin)


def with_rest(
    robot: Robot, rng: Generator, duration: float, rest: tuple[float, float]
) -> TrackSpeedSeries:
    """Random driving with one rest, times since the start of the run [s]."""
    top, now = robot.vehicle.max_track_speed, 0.0
    times, speeds = [0.0], [(0.0, 0.0)]
    # A recorded drive begins after 3 s of standstill and a ramp.
    low, high = rest[0] - 3.2, rest[1] - 3.2
    while now < duration:
        mean, bend = top * rng.uniform(0.3, 0.8), rng.uniform(-0.3, 0.3) * top
        pair = (max(-top, min(top, mean - bend)), max(-top, min(top, mean + bend)))
        begin, end = now + 2.0 * top, now + 2.0 * top + rng.uniform(2.0, 5.0)
        if begin < high and end + 2.0 * top > low:
            times += [max(now + 0.1, low), high]
            speeds += [(0.0, 0.0)] * 2
            now = high
            continue
        times += [begin, end]
        speeds += [pair, pair]
        now = end
    stamps = np.round(np.array(times) * SECOND).astype(np.int64)
    return TrackSpeedSeries(stamps, np.array(speeds))


@cache
def recorded(name: str) -> tuple[Log, Robot, PoseSeries]:
    """A real log, its robot, and its truth at the right time and place."""
    robot = load_robot(REAL[name])
    log = read_log(Path(data_folder()) / name, robot)
    if log.truth is None:
        raise ValueError(f"{name} has no truth")
    blind = replace(log, truth=None)
    found = run(blind, robot, "inertia-online").trajectory
    return blind, robot, align_truth(log.truth, found).truth.poses


def recorded_place(name: str, index: int, fixes: str) -> Place:
    """A part of a real log in which the robot drives on, with fixes made of its truth."""
    log, robot, truth = recorded(name)
    begin = onsets(log, truth)[index]
    first = begin - round(BEGINS * SECOND)
    part = log.between(first, begin + round((30.0 + LATER + 5.0) * SECOND))
    rng = np.random.default_rng([SEED, index])
    stamps = np.arange(first + SECOND // 2, part.end, SECOND)
    gap = np.diff(truth.stamps)[
        np.searchsorted(truth.stamps, stamps).clip(1, len(truth.stamps) - 1) - 1
    ]
    stamps = stamps[(gap < SECOND // 2) & ((stamps < begin) | (fixes != BEFORE))]
    poses = interpolate_poses(truth, stamps)
    poses[:, :2] += FIX_SIGMA * rng.standard_normal((len(stamps), 2))
    poses[:, 2] = np.nan
    variances = np.tile([FIX_SIGMA**2, 1.0], (len(stamps), 1))
    x, y, yaw = interpolate_poses(truth, np.array([part.start]))[0].tolist()
    with_fixes = replace(part, fixes=FixSeries(stamps, poses, variances))
    return Place(with_fixes, robot, truth, (x, y, yaw), (0.05, 0.05, 0.05), begin)


def onsets(log: Log, truth: PoseSeries) -> list[int]:
    """Stamps at which faults begin in a real log: the robot drives most in the 10 s after them."""
    found: list[int] = []
    lasts = round((30.0 + LATER + 5.0) * SECOND)
    grid = np.arange(log.start + round(BEGINS * SECOND), log.end - lasts, 5 * SECOND)
    driven = np.array([_driven(log, one) for one in grid.tolist()])
    for place in np.argsort(-driven, kind="stable"):
        one = int(grid[place])
        inside = (truth.stamps > one - round(BEGINS * SECOND)) & (truth.stamps < one + lasts)
        whole = bool(np.diff(truth.stamps[inside]).max() < 2 * SECOND)
        if whole and all(abs(one - other) >= 15 * SECOND for other in found):
            found.append(one)
        if len(found) == RUNS:
            break
    return found


def _driven(log: Log, begin: int) -> float:
    """Distance in the 10 s after a stamp, and turning that counts as much [m]."""
    at = (log.tracks.stamps >= begin) & (log.tracks.stamps < begin + 10 * SECOND)
    if not at.any():
        return 0.0
    speeds: Floats = log.tracks.speeds[at]
    return float(np.abs(speeds).mean() * (np.abs(speeds).max(axis=1) > 0.1).mean())


def summary(job_results: list[tuple[str, dict[str, Any]]]) -> dict[str, Any]:
    """Figures of each fault by "fault | robot or log", then by variant."""
    runs: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for cell, result in job_results:
        where = cell.split(" | ")[0]
        for name, by_variant in result.items():
            for variant, one in by_variant.items():
                runs.setdefault(f"{name} | {where}", {}).setdefault(variant, []).append(one)
    return {
        cell: {variant: of_runs(found) for variant, found in by_variant.items()}
        for cell, by_variant in runs.items()
    }


def of_runs(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of a fault and a variant, of its runs."""
    own = np.array([one["with"] for one in runs])
    clean = np.array([one["without"] for one in runs])
    covered = _covered(own)
    alike = (own[..., 0] <= np.maximum(TWICE * clean[..., 0], FLOOR)) & (
        own[..., 2] <= np.maximum(TWICE * clean[..., 2], YAW_FLOOR)
    )
    delays = [one["delay"] for one in runs if one["delay"] is not None]
    found: dict[str, Any] = {
        "runs": len(runs),
        "covered": int(covered.all(axis=1).sum()),
        "alike": int((~covered & alike | covered).all(axis=1).sum() - covered.all(axis=1).sum()),
        "neither": int((~(covered | alike)).any(axis=1).sum()),
        "flagged": len(delays),
        "delay": float(np.median(delays)) if delays else None,
        "raised": sorted({name for one in runs for name in one["raised"]}),
    }
    for k, at in enumerate(("end", "later")):
        found[at] = {
            "position": _rms(own[:, k, 0]),
            "position_most": float(own[:, k, 0].max()),
            "position_sigma": _rms(own[:, k, 1]),
            "position_without": _rms(clean[:, k, 0]),
            "yaw_deg": math.degrees(_rms(own[:, k, 2])),
            "yaw_deg_most": math.degrees(own[:, k, 2].max()),
            "yaw_deg_sigma": math.degrees(_rms(own[:, k, 3])),
            "yaw_deg_without": math.degrees(_rms(clean[:, k, 2])),
        }
    return found


def _covered(errors: Floats) -> Any:
    """Mask (n, 2) of errors within three own standard deviations, of position and of yaw."""
    position = errors[..., 0] <= SIGMAS * errors[..., 1]
    return position & (errors[..., 2] <= SIGMAS * errors[..., 3])


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
