"""Run several filter variants over one log in one pass, with rows as in `run`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.checks import three_numbers
from icreckon.estimator.base.errors import BatchError, EstimatorError
from icreckon.estimator.base.records import record_of, shifted
from icreckon.estimator.batch.front_end import FIX_VALUES, FrontEnd, Measured
from icreckon.estimator.batch.inputs import NO_STAMPS, fix_rows, has_absurd_readings, wheels_of
from icreckon.estimator.batch.replay_rows import OUTPUT_AT_END, ReplayRows
from icreckon.estimator.engine.constants import SMOOTHING, aligned
from icreckon.estimator.engine.filters import BatchFilter, Lanes
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.engine.schedule import (
    AHEAD,
    MOVE,
    MOVE_AND_UPDATE,
    STEP_COLUMNS,
    UPDATE,
    Bytes,
    LogSteps,
    fill_step_constants,
    steps_of_log,
)
from icreckon.estimator.engine.work import ESTIMATE
from icreckon.estimator.filter.filter_record import FixesRecord
from icreckon.estimator.filter.health import add_findings
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import TrackSpeeds
from icreckon.estimator.robot.robot_file import Robot, require_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.reckoning import Reckoning

# Number of steps of a part; all filters run through a part before the next.
PART = 1024


def run_side_by_side(
    log: Log,
    robot: Robot,
    variants: Sequence[str],
    *,
    settings: Settings | None = None,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
    progress: Callable[[int], None] | None = None,
) -> dict[str, Run]:
    """Run variants over a log in one pass, from its first measurement to its last.

    Runs are those of `run`, to rounding, with two exceptions. If the robot is found standing, the
    accelerometer's innovation is NaN in that row, even if an earlier IMU sample since the row before had
    one. If the robot stands for the last `OUTPUT_AT_END` steps, the newest and recent NIS in
    `health` are those of the innovations in rows. A variant is compiled when it runs for the first time,
    which takes some seconds.

    Args:
        log: the measurements; its truth is not used.
        robot: the robot.
        variants: names of filter variants.
        settings: settings of the filters.
        start: pose at the start: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].
        progress: called from time to time with the stamp that was reached [ns].

    Returns:
        Runs by variant.

    Raises:
        EstimatorError: no such variant, a log without track speeds, or `start` is no pose.
        BatchError: filters side by side do not support a variant, the settings or the log; the message
            gives the reason, and `run` supports them.
    """
    require_robot(robot)
    start = three_numbers("start", start, "three finite numbers: x, y [m], yaw [rad]")
    of_sigma = "three finite numbers, 0 or more: the standard deviations of x, y [m], yaw [rad]"
    start_sigma = three_numbers("start_sigma", start_sigma, of_sigma, least=0.0)
    settings = settings or Settings()
    if settings.engine != "compiled":
        raise BatchError(f"filters side by side are compiled, found engine = {settings.engine!r}")
    measured, headings, has_force = measured_alone(log, robot)
    of_filters = settings
    if not has_force:
        of_filters = msgspec.structs.replace(settings, use_accelerometer=False)
    filters = [
        BatchFilter(robot, find_variant(name), of_filters, width=1, height=True)
        for name in variants
    ]
    stamps = measured.track_stamps, measured.imu_stamps, measured.fix_stamps
    steps = steps_of_log(*stamps, headings, settings, OUTPUT_AT_END)
    for one in filters:
        one.compile_for(steps)
    if not filters:
        return {}
    given = np.array(start, dtype=float), np.array(start_sigma, dtype=float)
    first = np.repeat(measured.tracks[:, 0], filters[0].width, axis=0)
    begun = [one.begin(first, *given) for one in filters]
    begin_stamp = int(measured.track_stamps[0])
    row_stamps = steps.row_stamps + begin_stamp
    rows = [ReplayRows(one, robot, steps, measured, headings, row_stamps) for one in filters]
    began = [_begin(log, robot, name, settings, start, start_sigma) for name in variants]
    for before, one, lanes in zip(began, filters, begun, strict=True):
        checkpoint, by_parameters = before.checkpoint(), before.model().jacobian[:, s.PARAMETERS]
        if checkpoint.regressors is not None and steps.kinds[:1] == UPDATE:
            raise BatchError("there are fixes before the first track speeds")
        one.continue_from(lanes, checkpoint, by_parameters, begin_stamp)
    if steps.before_steps:
        for before, of_one in zip(began, rows, strict=True):
            of_one.put_first(before.snapshot())
    smoothed = began[0].checkpoint().regressors is not None
    front = FrontEnd(measured, steps, input_settings(robot, of_filters))
    work_through_log(filters, begun, rows, steps, measured, front, progress, smoothed=smoothed)
    found: dict[str, Run] = {}
    for name, one, lanes, before in zip(variants, filters, begun, began, strict=True):
        health = before.health
        health.track_gaps = steps.gaps
        health.sensor("tracks").used = len(measured.track_stamps)
        found[name] = rows.pop(0).finish(name, one, lanes, health)
        record = front.record(0)
        record.stamp = int(steps.ends[steps.kinds != AHEAD].max(initial=0))
        # Those behind the last step are not silent.
        record.tracks.stamp = int(measured.track_stamps[-1]) - begin_stamp
        record.slip_factor = float(lanes.workspace[one.rows["slip_factor"], 0])
        record.fixes = record_of(FixesRecord, lanes.fixes[0])
        record, at_end = shifted(record, begin_stamp), one.state(lanes, 0)
        add_findings(found[name].health, record, *at_end, robot.imu)
    return found


def work_through_log(
    filters: Sequence[BatchFilter],
    begun: Sequence[Lanes],
    rows: Sequence[ReplayRows],
    steps: LogSteps,
    measured: Measured,
    front: FrontEnd,
    progress: Callable[[int], None] | None = None,
    *,
    smoothed: bool = True,
) -> None:
    """Run all filters through the steps of a log, and fill their rows.

    Args:
        filters: the filters.
        begun: their lanes, changed in place.
        rows: their rows, written to.
        steps: the steps.
        measured: measurements of the log.
        front: front end of the steps.
        progress: called after each part with the stamp that was reached [ns].
        smoothed: the filters have regressors from earlier steps.
    """
    width, begin_stamp = filters[0].width, int(measured.track_stamps[0])
    inputs = aligned(PART * len(INPUTS) * width).reshape(PART, -1, width)
    rooms = [np.zeros((PART, len(ESTIMATE) + len(one.layout.more_outputs), 1)) for one in filters]
    table = np.zeros((PART, STEP_COLUMNS))
    moving = np.flatnonzero((steps.kinds == MOVE_AND_UPDATE) | (steps.kinds == MOVE))
    first_moving = int(moving[0]) if len(moving) else -1
    for begin in range(0, len(steps.kinds), PART):
        end = min(begin + PART, len(steps.kinds))
        part = steps.part(begin, end)
        of_part, of_steps = inputs[: end - begin], table[: end - begin]
        front.fill(begin, end, of_part)
        fill_step_constants(table, part.starts, part.ends, part.intervals)
        if begin <= first_moving < end and not smoothed:
            table[first_moving - begin, SMOOTHING] = 1.0
        for one, lanes, of_one, room in zip(filters, begun, rows, rooms, strict=True):
            one.work_through(lanes, of_part, part, of_steps, room, all_outputs=True)
            of_one.add(begin, end, part, of_part[:, :, 0], room[:, :, 0])
        if progress is not None:
            progress(begin_stamp + int(part.ends[-1]))


def measured_alone(log: Log, robot: Robot) -> tuple[Measured, Bytes, bool]:
    """Measurements of one log, in the axes and units of a robot's filter.

    Returns:
        The measurements; 1 for each fix with a heading; True if the IMU has accelerometers.

    Raises:
        EstimatorError: there are no track speeds.
        BatchError: there is no IMU, or something that filters side by side do not support.
    """
    if not len(log.tracks.stamps):
        raise EstimatorError(
            f"log {log.name!r} holds no track speeds: there is nothing to reckon with"
        )
    imu, fixes = log.imu, log.fixes
    if imu is None or not len(imu.stamps):
        raise BatchError(f"the log {log.name!r} holds no IMU samples")
    if log.others:
        kinds = ", ".join(sorted({type(other).__name__ for other in log.others}))
        raise BatchError(
            f"the log {log.name!r} holds {kinds}, which filters side by side do not support"
        )
    fix_stamps = NO_STAMPS if fixes is None else fixes.stamps
    if any((np.diff(one) <= 0).any() for one in (log.tracks.stamps, imu.stamps, fix_stamps)):
        raise BatchError(f"the stamps of {log.name!r} do not rise")
    if has_absurd_readings(log, robot.vehicle.max_track_speed):
        raise BatchError(
            f"the log {log.name!r} holds readings that no such sensor gives, or IMU samples without "
            "forces among others, which filters side by side do not check"
        )
    values = np.zeros((0, FIX_VALUES)) if fixes is None else fix_rows(fixes)
    headings = np.isfinite(values[:, 2])
    values[~headings, 4] = 1.0
    if not (np.isfinite(np.delete(values, 2, axis=1)).all() and (values[:, 3:5] > 0.0).all()):
        raise BatchError(f"the log {log.name!r} holds fixes that are no numbers")
    sensors, force = SensorModels(robot), imu.linear_acceleration
    left, right = wheels_of(log.tracks)
    rates = sensors.rates(imu.angular_velocity)
    forces = np.full((len(rates), 2), np.nan) if force is None else sensors.along_ground_of(force)
    measured = Measured(
        log.tracks.stamps,
        np.ascontiguousarray(log.tracks.speeds)[None],
        np.ascontiguousarray(left)[None],
        np.ascontiguousarray(right)[None],
        imu.stamps,
        rates[None],
        forces[None],
        fix_stamps,
        values[None],
    )
    return measured, headings.astype(np.int8), force is not None


def _begin(
    log: Log,
    robot: Robot,
    variant: str,
    settings: Settings,
    start: tuple[float, float, float],
    start_sigma: tuple[float, float, float],
) -> Reckoning:
    """Streaming filter after the first track speeds and all measurements before."""
    found = Reckoning(robot, find_variant(variant), settings, start, start_sigma)
    longest_gap = int(settings.longest_gap / NANOSECOND)
    for measurement in log.measurements():
        if found.stamp is not None and measurement.stamp - found.stamp > longest_gap:
            raise BatchError("there is a stamp further ahead than Settings.longest_gap")
        found.take(measurement)
        if isinstance(measurement, TrackSpeeds):
            break
    return found
