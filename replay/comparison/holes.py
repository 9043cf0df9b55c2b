"""Holes of a log, and uncertainty after them that no robot exceeds."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import Interval, path_length
from icreckon.estimator.streaming.outputs import Run

HOLE = 1.0
"""Shortest gap without track speeds or IMU samples that is a hole [s]."""
UNKNOWN_YAW = math.pi / math.sqrt(3.0)
"""Standard deviation of a yaw of which nothing is known [rad]."""


def holes_of(log: Log) -> list[Interval]:
    """Intervals of stamps [ns] without track speeds or without IMU samples."""
    streams = [log.tracks.stamps, *([] if log.imu is None else [log.imu.stamps])]
    found: list[Interval] = []
    edges = [
        one[np.flatnonzero(np.diff(one) * NANOSECOND > HOLE)[:, None] + (0, 1)] for one in streams
    ]
    for begin, end in sorted(map(tuple, np.concatenate(edges).tolist())):
        if found and begin <= found[-1][1]:
            begin, end = found[-1][0], max(end, found.pop()[1])
        found.append((begin, end))
    return found


def before_holes(within: list[Interval], holes: Sequence[Interval]) -> list[Interval]:
    """Intervals up to the first hole in them, after which the pose is a guess."""
    return [
        (low, min([high, *(begin for begin, _ in holes if low <= begin < high)]))
        for low, high in within
    ]


def within_reach(run: Run, holes: Sequence[Interval], fastest: float) -> Run:
    """Run whose pose is no more uncertain after a hole than the robot can have driven.

    Its position sigma is at most that before the first hole, the fastest drive [m/s] through all holes
    of its log, and twice the path driven between them, of which the direction is unknown; its yaw sigma
    `UNKNOWN_YAW`.
    """
    if not holes:
        return run
    trajectory, stamps = run.trajectory, run.trajectory.stamps
    first = int(np.searchsorted(stamps, holes[0][0]).clip(max=len(stamps) - 1))
    sigmas, way = largest_sigma(trajectory.pose_covariances), path_length(trajectory.pose_series)
    reach = sigmas[first] + 2.0 * (way - way[first])
    for begin, end in holes:
        inside = np.clip(stamps, begin, end) - begin
        guessed = np.interp(inside, stamps - begin, way) - np.interp(0, stamps - begin, way)
        reach += fastest * inside * NANOSECOND - 2.0 * guessed
    yaws = np.sqrt(trajectory.pose_covariances[:, 2, 2])
    scale = np.ones((len(stamps), 3))
    after = slice(first + 1, None)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale[after, :2] = np.fmin(1.0, reach / sigmas)[after, None]
        scale[after, 2] = np.fmin(1.0, UNKNOWN_YAW / yaws)[after]
    covariances = trajectory.pose_covariances * scale[:, :, None] * scale[:, None, :]
    return replace(run, trajectory=replace(trajectory, pose_covariances=covariances))


def largest_sigma(covariances: Floats) -> Floats:
    """Standard deviation (n,) of the position along its least certain direction [m]."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]))
