"""Drift over segments of a given distance, rather than of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.scores import Drift, Interval, segments
from icreckon.estimator.log.series import PoseSeries

DISTANCES = (5.0, 10.0, 30.0, 50.0)


@dataclass(frozen=True)
class DistanceDrift(Drift):
    """Drift over segments of one distance; `horizon` is that distance [m].

    Attributes:
        durations: (n,) duration of each segment [s].
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

    They begin like those of `estimator.log.scores.drift`, and end at the first pose of the truth at that
    distance along its path.

    Args:
        estimate: estimated poses, in any frame.
        truth: true poses.
        length: length of the segments [m].
        within: intervals of stamps [ns] that must contain a segment; None for everywhere.
        largest_gap: segments across a longer gap in the truth are left out [s].
    """
    found = segments(
        estimate,
        truth,
        lambda _, travelled, first: np.searchsorted(travelled, travelled[first] + length),
        within=within,
        largest_gap=largest_gap,
    )
    return DistanceDrift(
        length,
        found.starts,
        found.position_errors,
        found.yaw_errors,
        found.distances,
        np.asarray((found.ends - found.starts) * NANOSECOND, dtype=float),
    )
