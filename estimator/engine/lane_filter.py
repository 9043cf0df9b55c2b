"""Steps of one filter at one lane, compiled or in Python."""

import math
from collections.abc import Callable
from functools import cache, cached_property, partial
from typing import Any, cast

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.records import SharedRecord, array_on
from icreckon.estimator.engine.constants import aligned, shared_constants
from icreckon.estimator.engine.lane import FilterShape, PlainNumbers
from icreckon.estimator.engine.lane_functions import (
    FULL,
    IMU_STEP,
    IMU_UPDATE,
    POSITION,
    POSITION_AHEAD,
    TIME_STEP,
    add_to_scatter,
    add_track_speeds,
    evaluate_twist,
    feed_samples,
    fill_move,
    is_row_due,
    kernel_of_sample,
    take_sample,
    take_step,
    write_row,
)
from icreckon.estimator.engine.layout import INPUTS, PLACES
from icreckon.estimator.engine.one_lane import kernel_maker, one_lane
from icreckon.estimator.faults.scattering_fixes import TakenFix
from icreckon.estimator.filter.changes import Events
from icreckon.estimator.filter.ekf import Ekf
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.filter.samples import RunRows, SampleArrays, Sampled
from icreckon.estimator.log.measurements import ImuSample
from icreckon.estimator.motion.icr import IndexValues, PaperTwist
from icreckon.estimator.motion.motion_model import Motion, TwistModel
from icreckon.estimator.motion.propagation import Triple
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.standstill import QuietReadings, is_full
from icreckon.estimator.tracing.kernel import FLAG_BITS

FIX_X, FIX_Y, FIX_VARIANCE = INPUTS["fix_x"], INPUTS["fix_y"], INPUTS["fix_variance"]
ANTENNA = [INPUTS[name] for name in ("fix_forward", "fix_left", "fix_up")]
MODE, INTERVAL, SPEED_DECAY = (INPUTS[name] for name in ("fix_mode", "fix_interval", "speed_decay"))
LONG_STEP = 1_000_000_000  # the motion over a longer step is that of stale speeds [ns]
# Rows with the innovation of a position fix, and the number of admitted ones.
FIX_RESULTS = ("z_x", "z_y", "S_xx", "S_xy", "S_yy", "admitted")
NO_FORCE = (math.nan, math.nan, math.nan)


