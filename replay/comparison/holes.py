"""Holes of a log, after which the pose is a guess."""

from collections.abc import Sequence

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import Interval

HOLE = 1.0
"""Shortest gap without track speeds or IMU samples that is a hole [s]."""


def holes_of(log: Log) -> list[Interval]:
    """Intervals of stamps [ns] without track speeds or without IMU samples."""
    streams = [log.tracks.stamps, *([] if log.imu is None else [log.imu.stamps])]
    found: list[Interval] = []
    # Stamps (n, 2) of the last sample before and the first after each hole of a stream.
    edges = [
        stamps[np.flatnonzero(np.diff(stamps) * NANOSECOND > HOLE)[:, None] + (0, 1)]
        for stamps in streams
    ]
    for begin, end in sorted(map(tuple, np.concatenate(edges).tolist())):
        if found and begin <= found[-1][1]:
            begin, end = found[-1][0], max(end, found.pop()[1])
        found.append((begin, end))
    return found


def before_holes(within: list[Interval], holes: Sequence[Interval]) -> list[Interval]:
    """Cut each interval at the first hole in it, after which the pose is a guess."""
    return [
        (low, min([high, *(begin for begin, _ in holes if low <= begin < high)]))
        for low, high in within
    ]


def largest_sigma(covariances: Floats) -> Floats:
    """Standard deviation (n,) of the position along its least certain direction [m]."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]))
