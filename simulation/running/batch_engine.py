"""Batch engine: blocks of a study on many filter lanes at once.

Results are those of the streaming filter, much faster.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import msgpack

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.batch.front_end import Measured
from icreckon.estimator.batch.inputs import measured_of
from icreckon.estimator.batch.runs import Worked, side_by_side, work_through_runs
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.schedule import Steps, steps_of, why_not_steps
from icreckon.estimator.filter.samples import has_absurd_readings
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.streaming.lost import loss_kinds, reason_of
from icreckon.simulation.base.sampling import sample_times, to_stamps
from icreckon.simulation.running import streaming_engine as study_streaming
from icreckon.simulation.scenario import Scenario, errors_of
from icreckon.simulation.simulate import fix_times
from icreckon.simulation.study.cells import Cell, Filter, Plan
from icreckon.simulation.study.failures import RunScores, unscored
from icreckon.simulation.study.statistics import (
    SENSORS,
    Segments,
    TrueTicks,
    path_statistics,
    score_times,
    scored_segments,
    true_ticks,
)

# Degrees of freedom of each sensor's innovations.
DEGREES = {"gyro": 1.0, "accelerometer_x": 1.0, "accelerometer_y": 1.0, "position": 2.0}


def why_not(plan: Plan) -> str | None:
    """Reason why the batch engine cannot run a study; None if it can."""
    for cell in plan.cells:
        scenario = cell.scenario
        stamps = _stamps(scenario)
        reason = why_not_steps(*stamps)
        if reason is not None:
            return f"in cell {cell.index}, {reason}"
        encoders = errors_of(scenario, cell.robot).encoders
        if encoders.dropouts_per_hour > 0.0 and scenario.track_rate > scenario.imu_rate:
            return f"in cell {cell.index}, encoders with dropouts are faster than the IMU"
        lowest_rate = min(scenario.imu_rate, scenario.track_rate, scenario.fix_rate or np.inf)
        for settings in (spec.settings for spec in cell.filters):
            if 1.0 / lowest_rate > 0.5 * settings.longest_gap:
                return f"in cell {cell.index}, samples are further apart than half the longest_gap"
            if 1.0 / scenario.imu_rate > settings.hold:
                return f"in cell {cell.index}, samples of the IMU are further apart than hold"
    return None


def block(cell: Cell, filters: Sequence[Filter], first_run: int, count: int) -> RunScores:
    """Statistics of some runs; see `icreckon.simulation.running.engines.Block`.

    A run with absurd readings is repeated by the streaming engine, whose scores count.
    """
    scores = unscored(len(filters), count, cell.horizons)
    times = score_times(cell.scenario)
    batch_filters = [
        BatchFilter(spec.robot, find_variant(spec.variant), spec.settings) for spec in filters
    ]
    track_stamps, truth_stamps, steps, segments = _schedule(cell)
    lanes = batch_filters[0].width  # as many for each filter
    lowest_top_speed = min(spec.robot.vehicle.max_track_speed for spec in filters)
    for begin in range(0, count, lanes):
        used_lanes = min(lanes, count - begin)
        # The lanes of a group that is not full repeat its last run.
        runs = [first_run + begin + min(lane, used_lanes - 1) for lane in range(lanes)]
        logs = [study_streaming.study_log(cell, run) for run in runs]
        measured, start = _measured(logs, filters, track_stamps), np.zeros(3)
        results = work_through_runs(batch_filters, measured, steps, start=start, start_sigma=start)
        truths = zip(*map(true_ticks, logs), strict=True)
        truth = TrueTicks(*(np.stack(by_lane, axis=1) for by_lane in truths))
        group = slice(begin, begin + used_lanes)
        for place, (batch_filter, result) in enumerate(zip(batch_filters, results, strict=True)):
            path = side_by_side(truth_stamps, result)
            columns = path_statistics(path, truth, segments) + _consistency(batch_filter, result)
            scores.values[place, group] = np.stack(columns, axis=-1)[:used_lanes]
            scores.reasons[place, group] = _losses(path, times)[:used_lanes]
        for lane in range(used_lanes):
            # A run that the streaming filter rejects must not take the other lanes with it.
            if has_absurd_readings(logs[lane], lowest_top_speed):
                repeated = study_streaming.block(cell, filters, runs[lane], 1)
                scores.values[:, begin + lane] = repeated.values[:, 0]
                scores.reasons[:, begin + lane] = repeated.reasons[:, 0]
    return scores


def _stamps(scenario: Scenario) -> tuple[Stamps, Stamps, Stamps, Stamps]:
    """Stamps of track speeds, IMU, fixes and truth."""
    fixes, rates = fix_times(scenario), (scenario.track_rate, scenario.imu_rate)
    for start, end in scenario.outages:
        fixes = fixes[(fixes < start) | (fixes > end)]
    tracks, imu = (to_stamps(sample_times(scenario.duration, rate)) for rate in rates)
    return tracks, imu, to_stamps(fixes), to_stamps(score_times(scenario))


def _schedule(cell: Cell) -> tuple[Stamps, Stamps, Steps, list[Segments]]:
    """Stamps of tracks and truth, steps, and scored segments of all runs of a cell."""
    tracks, imu, fixes, truth = _stamps(cell.scenario)
    errors = errors_of(cell.scenario, cell.robot).fixes
    steps = steps_of(tracks, imu, fixes, truth, heading=errors.heading_sigma is not None)
    begin, end = min(tracks[0], imu[0]), max(tracks[-1], imu[-1])
    segments = scored_segments(truth, cell.horizons, fixes, int(begin), int(end))
    return tracks, truth, steps, segments


def _measured(logs: Sequence[Log], filters: Sequence[Filter], tracks: Stamps) -> list[Measured]:
    """Inputs of each filter; filters with the same model of the IMU share one object."""
    keys = [msgpack.encode(spec.robot.imu) for spec in filters]
    robots = {key: spec.robot for key, spec in zip(keys, filters, strict=True)}
    by_imu = {key: measured_of(logs, robot, tracks) for key, robot in robots.items()}
    return [by_imu[key] for key in keys]


def _losses(path: Trajectory, times: Floats) -> list[str]:
    """Reason why each lane failed, empty if it did not; `times` (ticks,) in seconds."""
    kinds = loss_kinds(path)
    ticks = np.argmax(kinds > 0, axis=0)  # the first loss of each lane; 0 for none
    return [
        reason_of(int(kind), float(times[tick])) if kind else ""
        for kind, tick in zip(kinds[ticks, np.arange(len(ticks))], ticks, strict=True)
    ]


@np.errstate(divide="ignore", invalid="ignore")
def _consistency(batch_filter: BatchFilter, worked: Worked) -> list[Floats]:
    """NIS (NaN if unused), rejections (width,) of each sensor, and all rejections."""
    counts = batch_filter.counts(worked.lanes)
    return [
        *(counts[f"{name}_nis"] / (DEGREES[name] * counts[f"{name}_admitted"]) for name in SENSORS),
        *(counts[f"{name}_rejected"] for name in SENSORS),
        np.sum([counts[f"{name}_rejected"] for name in (*SENSORS, "heading")], axis=0),
    ]
