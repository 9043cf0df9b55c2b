"""Drift over stretches of a given length of path, rather than of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.frames import Floats, relative, wrap_angle
from estimator.log import NANOSECOND, PoseSeries
from estimator.scores import SEGMENT_STEP, Drift, Interval, interpolate_poses, path_length

DISTANCES = (5.0, 10.0, 30.0, 50.0)


@dataclass(frozen=True)
class DistanceDrift(Drift):
    """Segments of one length of path; `horizon` is that length [m].

    Attributes:
        durations: (n,) how long they took [s].
    """

    durations: Floats


def drift_by_distance(
    estimate: PoseSeries,
    truth: PoseSeries,
    length: float,
    *,
    within: list[Interval] | None = None,
    largest_gap: float = 1.0,
) -> DistanceDrift:
    """Drift over all segments of a given length of the true path.

    They begin as those of `estimator.scores.drift` and end at the first pose of the truth that is so far
    along its path.

    Args:
        estimate: estimated poses, in any frame.
        truth: true poses.
        length: of the segments [m].
        within: intervals of stamps [ns] a segment must lie in wholly; None for everywhere.
        largest_gap: segments across a longer hole in the truth are left out [s].
    """
    stamps = truth.stamps[
        (truth.stamps >= estimate.stamps[0]) & (truth.stamps <= estimate.stamps[-1])
    ]
    if len(stamps) < 2:
        return DistanceDrift(length, stamps[:0], *(np.zeros(0) for _ in range(4)))
    true_poses = interpolate_poses(truth, stamps)
    travelled = path_length(PoseSeries(stamps, true_poses))
    begins = np.arange(stamps[0], stamps[-1], int(SEGMENT_STEP / NANOSECOND))
    first = np.unique(np.searchsorted(stamps, begins))
    last = np.searchsorted(travelled, travelled[first] + length)
    inside = last < len(stamps)
    first, last = first[inside], last[inside]
    gaps = np.concatenate([[0], np.cumsum(np.diff(stamps) * NANOSECOND > largest_gap)])
    keep = gaps[first] == gaps[last]
    if within is not None:
        lies = [(stamps[first] >= low) & (stamps[last] <= high) for low, high in within]
        keep &= np.any(lies, axis=0) if lies else False
    first, last = first[keep], last[keep]
    estimated = interpolate_poses(estimate, stamps)
    true_step = relative(true_poses[first], true_poses[last])
    step = relative(estimated[first], estimated[last])
    return DistanceDrift(
        length,
        stamps[first],
        np.hypot(*(step - true_step)[:, :2].T),
        np.asarray(wrap_angle(step[:, 2] - true_step[:, 2])),
        travelled[last] - travelled[first],
        (stamps[last] - stamps[first]) * NANOSECOND,
    )
