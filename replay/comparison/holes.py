"""Holes of a log, after which the pose is a guess."""

from collections.abc import Sequence

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import Interval

HOLE = 1.0  # shortest gap without track speeds or IMU samples that is a hole [s]


def holes_of(log: Log) -> list[Interval]:
    """Intervals [ns] without track speeds or without IMU samples, merged."""
    gaps: list[Interval] = []
    for stamps in (log.tracks.stamps, *([] if log.imu is None else [log.imu.stamps])):
        before = np.flatnonzero(np.diff(stamps) * NANOSECOND > HOLE)
        gaps += zip(stamps[before].tolist(), stamps[before + 1].tolist(), strict=True)
    merged: list[Interval] = []
    for begin, end in sorted(gaps):
        if merged and begin <= merged[-1][1]:
            last_begin, last_end = merged.pop()
            begin, end = last_begin, max(end, last_end)
        merged.append((begin, end))
    return merged


def before_holes(within: list[Interval], holes: Sequence[Interval]) -> list[Interval]:
    """Cut each interval at the start of the first hole that begins in it."""
    return [
        (low, min([high, *(begin for begin, _ in holes if low <= begin < high)]))
        for low, high in within
    ]


def largest_sigma(covariances: Floats) -> Floats:
    """Standard deviation (n,) of the position along its least certain direction [m]."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]))
