"""Runs of several filters over the same measurements, side by side, in parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.batch.front_end import FrontEnd, Measured
from icreckon.estimator.batch.scoring import Scores, Segments, TrueTicks
from icreckon.estimator.engine.filters import BatchFilter, Lanes, aligned
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.schedule import TICK, Steps
from icreckon.estimator.engine.work import ESTIMATE
from icreckon.estimator.sensors.input_settings import InputSettings, input_settings

# Number of steps of a part. All filters run through a part before the next, so that its inputs stay in
# the processor's cache.
PART = 256


class Worked(NamedTuple):
    """Filters at the end of their runs.

    Attributes:
        lanes: the filters.
        scores: their scores; None without a truth.
        estimates: (ticks, rows, width) see `estimator.engine.work.ESTIMATE`; None if they are not kept.
    """

    lanes: Lanes
    scores: Scores | None
    estimates: Floats | None


def work_through_runs(
    filters: Sequence[BatchFilter],
    measured: Sequence[Measured],
    steps: Steps,
    *,
    start: Floats,
    start_sigma: Floats,
    against: tuple[TrueTicks, Segments] | None = None,
    keep_estimates: bool = False,
) -> list[Worked]:
    """Run filters over the measurements of runs, one run for each lane.

    Args:
        filters: the filters.
        measured: measurements for each filter; stamps are those of the steps.
        steps: steps of the runs.
        start: (3,) pose at the start: x, y [m], yaw [rad].
        start_sigma: (3,) its standard deviations.
        against: truth to score against, and segments of drift; None for no scores.
        keep_estimates: return all estimates at the ticks.
    """
    width = filters[0].width
    ticks = int(steps.ticks.max(initial=0)) + 2
    keys = [
        (id(data), input_settings(one.robot, one.settings), one.number)
        for one, data in zip(filters, measured, strict=True)
    ]
    fronts: dict[tuple[int, InputSettings, Any], FrontEnd] = {}
    for key, data in zip(keys, measured, strict=True):
        if key not in fronts:
            fronts[key] = FrontEnd(data, steps, key[1])
    inputs = {
        key: aligned(PART * len(INPUTS) * width, key[2]).reshape(PART, -1, width) for key in fronts
    }
    begun = [
        one.begin(data.tracks[:, 0], start, start_sigma)
        for one, data in zip(filters, measured, strict=True)
    ]
    tables = [one.prepare(steps) for one in filters]
    scores = [None if against is None else Scores(width, *against) for _ in filters]
    estimates = [
        np.zeros((ticks, len(ESTIMATE), width)) if keep_estimates else None for _ in filters
    ]
    room = np.zeros((PART + 1, len(ESTIMATE), width))
    for begin in range(0, len(steps.kinds), PART):
        end = min(begin + PART, len(steps.kinds))
        part = steps.part(begin, end)
        for key, front in fronts.items():
            front.fill(begin, end, inputs[key][: end - begin])
        at_ticks = np.flatnonzero(part.extras & TICK)
        for number, one in enumerate(filters):
            table = tables[number][begin:end]
            one.work_through(begun[number], inputs[keys[number]][: end - begin], part, table, room)
            if not len(at_ticks):
                continue
            first = int(part.ticks[at_ticks[0]])
            newest = room[first - int(part.ticks[0]) :][: len(at_ticks)]
            of_one = scores[number]
            if of_one is not None:
                of_one.add(first, newest)
            all_of_one = estimates[number]
            if all_of_one is not None:
                all_of_one[first : first + len(at_ticks)] = newest
    return [Worked(*of_one) for of_one in zip(begun, scores, estimates, strict=True)]
