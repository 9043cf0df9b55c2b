"""Holes of a log, after which the pose is a guess, and of its truth."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Indexes, Stamps
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import Interval, interpolate_poses
from icreckon.estimator.log.series import Truth
from icreckon.replay.comparison.fixes import scored_intervals

# Shortest gap without track speeds or IMU samples that is a hole, and at the ends of a log [s].
HOLE, HOLE_AT_END = 1.0, 5.0
LONGEST_BRIDGE = 1.0  # longest bridged interval of the truth, or twice the usual one [s]


def holes_of(log: Log) -> list[Interval]:
    """Intervals [ns] without track speeds or without IMU samples, merged."""
    gaps: list[Interval] = []
    for stamps in filter(len, (log.tracks.stamps, *([] if log.imu is None else [log.imu.stamps]))):
        edges = np.concatenate([[log.start], stamps, [log.end]])
        least = np.pad(np.full(len(stamps) - 1, HOLE), 1, constant_values=HOLE_AT_END)
        before = np.flatnonzero(np.diff(edges) * NANOSECOND > least)
        gaps += zip(edges[before].tolist(), edges[before + 1].tolist(), strict=True)
    whole = [(log.start, log.end)]
    return between_holes(whole, between_holes(whole, gaps))


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
    """Intervals of scored drift within the truth, less the holes of the log."""
    parts = between_holes(scored_intervals(log), holes_of(log))
    if log.truth is not None and len(known := log.truth.poses.stamps):
        parts = [(max(low, int(known[0])), min(high, int(known[-1]))) for low, high in parts]
    return [(low, high) for low, high in parts if low < high]


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
