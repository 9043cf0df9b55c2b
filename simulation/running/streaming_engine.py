"""Streaming engine: blocks of a study on the robot's filter, one run at a time."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import msgspec
import numpy as np
from msgspec import msgpack

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import IcreckonError
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import Truth
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.variants import state_names
from icreckon.estimator.streaming.lost import LostFilter, loss_of, stopped_by
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import Rows
from icreckon.simulation.base.random_streams import random_streams
from icreckon.simulation.base.sampling import to_stamps
from icreckon.simulation.scenario import Scenario, errors_of
from icreckon.simulation.sensors.specs import FixSpec
from icreckon.simulation.simulate import (
    PerfectReadings,
    log_with_errors,
    perfect_readings,
    simulate_motion,
    truth_of,
)
from icreckon.simulation.study.cells import Cell, Filter
from icreckon.simulation.study.failures import RunScores, unscored
from icreckon.simulation.study.statistics import run_statistics, score_times

# Truths kept in memory: enough for a few concurrent blocks; cells that share them are consecutive.
KEPT_TRUTHS = 160
# Keys that error-free readings lack.
SENSED = ("noise", "outages", "encoders", "gyro", "accelerometer")


def block(cell: Cell, filters: Sequence[Filter], first_run: int, count: int) -> RunScores:
    """Statistics of some runs; see `icreckon.simulation.running.engines.Block`."""
    scores = unscored(len(filters), count, cell.horizons)
    for row in range(count):
        log = study_log(cell, first_run + row)
        times = score_times(cell.scenario)
        without_truth = replace(log, truth=None)
        for place, spec in enumerate(filters):
            try:
                result = _run(without_truth, spec, times)
            except LostFilter as lost:
                scores.reasons[place, row] = lost.reason
            else:
                scores.values[place, row] = run_statistics(result, log, cell.horizons)
    return scores


@np.errstate(all="ignore")
def _run(log: Log, chosen: Filter, times: Floats) -> Run:
    """Run a filter over a log; a row at each time [s] from its first estimate on.

    Raises:
        LostFilter: the filter raises an unexpected exception, or its estimate is impossible.
    """
    estimator = PoseEstimator(chosen.robot, chosen.variant, settings=chosen.settings)
    stamps_left = deque(to_stamps(times).tolist())
    rows, count = Rows(len(stamps_left)), 0

    def store_rows(before: int) -> None:
        """Store the estimate at all times before a stamp."""
        nonlocal count
        while stamps_left and stamps_left[0] < before:
            if stamps_left.popleft() == estimator.stamp:
                rows.put(count, estimator.snapshot())
                count += 1

    def run_so_far() -> Run:
        names = state_names(estimator.variant)
        return rows.finish(count, estimator.variant.name, names, estimator.health)

    stamp = log.start
    try:
        for measurement in log.measurements():
            stamp = measurement.stamp
            store_rows(before=stamp)
            estimator.feed(measurement)
        stamp = log.end
        store_rows(before=stamp + 1)
    except IcreckonError:
        raise
    except Exception as problem:
        raise stopped_by(problem, run_so_far(), log.start, stamp) from problem
    run = run_so_far()
    lost = loss_of(run, log.start)
    if lost is not None:
        raise lost
    return run


def study_log(cell: Cell, run_index: int) -> Log:
    """Simulated log of a run.

    Run r drives true motion r modulo `cell.truths`, and its sensors have noise of its own. For the first
    `cell.truths` runs it is the log of `icreckon.simulation.simulate.simulate`, except for the stamps of
    its truth, which are those of `score_times`.
    """
    scenario, robot = cell.scenario, cell.robot
    # Reduced to the keys that affect error-free readings, and encoded: they are the key of the cache.
    defaults = {key: getattr(Scenario(), key) for key in SENSED}
    # The latency decides which poses the fixes measure.
    fixes = FixSpec(latency=errors_of(scenario, robot).fixes.latency)
    driven = msgspec.structs.replace(scenario, **defaults, fixes=fixes)
    encoded_scenario, encoded_robot = msgpack.encode(driven), msgpack.encode(robot)
    perfect, truth = _true_run(encoded_scenario, encoded_robot, run_index % cell.truths)
    log, _ = log_with_errors(perfect, truth, scenario, robot, run_index)
    return log


@lru_cache(KEPT_TRUTHS)
def _true_run(
    encoded_scenario: bytes, encoded_robot: bytes, truth_index: int
) -> tuple[PerfectReadings, Truth]:
    """Simulate a true motion: error-free readings, and the truth at `score_times`."""
    scenario = msgpack.decode(encoded_scenario, type=Scenario)
    robot = msgpack.decode(encoded_robot, type=Robot)
    motion = simulate_motion(scenario, robot, random_streams(scenario.seed, truth_index))
    return perfect_readings(motion, scenario, robot), truth_of(motion, score_times(scenario))
