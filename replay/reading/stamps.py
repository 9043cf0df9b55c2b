"""Repair of stamps: samples out of order, and clocks that were set under way.

A step of only the headers' clock shows against the times of recording and is corrected. If the
recorder's clock was set back too, two periods overlap in the bag and cannot be separated.
"""

from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Stamps, true_runs
from icreckon.estimator.log.log import screen

LATE = 1.0  # stamps out of order by up to this are sorted; others are dropped and counted [s]
STEP = 0.5  # smallest jump of header stamps against recording times that is a step [s]
LASTING = 20  # fewest messages in a row with a new offset; fewer are wrong stamps
APART = 86_400.0  # longest gap in one log [s]
WINDOW = 0.5  # length of the windows over which samples are counted [s]
MANY, TOO_MANY, FEWEST_WINDOWS = 1.7, 2.3, 2
"""Overlap: range of the ratio to the median number of samples [-], and the fewest windows of it."""


def arrival_in_order(stamps: Stamps) -> tuple[NDArray[np.int64], int]:
    """Permutation that sorts samples that are early or late by up to `LATE`.

    Samples that are further out of order remain in place, for `screen` to drop. `stamps` (n,) [ns] are in
    the order of arrival. Returns their indices (n,) in the new order, and the number that moved.
    """
    count = len(stamps)
    places = np.arange(count)
    rising, _ = screen("", stamps)
    if rising.all():
        return places, 0
    kept = np.flatnonzero(rising)
    # Nearest in-order samples before and after each sample.
    following = np.searchsorted(kept, places, side="right")
    before = stamps[kept[np.maximum(following - 1, 0)]]
    after = stamps[kept[np.minimum(following, len(kept) - 1)]]
    near = np.minimum(_apart(stamps, before), _apart(stamps, after)) <= round(LATE / NANOSECOND)
    movable = np.flatnonzero(rising | near)
    ordered = places.copy()
    ordered[movable] = movable[np.argsort(stamps[movable], kind="stable")]
    moved = near & ~rising & (stamps != before) & (stamps != after)
    return ordered, int(moved.sum())


def _apart(stamps: Stamps, others: Stamps) -> NDArray[np.uint64]:
    """Absolute differences, unsigned so that damaged stamps cannot overflow them."""
    high, low = np.maximum(stamps, others), np.minimum(stamps, others)
    return high.astype(np.uint64) - low.astype(np.uint64)


def without_steps(stamped: Stamps, recorded: Stamps) -> tuple[Stamps, list[tuple[int, float]]]:
    """Remove clock steps from header stamps (n,) [ns], in the order of recording.

    At a step, the header stamps jump from one message to the next, the times of recording (n,) [ns] do
    not, and the new difference between the two lasts.

    Returns:
        (n,) stamps by the initial clock, and for each step the index of the first message after it and
        its size [s].
    """
    if len(stamped) <= LASTING:
        return stamped, []
    offset = (stamped - recorded).astype(float) * NANOSECOND
    even = np.diff(recorded) * NANOSECOND < STEP
    jumps = np.flatnonzero((np.abs(np.diff(offset)) > STEP) & even) + 1
    if not len(jumps):
        return stamped, []
    edges = [0, *jumps.tolist(), len(stamped)]
    lasting = [
        (begin, float(np.median(offset[begin:end])))
        for begin, end in pairwise(edges)
        if end - begin >= LASTING
    ]
    steps, corrected = [], stamped.copy()
    for (_, before), (begin, after) in pairwise(lasting):
        if abs(after - before) > STEP:
            corrected[begin:] -= round((after - before) / NANOSECOND)
            steps.append((begin, after - before))
    return corrected, steps


def doubled_times(stamps: Stamps) -> list[tuple[int, int]]:
    """Find intervals (start, end) [ns] with about twice the usual rate of samples.

    `stamps` (n,) [ns] must ascend, equal ones included.
    """
    if len(stamps) < 10 * LASTING:
        return []
    width = round(WINDOW / NANOSECOND)
    if not 10 <= (stamps[-1] - stamps[0]) // width + 1 <= len(stamps):
        return []
    edges = np.arange(stamps[0], stamps[-1] + 1, width)
    counts = np.diff(np.searchsorted(stamps, edges))
    # Without almost empty windows: a single wrong stamp lies far before or after the others.
    usual = float(np.median(counts[counts > 0.2 * counts.mean()]))
    many = (counts >= MANY * usual) & (counts <= TOO_MANY * usual)
    runs = [(first, last + 1) for first, last in true_runs(many)]
    runs = [(begin, end) for begin, end in runs if end - begin >= FEWEST_WINDOWS]
    return [(int(edges[begin]), int(edges[end])) for begin, end in runs]


def largest_part(stamps: Stamps) -> tuple[int, int]:
    """Find the interval [ns] with most stamps between gaps of more than `APART`.

    `stamps` (n,) [ns] must ascend, and be at least one. The ends are widened by half of `APART`.
    """
    apart = round(APART / NANOSECOND)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(stamps) > apart) + 1, [len(stamps)]])
    part = int(np.argmax(np.diff(edges)))
    first, last = int(stamps[edges[part]]), int(stamps[edges[part + 1] - 1])
    return first - apart // 2, last + apart // 2


def in_both(one: list[tuple[int, int]], other: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Intersect two lists of intervals [ns], widened by `WINDOW` on each side."""
    width = round(WINDOW / NANOSECOND)
    overlaps = (
        (max(begin, other_begin), min(end, other_end))
        for (begin, end), (other_begin, other_end) in product(one, other)
    )
    return [(begin - width, end + width) for begin, end in overlaps if end > begin]
