"""Drift of filters with a calibrated robot file, on the logs of its calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import drift
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.checking.worth import HORIZONS, VARIANT
from icreckon.replay.comparison.compare import compare
from icreckon.replay.comparison.known_bias import GYRO
from icreckon.replay.comparison.scores import truths_of


class Gains(NamedTuple):
    """Mean drift over the logs without fixes, by variant [% of the distance]; NaN for no result.

    Attributes:
        horizon: time of dead reckoning [s].
        before: with the robot file from which the calibration started.
        after: with the calibrated one.
    """

    horizon: float
    before: dict[str, float]
    after: dict[str, float]


def filter_gains(
    before: tuple[Sequence[Log], Robot],
    after: tuple[Sequence[Log], Robot],
    progress: Callable[[float], None],
) -> Gains:
    """Run `inertia-online` and `gyro` with the robot file before and after a calibration.

    Args:
        before: logs as read with the robot file before, and that robot.
        after: likewise, with the calibrated robot.
        progress: called with the share that is done, 0 to 1.
    """
    shortest = min(log.duration for log in after[0])
    horizon = next((one for one in HORIZONS if shortest > 2.0 * one), HORIZONS[-1])
    found: list[dict[str, float]] = []
    for logs, robot in (before, after):
        of_logs: dict[str, list[float]] = {VARIANT: [], GYRO: []}
        for number, log in enumerate(logs):
            for name, values in of_logs.items():
                values.append(_drift(log, robot, name, horizon))
            progress((len(found) + (number + 1) / len(logs)) / 2.0)
        found.append({name: float(np.mean(values)) for name, values in of_logs.items()})
    return Gains(horizon, *found)


def _drift(log: Log, robot: Robot, variant: str, horizon: float) -> float:
    try:
        found = compare(replace(log, fixes=None), robot, variant)
    except ReplayError:
        return float("nan")
    if found.log.truth is None:
        return float("nan")
    path = found.runs[variant].trajectory.pose_series
    return drift(path, truths_of(found)[variant].truth.poses, horizon).percent_mean
