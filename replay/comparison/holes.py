"""Holes of a log, after which the pose is a guess, and of its truth."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Indexes, Stamps
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import Interval, interpolate_poses
from icreckon.estimator.log.series import Truth
from icreckon.replay.comparison.fixes import scored_intervals

HOLE = 1.0  # shortest gap without track speeds or IMU samples that is a hole [s]
LONGEST_BRIDGE = 1.0  # longest bridged interval of the truth, or twice the usual one [s]


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


def between_holes(within: list[Interval], holes: Sequence[Interval]) -> list[Interval]:
    """Parts of intervals that no hole overlaps."""
    for begin, end in holes:
        parts = [
            part
            for low, high in within
            for part in ((low, min(begin, high)), (max(end, low), high))
        ]
        within = [(low, high) for low, high in parts if low < high]
    return within


def scored_parts(log: Log) -> list[Interval]:
    """Intervals of scored drift, less the holes of the log."""
    return between_holes(scored_intervals(log), holes_of(log))


def until_holes(within: list[Interval], holes: Sequence[Interval]) -> list[Interval]:
    """Parts of intervals up to the first hole in each."""
    ends = [min([high, *(a for a, b in holes if b > low and a < high)]) for low, high in within]
    return [(low, end) for (low, _), end in zip(within, ends, strict=True) if low < end]


def largest_sigma(covariances: Floats) -> Floats:
    """Standard deviation (n,) of the position along its least certain direction [m]."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]))


def true_poses_at(truth: Truth, stamps: Stamps) -> Floats:
    """Poses (n, 3) of a truth, NaN in its holes; the yaw NaN if it has no headings."""
    known = truth.poses.stamps
    poses = interpolate_poses(truth.poses, np.clip(stamps, known[0], known[-1]))
    poses[~are_bridged(known, stamps)] = np.nan
    if not truth.headings:
        poses[:, 2] = np.nan
    return poses


def are_bridged(known: Stamps, wanted: Stamps) -> NDArray[np.bool_]:
    """Mask (n,) of the wanted stamps between close known stamps, or next to one."""
    following = np.clip(np.searchsorted(known, wanted), 1, max(1, len(known) - 1))
    usual = int(np.median(np.diff(known))) if len(known) > 1 else 0
    longest = max(int(LONGEST_BRIDGE / NANOSECOND), 2 * usual)
    before, after = known[following - 1], known[np.minimum(following, len(known) - 1)]
    is_between = (before <= wanted) & (wanted <= after) & (after - before <= longest)
    is_near = np.minimum(abs(wanted - before), abs(wanted - after)) <= longest // 2
    return np.asarray(is_between | is_near)


def nearest_rows(known: Stamps, wanted: Stamps) -> Indexes:
    """Row (n,) of the known stamp nearest to each wanted one, the earlier of two."""
    after = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    before = np.maximum(after - 1, 0)
    is_before_nearer = abs(known[before] - wanted) <= abs(known[after] - wanted)
    return np.where(is_before_nearer, before, after)
