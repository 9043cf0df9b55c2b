"""Scores of filters side by side, as sums over the ticks.

Definitions are those of `estimator.log.scores`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.log.scores import SEGMENT_STEP, SLOWEST_MEAN_SPEED
from icreckon.estimator.streaming.lost import loss_kind
from icreckon.estimator.tracing.jit_kernel import entry

# Sums of each lane; kind of its first loss, see `estimator.streaming.lost`, and the tick of that.
(
    COUNT,
    POSITION_SQUARE,
    YAW_SQUARE,
    FINAL_POSITION,
    FINAL_YAW,
    V_X_SQUARE,
    V_Y_SQUARE,
    W_SQUARE,
    POSE_NEES,
    POSE_COUNT,
    FINAL_NEES,
    VELOCITY_NEES,
    VELOCITY_COUNT,
    LOST_KIND,
    LOST_TICK,
    SUMS,
) = range(16)
# Sums of each lane and horizon.
ERROR, YAW_ERROR, DISTANCE, DRIFTS = range(4)
# Number of values at the start of a segment: estimated and true pose, and length of the path. Number of
# rows of an estimate: pose, twist, and their covariances.
START_VALUES, ESTIMATE_ROWS = 7, 18
# A covariance with a smaller eigenvalue counts as singular, as in `pose_nees`.
LEAST_EIGENVALUE = 1e-12


class TrueTicks(NamedTuple):
    """Truth of each lane at the ticks.

    Attributes:
        poses: (ticks, 3, lanes) [m, m, rad].
        twists: (ticks, 3, lanes) [m/s, m/s, rad/s].
        lengths: (ticks, lanes) length of the path so far [m].
    """

    poses: Floats
    twists: Floats
    lengths: Floats


class Segments(NamedTuple):
    """Starts and ends of the segments of drift.

    Attributes:
        horizons: (h,) lengths of the segments [s].
        slots: (ticks,) slot for the poses at the start of a segment, -1 if none starts.
        ends: (h, ticks) slot of the segment that ends, -1 if none does.
        room: number of slots.
    """

    horizons: Floats
    slots: Any
    ends: Any
    room: int


def segments_of(
    stamps: Stamps, horizons: Sequence[float], within: Sequence[list[tuple[int, int]] | None]
) -> Segments:
    """Make the segments of `estimator.log.scores.drift` over a truth without gaps.

    Args:
        stamps: (n,) stamps of the ticks [ns].
        horizons: lengths of the segments [s].
        within: intervals of stamps [ns] of each horizon, of which one must contain the whole segment;
            None for no limit.
    """
    begins = np.arange(stamps[0], stamps[-1], int(SEGMENT_STEP / NANOSECOND))
    first = np.unique(np.searchsorted(stamps, begins))
    longest = max(horizons, default=0.0)
    room = int(longest / SEGMENT_STEP) + 2
    slots = np.full(len(stamps), -1)
    slots[first] = np.arange(len(first)) % room
    ends = np.full((len(horizons), len(stamps)), -1)
    for row, (horizon, intervals) in enumerate(zip(horizons, within, strict=True)):
        last = np.searchsorted(stamps, stamps[first] + int(horizon / NANOSECOND))
        keep = last < len(stamps)
        if intervals is not None:
            ending = stamps[np.minimum(last, len(stamps) - 1)]
            inside = [(stamps[first] >= low) & (ending <= high) for low, high in intervals]
            keep &= np.any(inside, axis=0) if inside else False
        ends[row, last[keep]] = slots[first[keep]]
    return Segments(np.array(horizons, dtype=float), slots, ends, room)


class Scores:
    """Scores of some filters.

    Args:
        lanes: number of filters.
        truth: truth of each lane at all ticks.
        segments: segments of drift.
    """

    def __init__(self, lanes: int, truth: TrueTicks, segments: Segments) -> None:
        self._truth, self._segments = truth, segments
        self.sums = np.zeros((SUMS, lanes))
        self.sums[FINAL_NEES] = math.nan
        self.drifts = np.zeros((len(segments.horizons), DRIFTS, lanes))
        self._starts = np.zeros((segments.room, START_VALUES, lanes))

    def add(self, tick: int, estimates: Floats) -> None:
        """Add the errors at some consecutive ticks.

        Args:
            tick: index of the first tick.
            estimates: (n, rows, lanes) see `estimator.engine.work.ESTIMATE`.
        """
        truth, segments = self._truth, self._segments
        add_entry(self.sums, self.drifts, self._starts, estimates, tick, truth, segments)


def add_ticks(
    sums: Floats,
    drifts: Floats,
    starts: Floats,
    estimates: Floats,
    tick: int,
    truth: TrueTicks,
    segments: Segments,
) -> None:
    """Add the errors at some consecutive ticks, see `Scores.add`.

    Args:
        sums: (SUMS, lanes) changed in place.
        drifts: (h, DRIFTS, lanes) changed in place.
        starts: (slots, START_VALUES, lanes) poses at the starts of segments, changed in place.
        estimates: (n, rows, lanes) estimates.
        tick: index of the first tick.
        truth: truth at all ticks.
        segments: segments of drift.

    Raises:
        ValueError: an array has the wrong size.
    """
    poses, twists, lengths = truth.poses, truth.twists, truth.lengths
    horizons, slots, ends = segments.horizons, segments.slots, segments.ends
    lanes, last, count = sums.shape[1], tick + len(estimates), len(horizons)
    sizes_fit = len(sums) == SUMS and drifts.shape == (count, DRIFTS, lanes)
    sizes_fit &= starts.shape[1] == START_VALUES and starts.shape[2] == lanes
    sizes_fit &= estimates.shape[1] >= ESTIMATE_ROWS and estimates.shape[2] >= lanes
    sizes_fit &= min(len(poses), len(twists), len(lengths), len(slots)) >= last and tick >= 0
    sizes_fit &= poses.shape[1] >= 3 and twists.shape[1] >= 3
    sizes_fit &= poses.shape[2] >= lanes and twists.shape[2] >= lanes and lengths.shape[1] >= lanes
    if not sizes_fit or ends.shape[0] != count or ends.shape[1] < last:
        raise ValueError(WRONG_SIZE)
    if len(slots) and (max(slots.max(), ends.max() if count else -1) >= len(starts)):
        raise ValueError(WRONG_SIZE)
    for k in range(len(estimates)):
        now, at = estimates[k], tick + k
        for lane in range(lanes):
            d_x, d_y = now[0, lane] - poses[at, 0, lane], now[1, lane] - poses[at, 1, lane]
            d_yaw = wrap_angle(now[2, lane] - poses[at, 2, lane])
            square = d_x * d_x + d_y * d_y
            if sums[LOST_KIND, lane] == 0.0:
                sums[LOST_KIND, lane] = kind_at(now, lane)
                sums[LOST_TICK, lane] = at
            sums[COUNT, lane] += 1.0
            sums[POSITION_SQUARE, lane] += square
            sums[YAW_SQUARE, lane] += d_yaw * d_yaw
            sums[FINAL_POSITION, lane] = math.sqrt(square)
            sums[FINAL_YAW, lane] = abs(d_yaw)
            if math.isnan(square):
                sums[FINAL_NEES, lane] = math.nan
            nees = nees_of(now, 3, lane, d_x, d_y, d_yaw)
            if nees >= 0.0:
                sums[POSE_NEES, lane] += nees
                sums[POSE_COUNT, lane] += 1.0
                sums[FINAL_NEES, lane] = nees
            v_x = now[9, lane] - twists[at, 0, lane]
            v_y = now[10, lane] - twists[at, 1, lane]
            w = now[11, lane] - twists[at, 2, lane]
            sums[V_X_SQUARE, lane] += v_x * v_x
            sums[V_Y_SQUARE, lane] += v_y * v_y
            sums[W_SQUARE, lane] += w * w
            nees = nees_of(now, 12, lane, v_x, v_y, w)
            if nees >= 0.0:
                sums[VELOCITY_NEES, lane] += nees
                sums[VELOCITY_COUNT, lane] += 1.0
        for h in range(len(horizons)):
            slot = ends[h, at]
            if slot >= 0:
                for lane in range(lanes):
                    end_segment(
                        drifts[h], starts[slot], now, poses[at], lengths[at], horizons[h], lane
                    )
        slot = slots[at]
        if slot >= 0:
            for lane in range(lanes):
                for axis in range(3):
                    starts[slot, axis, lane] = now[axis, lane]
                    starts[slot, 3 + axis, lane] = poses[at, axis, lane]
                starts[slot, 6, lane] = lengths[at, lane]


def kind_at(now: Floats, lane: int) -> int:
    """Kind of loss of the estimate of a lane, see `estimator.streaming.lost`."""
    return loss_kind(
        (now[0, lane], now[1, lane], now[2, lane]),
        (now[3, lane], now[6, lane], now[8, lane]),
        (now[9, lane], now[10, lane], now[11, lane]),
        (now[12, lane], now[15, lane], now[17, lane]),
    )


def end_segment(
    sums: Floats,
    begin: Floats,
    now: Floats,
    pose: Floats,
    length: Floats,
    horizon: float,
    lane: int,
) -> None:
    """Add a segment that ends here to the sums of its horizon."""
    distance = length[lane] - begin[6, lane]
    if distance <= SLOWEST_MEAN_SPEED * horizon:
        return
    x, y, yaw = moved(begin, 0, now, lane)
    true_x, true_y, true_yaw = moved(begin, 3, pose, lane)
    sums[ERROR, lane] += math.sqrt((x - true_x) ** 2 + (y - true_y) ** 2)
    sums[YAW_ERROR, lane] += abs(wrap_angle(yaw - true_yaw))
    sums[DISTANCE, lane] += distance


def moved(begin: Floats, row: int, end: Floats, lane: int) -> tuple[float, float, float]:
    """Motion since the start of a segment, in the axes of the pose there."""
    cos, sin = math.cos(begin[row + 2, lane]), math.sin(begin[row + 2, lane])
    d_x, d_y = end[0, lane] - begin[row, lane], end[1, lane] - begin[row + 1, lane]
    return cos * d_x + sin * d_y, -sin * d_x + cos * d_y, end[2, lane] - begin[row + 2, lane]


def nees_of(now: Floats, row: int, lane: int, a: float, b: float, c: float) -> float:
    """NEES of three errors by the covariance in six rows; -1 if it is singular."""
    xx, xy, xz = now[row, lane], now[row + 1, lane], now[row + 2, lane]
    yy, yz, zz = now[row + 3, lane], now[row + 4, lane], now[row + 5, lane]
    # All eigenvalues exceed the least if the matrix less that times I is positive definite.
    if not positive(
        xx - LEAST_EIGENVALUE, xy, xz, yy - LEAST_EIGENVALUE, yz, zz - LEAST_EIGENVALUE
    ):
        return -1.0
    of_y, of_z = xy / xx, xz / xx
    left_yy, left_yz = yy - of_y * xy, yz - of_y * xz
    of_yz = left_yz / left_yy
    left_zz = zz - of_z * xz - of_yz * left_yz
    b -= of_y * a
    c -= of_z * a + of_yz * b
    return float(a * a / xx + b * b / left_yy + c * c / left_zz)


def positive(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> bool:
    """Return True if a symmetric matrix is positive definite."""
    if xx <= 0.0:
        return False
    left_yy, left_yz = yy - xy * xy / xx, yz - xy * xz / xx
    if left_yy <= 0.0:
        return False
    return zz - xz * xz / xx - left_yz * left_yz / left_yy > 0.0


add_entry = entry(add_ticks)
