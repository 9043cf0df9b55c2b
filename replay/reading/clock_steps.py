"""Clocks that were set while a log was recorded.

Where only the headers' clock was, the times of recording tell by how much. Where the recorder's was set
back too, bags hold two times one over the other, which nothing can take apart again.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Stamps

STEP = 0.5
"""Header stamps that jump by more than this against the time of recording may be a clock's step [s]."""
LASTING = 20
"""So many messages in a row must go by the new clock; fewer are stamps that are wrong, to be dropped."""
WINDOW = 0.5
"""Samples are counted over windows of this length [s]."""
MANY, TOO_MANY, FEWEST_WINDOWS = 1.7, 2.3, 2
"""Times one over the other have this many times the usual number of samples, for so many windows."""


def without_steps(stamped: Stamps, recorded: Stamps) -> tuple[Stamps, list[tuple[int, float]]]:
    """Header stamps as if their clock had not been set on the way.

    A step is where the header stamps jump from one message to the next while the times of recording
    go on evenly, and the new difference between the two lasts.

    Args:
        stamped: (n,) header stamps [ns], in the order of recording.
        recorded: (n,) times of recording [ns], ascending.

    Returns:
        (n,) stamps by the clock that was there first, and for each step the place of the first message
        after it and by how much the clock was set [s].
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
    """When there are about twice as many samples as else: from one stamp to another [ns].

    Args:
        stamps: (n,) in order, equal ones included [ns].
    """
    if len(stamps) < 10 * LASTING:
        return []
    width = round(WINDOW / NANOSECOND)
    edges = np.arange(stamps[0], stamps[-1] + 1, width)
    if len(edges) < 10 or len(edges) > len(stamps):
        return []
    counts = np.diff(np.searchsorted(stamps, edges))
    usual = float(np.median(counts))
    many = (counts >= MANY * usual) & (counts <= TOO_MANY * usual)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], many.astype(np.int8), [0]])))
    return [
        (int(edges[first]), int(edges[last]))
        for first, last in ends.reshape(-1, 2)
        if last - first >= FEWEST_WINDOWS
    ]


def in_both(one: list[tuple[int, int]], other: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The times that are in both lists, widened by a window on either side [ns]."""
    width = round(WINDOW / NANOSECOND)
    found = []
    for a, b in one:
        for c, d in other:
            begin, end = max(a, c), min(b, d)
            if end > begin:
                found.append((begin - width, end + width))
    return found
