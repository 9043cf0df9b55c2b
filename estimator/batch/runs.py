"""Runs of several filters over the same measurements, side by side, in parts."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.batch.front_end import FrontEnd, Measured
from icreckon.estimator.engine.constants import aligned
from icreckon.estimator.engine.filters import BatchFilter, Lanes
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.schedule import Steps
from icreckon.estimator.engine.work import ESTIMATE
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.sensors.input_settings import InputSettings, input_settings

# Number of steps of a part. All filters run through a part before the next, so that its inputs stay in
# the processor's cache.
PART = 256


class Worked(NamedTuple):
    """Filters at the end of their runs."""

    lanes: Lanes  # the filters
    estimates: Floats  # (ticks, rows, width) see `icreckon.estimator.engine.work.ESTIMATE`


def work_through_runs(
    filters: Sequence[BatchFilter],
    measured: Sequence[Measured],
    steps: Steps,
    *,
    start: Floats,
    start_sigma: Floats,
) -> list[Worked]:
    """Run filters over the measurements of runs, one run for each lane.

    Each filter has its measurements, at the stamps of the steps. All begin at the pose `start` (3,)
    [m, m, rad] with standard deviations `start_sigma`.
    """
    width = filters[0].width
    ticks = int(steps.ticks.max(initial=0)) + 2
    # Filters with the same measurements, settings and type of numbers share their inputs.
    keys: list[tuple[int, InputSettings, Any]] = []
    fronts: dict[tuple[int, InputSettings, Any], FrontEnd] = {}
    inputs: dict[tuple[int, InputSettings, Any], Floats] = {}
    lanes: list[Lanes] = []
    for batch, data in zip(filters, measured, strict=True):
        settings = input_settings(batch.robot, batch.settings)
        key = id(data), settings, batch.number
        keys.append(key)
        if key not in fronts:
            fronts[key] = FrontEnd(data, steps, settings)
            part_size = PART * len(INPUTS) * width
            inputs[key] = aligned(part_size, batch.number).reshape(PART, -1, width)
        lanes.append(batch.begin(data.first_speeds(settings), start, start_sigma))
    tables = [batch.prepare(steps) for batch in filters]
    estimates = [np.zeros((ticks, len(ESTIMATE), width)) for _ in filters]
    for begin in range(0, len(steps.kinds), PART):
        end = min(begin + PART, len(steps.kinds))
        part = steps.part(begin, end)
        for key, front in fronts.items():
            front.fill(begin, end, inputs[key][: end - begin])
        for number, batch in enumerate(filters):
            part_inputs = inputs[keys[number]][: end - begin]
            table, rows = tables[number][begin:end], estimates[number][int(part.ticks[0]) :]
            batch.work_through(lanes[number], part_inputs, part, table, rows)
    return [Worked(*pair) for pair in zip(lanes, estimates, strict=True)]


def side_by_side(stamps: Stamps, worked: Worked) -> Trajectory:
    """Trajectory of all lanes (second axis) at the stamps (n,) of the ticks [ns]."""
    # Columns of `ESTIMATE`: pose, upper triangle of its covariance, twist, and that of the twist.
    rows = worked.estimates[: len(stamps)]
    poses, twists = np.moveaxis(rows[:, :3], 1, -1), np.moveaxis(rows[:, 9:12], 1, -1)
    pose_covariances, twist_covariances = _symmetric(rows[:, 3:9]), _symmetric(rows[:, 12:18])
    return Trajectory(stamps, poses, pose_covariances, twists, twist_covariances)


def _symmetric(upper: Floats) -> Floats:
    """Matrices (n, width, 3, 3) of their upper entries (n, 6, width), row by row."""
    entries = upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]]
    return np.moveaxis(entries.reshape(-1, 3, 3, upper.shape[2]), -1, 1)