class LaneSteps:
    """Steps of one filter, which change its state and its record.

    The record is shared with compiled code, if it `compiles`; otherwise Python executes the steps.
    `readings` are the yaw-rate readings of a standstill.
    """

    def __init__(
        self,
        ekf: Ekf,
        disturbances: Disturbances,
        robot: Robot,
        settings: Settings,
        record: FilterRecord,
        readings: QuietReadings,
        *,
        compiles: bool,
    ) -> None:
        self._arguments = ekf, disturbances, robot, settings, record, readings
        self._compiles, self._ekf = compiles, ekf
        self._record, self._readings = record, readings
        lane = one_lane(ekf.model, ekf.considered, wanders=ekf.wanders, compiles=compiles)
        self._lane = lane
        compiled = lane.compiled or (lambda function: function)
        self._take_step, self._feed_samples = compiled(take_step), compiled(feed_samples)
        self._evaluate_twist, self._fill_move = compiled(evaluate_twist), compiled(fill_move)
        self._follow_scatter, self._write_row = compiled(add_to_scatter), compiled(write_row)
        rows = lane.shape.layout.rows
        self._first_report = rows["report0"]
        result_names = (*(f"position_{part}" for part in FIX_RESULTS), *PLACES)
        self._fix_rows = np.array([rows[name] for name in result_names])
        # Functions in Python take the record itself.
        is_shared = isinstance(record, SharedRecord) and lane.compiled is not None
        self._records: Any = array_on(record) if is_shared else [record]
        self._constants = shared_constants(
            lane.shape, ekf.model, disturbances, robot, settings, ekf.x[: s.SIZE]
        )
        self._workspace = aligned(len(rows)).reshape(-1, 1)
        self._inputs = aligned(len(INPUTS)).reshape(-1, 1)
        self._arrays = self._workspace, self._inputs, self._constants
        ekf.evaluation = self.evaluate

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(LaneSteps, compiles=self._compiles), self._arguments

    @cached_property
    def take_track_speeds(self) -> Callable[[int, float, float, bool], int]:
        """Function that adds track speeds, see `lane_functions.add_track_speeds`."""
        return partial(self._lane.direct(add_track_speeds), self._records)

    @cached_property
    def _take_sample(self) -> Callable[..., int]:
        return cast(Callable[..., int], self._lane.direct(take_sample))

    def take_imu(
        self, m: ImuSample, mounting: Floats, uses_force: bool, *, after_gap: bool = False
    ) -> int:
        """Add an IMU sample, and take the step that it ends, see `take_sample`."""
        readings, force = self._readings, m.linear_acceleration or NO_FORCE
        kernel_number = IMU_STEP if m.stamp > self._record.stamp else IMU_UPDATE
        yaw, result = self._ekf.x.item(s.YAW), FULL
        while result == FULL:
            filter_ = self._lane.places, kernel_number, self._records, self._all_arrays()
            buffers = readings.stamps, readings.rates
            sample = mounting, m.stamp, m.angular_velocity, force, uses_force, after_gap
            result = self._take_sample(*filter_, buffers, *sample)
            if result == FULL:
                readings.make_room()
        if result >= 0 and self._has_watchers():
            self._report(kernel_of_sample(kernel_number, self._record), yaw)
        return result

    def move(self, stamp: int, kernel_number: int = TIME_STEP) -> None:
        """Take a step without an IMU sample to a later stamp [ns].

        With `BEGIN` it only begins, with a new fast slip; with `PROPAGATE` to the same stamp it ends.
        """
        inputs, elapsed = self._inputs, stamp - self._record.stamp
        self._fill_move(self._records, inputs, stamp)
        if elapsed > LONG_STEP:
            # The speeds decay, and so do the derivatives by the parameters.
            self._ekf.regressors *= inputs[SPEED_DECAY, 0]
        self._step(kernel_number, stamp)

    def take_samples(
        self, samples: SampleArrays, mounting: Floats, rows: RunRows, *, uses_force: bool
    ) -> Sampled:
        """Take the steps of samples up to one that needs more than a step; fill rows."""
        readings, total = self._readings, np.zeros(4, int)
        while True:
            filter_ = self._lane.places, self._records, self._all_arrays()
            buffers = readings.stamps, readings.rates
            counts = self._feed_samples(*filter_, buffers, mounting, samples, uses_force, rows)
            total += counts
            samples = samples.after(*counts[:2])
            if not len(samples.imu_stamps) or not is_full(self._record.still, readings.stamps):
                return Sampled(*total.tolist())
            readings.make_room()

    def write_row(self, rows: RunRows, stamp: int) -> bool:
        """Fill the next row if it is due before a measurement at a stamp [ns]."""
        is_due = is_row_due(rows, stamp, self._record)
        if is_due:
            self._write_row(self._lane.places, self._records, self._all_arrays(), rows)
        return is_due

    def take_position(
        self,
        stamp: int,
        fix: tuple[float, float, float],
        antenna: tuple[float, float, float],
        *,
        ahead: bool,
        mode: int,
        interval: float,
        rejected_for: float,
    ) -> tuple[TakenFix, bool, bool]:
        """Update with a position fix, which is x, y [m] and the variance of each [m²].

        The antenna is forward, left and up [m] in base_link. With `ahead` the fix lies ahead of the
        estimate, before the end of the next step. `mode` is one of `icreckon.estimator.filter.gate`.
        `interval` is the time since the fix before, as the gate counts it, `rejected_for` that of
        rejected fixes [s].

        Returns:
            The fix; True if the gate admitted it; True if the filter is lost, for the caller to relocate.
        """
        inputs = self._inputs
        self._fill_move(self._records, inputs, stamp)
        inputs[[FIX_X, FIX_Y, FIX_VARIANCE], 0] = fix
        inputs[ANTENNA, 0] = antenna
        inputs[[MODE, INTERVAL], 0] = mode, interval
        flags = self._step(POSITION_AHEAD if ahead else POSITION, stamp, rejected_for)
        is_lost, is_used = bool(flags & 1), bool(flags >> FLAG_BITS & 1)
        z_x, z_y, xx, xy, yy, admitted, *places = self._workspace[self._fix_rows, 0].tolist()
        predicted, updated = (places[0], places[1], places[2]), (places[3], places[4], places[5])
        taken = TakenFix(stamp, *fix, (z_x, z_y), (xx, xy, yy), predicted, updated, is_used)
        return taken, admitted > 0.0, is_lost

    def follow_scatter(self, fix: TakenFix, correction: Floats) -> bool:
        """Add a position fix to the scatter; see `icreckon.estimator.filter.slip_factor`."""
        return cast(bool, self._follow_scatter(self._records, fix, correction))

    def evaluate(self, ekf: Ekf, left: float, right: float, slip_shares: Triple) -> TwistModel:
        """Body velocity of a filter with the same model and settings, see `Ekf`."""
        twist, jacobian, by_speeds = np.empty(3), np.empty((3, len(ekf.x))), np.empty((3, 2))
        arrays, results = (ekf.x, ekf.model.memory, *self._arrays), (twist, jacobian, by_speeds)
        left, right, *shares = map(float, (left, right, *slip_shares))
        inputs = self._lane.places, arrays, left, right, tuple(shares), results
        zeta, epsilon, eta, u, force = self._evaluate_twist(*inputs)
        v_x, v_y, w = twist.tolist()
        motion = Motion(PaperTwist(-v_y, v_x, w), IndexValues(zeta, epsilon, eta), u, force)
        return TwistModel(twist, jacobian, by_speeds, motion)

    def _all_arrays(self) -> tuple[Floats, ...]:
        """Arrays of the filter, see `take_step`."""
        ekf = self._ekf
        return (ekf.x, ekf.P, ekf.regressors, ekf.model.memory, *self._arrays)

    def _step(self, kernel_number: int, stamp: int, rejected_for: float = 0.0) -> int:
        """Take a step to a stamp [ns], or an update; see `take_step`."""
        yaw, places, arrays = self._ekf.x.item(s.YAW), self._lane.places, self._all_arrays()
        step = places, kernel_number, self._records, arrays, stamp, rejected_for
        result: int = self._take_step(*step)
        if result >= 0 and self._has_watchers():
            self._report(kernel_number, yaw)
        return result

    def _has_watchers(self) -> bool:
        """Return True if clones or the smoother follow the changes of the filter."""
        return self._ekf.clones is not None or self._ekf.observer is not None

    def _report(self, kernel_number: int, yaw: float) -> None:
        """Report the changes of the filter by a kernel, from a yaw before it [rad]."""
        values, ekf = self._workspace[self._first_report :, 0], self._ekf
        events_of(self._lane.shape, kernel_number).report(values, len(ekf.x), yaw, ekf)


@cache
def events_of(shape: FilterShape, kernel_number: int) -> Events:
    """Changes that a kernel reports; their values are those of a filter of zeros."""
    if shape.model.kind == "plain":
        # What a user's model reports does not depend on its equations.
        shape = shape._replace(model=shape.model._replace(kind="linear", memory=0))
    layout = shape.layout
    sizes = (len(layout.rows), len(INPUTS), len(layout.constants))
    rows, inputs, constants = map(np.zeros, sizes)
    make, arguments = kernel_maker(kernel_number, shape)
    with np.errstate(all="ignore"):
        kernel = make(*arguments, numbers=PlainNumbers(rows, inputs, constants))
    return Events(kernel.events)
