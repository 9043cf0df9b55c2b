"""Runs of several filters over the same measurements, side by side and a part at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.batch.scoring import Scores, Segments, TrueTicks
from icreckon.estimator.engine.filters import BatchFilter, Lanes, aligned
from icreckon.estimator.engine.front_end import FrontEnd, Measured
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.schedule import TICK, Steps
from icreckon.estimator.engine.work import ESTIMATE
from icreckon.estimator.sensors.input_settings import InputSettings, input_settings

# Steps that are worked through by one filter before it is the next one's turn: what they are told stays
# in the processor's cache meanwhile.
PART = 256


class Worked(NamedTuple):
    """Filters that have been through their runs.

    Attributes:
        lanes: the filters, at the end.
        scores: what was added up of them; None where nothing was to be scored.
        estimates: (ticks, rows, width) see `estimator.engine.work.ESTIMATE`; None unless asked for.
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
    keep: bool = False,
) -> list[Worked]:
    """Run filters over runs, as many as the filters are wide.

    Args:
        filters: the filters.
        measured: what each of them is told of the runs; stamps are those of the steps.
        steps: the steps.
        start: (3,) pose at the start: x, y [m], yaw [rad].
        start_sigma: (3,) its standard deviations.
        against: truth to score against, and segments of drift; None for no scores.
        keep: whether all estimates at the ticks are wanted.
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
    kept = [np.zeros((ticks, len(ESTIMATE), width)) if keep else None for _ in filters]
    room = np.zeros((PART + 1, len(ESTIMATE), width))
    for begin in range(0, len(steps.kinds), PART):
        end = min(begin + PART, len(steps.kinds))
        part = steps.part(begin, end)
        for key, front in fronts.items():
            front.fill(begin, end, inputs[key][: end - begin])
        told = np.flatnonzero(part.extras & TICK)
        for number, one in enumerate(filters):
            table = tables[number][begin:end]
            one.work_through(begun[number], inputs[keys[number]][: end - begin], part, table, room)
            if not len(told):
                continue
            first = int(part.ticks[told[0]])
            estimates = room[first - int(part.ticks[0]) :][: len(told)]
            of_one = scores[number]
            if of_one is not None:
                of_one.add(first, estimates)
            of_kept = kept[number]
            if of_kept is not None:
                of_kept[first : first + len(told)] = estimates
    return [
        Worked(lanes, of_one, of_kept)
        for lanes, of_one, of_kept in zip(begun, scores, kept, strict=True)
    ]
