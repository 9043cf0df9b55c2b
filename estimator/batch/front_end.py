"""Inputs of steps, from the track speeds and IMU samples of several lanes.

Inputs depend on the measurements alone, so all variants use the same. Each is computed by the functions
of `icreckon.estimator.sensors` that the streaming filter calls; here is the loop over steps and lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Indexes, Stamps
from icreckon.estimator.base.errors import WRONG_SIZE, BatchError
from icreckon.estimator.base.records import record_array
from icreckon.estimator.engine.lane_functions import move_inputs, sample_inputs
from icreckon.estimator.engine.layout import FIX_INPUTS, INPUTS
from icreckon.estimator.engine.schedule import HEADING, MOVE_AND_UPDATE, POSITION, UPDATE, Steps
from icreckon.estimator.faults.repeating_fixes import PlaceRecord, repeats
from icreckon.estimator.filter.filter_record import FilterRecord, sides_of, take_track_sample
from icreckon.estimator.filter.gate import GATED, LONGEST_COUNTED, SKIPPED
from icreckon.estimator.sensors.held_tracks import speeds_at
from icreckon.estimator.sensors.input_settings import InputSettings
from icreckon.estimator.tracing.jit_kernel import entry

ROW_NOW_LEFT, ROW_NOW_RIGHT = INPUTS["now_left"], INPUTS["now_right"]
ROW_FIX, ROW_INTERVAL = INPUTS[FIX_INPUTS[0]], INPUTS["fix_interval"]
ROW_HEADING_INTERVAL = INPUTS["heading_interval"]
ROWS, FIX_VALUES = len(INPUTS), len(FIX_INPUTS) - 3
YAW_OF_FIX = 2


class Measured(NamedTuple):
    """Measurements of some runs at the same stamps.

    Attributes:
        track_stamps: (n,) [ns].
        tracks: (runs, n, 2) speeds of the left and the right track [m/s]; NaN if a sample is missing.
        left_wheels: (runs, n, k) speeds of the left wheels [m/s]; k is 0 if they are not known.
        right_wheels: (runs, n, m) speeds of the right wheels [m/s].
        imu_stamps: (m,) [ns].
        rates: (runs, m, 4) rates by the gyros, see `SensorModels.rates` [rad/s].
        forces: (runs, m, 2) specific force forward and to the left [m/s²]; NaN without accelerometers.
        fix_stamps: (k,) [ns].
        fixes: (runs, k, 7) x, y [m], yaw [rad], variance of position [m²] and of yaw [rad²], place of
            the antenna in base_link [m].
    """

    track_stamps: Stamps
    tracks: Floats
    left_wheels: Floats
    right_wheels: Floats
    imu_stamps: Stamps
    rates: Floats
    forces: Floats
    fix_stamps: Stamps
    fixes: Floats

    def first_speeds(self, settings: InputSettings) -> Floats:
        """First track speeds (runs, 2), by the wheels [m/s]."""
        start = FilterRecord(settings)
        first = zip(self.tracks[:, 0], self.left_wheels[:, 0], self.right_wheels[:, 0], strict=True)
        return np.array([sides_of(start, 0, *speeds, False) for speeds in first])

    def of_runs(self, runs: Sequence[int]) -> Measured:
        """Measurements of some of the runs."""
        # All arrays but the stamps have an axis for runs first.
        arrays = {name: array for name, array in self._asdict().items() if "stamps" not in name}
        return self._replace(**{name: array[runs] for name, array in arrays.items()})


class LaneRecords(NamedTuple):
    """Records of all lanes, see `icreckon.estimator.base.records`."""

    records: Any  # (lanes,) `FilterRecord` of each, of which the inputs are used
    quiet_stamps: Stamps  # (lanes, n) buffers of the stamps of yaw-rate readings [ns]
    quiet_rates: Floats  # (lanes, n) buffers of the readings [rad/s]
    fixes: Indexes  # (lanes,) number of fixes so far
    # (lanes,) index of the newest fix that does not repeat a position; -1 for none
    judged: Indexes


class FrontEnd:
    """Inputs of the steps of some runs, one in each lane, a part of the run at a time.

    Raises:
        BatchError: the steps are those of other stamps, or a run lacks its first track speeds.
    """

    def __init__(self, measured: Measured, steps: Steps, settings: InputSettings) -> None:
        tracks, samples = measured.tracks.shape[1], measured.rates.shape[1]
        fixes = steps.fixes[(steps.extras & POSITION) > 0]
        is_other = (tracks, samples) != (len(measured.track_stamps), len(measured.imu_stamps))
        # Counts of track speeds are ends of ranges, samples and fixes are indices.
        is_other |= steps.tracks.max(initial=0) > tracks or steps.samples.max(initial=0) >= samples
        if is_other or fixes.max(initial=-1) >= measured.fixes.shape[1]:
            raise BatchError("the steps of a run and its measurements have other stamps")
        if not np.isfinite(measured.tracks[:, 0]).all():
            raise BatchError("a run lacks its first track speeds")
        # Steps count their stamps from the first track speeds.
        begin = measured.track_stamps[0]
        self._steps = steps
        self._measured = measured._replace(
            track_stamps=measured.track_stamps - begin, fix_stamps=measured.fix_stamps - begin
        )
        lanes, imu = len(measured.tracks), measured.imu_stamps
        oldest = np.searchsorted(imu, imu - settings.duration_ns)
        # Twice as many as count at most, so that the buffers rarely have to be moved.
        room = 2 * (int((np.arange(len(imu)) - oldest).max(initial=0)) + 3)
        start = FilterRecord(settings)
        early = imu[imu < begin]
        if len(early):
            start.imu.stamp = int(early[-1] - begin)
        self._lanes = LaneRecords(
            records=record_array(start, lanes),
            quiet_stamps=np.zeros((lanes, room), np.int64),
            quiet_rates=np.zeros((lanes, room)),
            fixes=np.zeros(lanes, np.int64),
            judged=np.full(lanes, -1),
        )
        self._added = 0  # number of track speeds in the records

    def fill(self, begin: int, end: int, inputs: Floats) -> None:
        """Compute the inputs of steps, from where the last call ended to before `end`.

        `inputs` (end - begin, rows, lanes) is filled; lanes beyond those of the runs repeat the last.
        """
        steps = self._steps.part(begin, end)
        fill_entry(inputs, self._lanes, self._measured, steps, self._added)
        if end > begin:
            self._added = int(steps.tracks[-1])


def fill_inputs(
    inputs: Floats, lanes: LaneRecords, measured: Measured, steps: Steps, added: int
) -> None:
    """Fill the inputs (n, rows, lanes) of steps; change the records of the lanes.

    Stamps of track speeds and fixes are since the first track speeds, of which `added` are in the
    records already. `ValueError` if an array has the wrong size.
    """
    check_sizes(inputs, lanes, measured, steps, added)
    count = len(lanes.records)
    for lane in range(count):
        fill_lane(inputs, lane, lanes, measured, steps, added)
    for lane in range(count, inputs.shape[2]):
        for k in range(len(steps.starts)):
            for row in range(inputs.shape[1]):
                inputs[k, row, lane] = inputs[k, row, count - 1]


def fill_lane(
    inputs: Floats, lane: int, lanes: LaneRecords, measured: Measured, steps: Steps, added: int
) -> None:
    """Compute the inputs of one lane; see `fill_inputs`."""
    record = lanes.records[lane]
    stamps, rates = lanes.quiet_stamps[lane], lanes.quiet_rates[lane]
    for k in range(len(steps.starts)):
        record.stamp = steps.starts[k]
        while added < steps.tracks[k]:
            speeds, stamp = measured.tracks[lane, added], measured.track_stamps[added]
            if np.isfinite(speeds[0]):
                wheels = (measured.left_wheels[lane, added], measured.right_wheels[lane, added])
                take_track_sample(record, stamp, speeds, *wheels)
            added += 1
        step_inputs, end, sample = inputs[k], steps.ends[k], steps.samples[k]
        if steps.kinds[k] == MOVE_AND_UPDATE or steps.kinds[k] == UPDATE:
            force = measured.forces[lane, sample]
            reading = (end, measured.rates[lane, sample], force[0], force[1], True)
            sample_inputs(record, stamps, rates, step_inputs, lane, *reading)
        else:
            move_inputs(record, step_inputs, lane, end)
        left, right = speeds_at(record.tracks, end, record.settings.hold_ns)
        step_inputs[ROW_NOW_LEFT, lane], step_inputs[ROW_NOW_RIGHT, lane] = left, right
        if steps.extras[k] & POSITION:
            has_heading = (steps.extras[k] & HEADING) > 0
            speed = 0.5 * (left + right)
            fill_fix(step_inputs, lane, lanes, measured, steps.fixes[k], speed, has_heading)


def fill_fix(
    step_inputs: Floats,
    lane: int,
    lanes: LaneRecords,
    measured: Measured,
    fix: int,
    speed: float,
    has_heading: bool,
) -> None:
    """Compute the inputs of the fix of one lane, at a speed of the robot [m/s]."""
    for k in range(FIX_VALUES):
        step_inputs[ROW_FIX + k, lane] = measured.fixes[lane, fix, k]
    is_new = add_fixes(lanes.records[lane].positions, lane, lanes, measured, fix, speed)
    step_inputs[ROW_FIX + FIX_VALUES, lane] = GATED if is_new else SKIPPED
    interval = counted_interval(measured.fix_stamps, fix, lanes.judged[lane])
    step_inputs[ROW_INTERVAL, lane] = interval
    if is_new:
        lanes.judged[lane] = fix
    if has_heading:
        headed = fix - 1  # the newest fix before with a heading
        while headed >= 0 and not np.isfinite(measured.fixes[lane, headed, YAW_OF_FIX]):
            headed -= 1
        interval = counted_interval(measured.fix_stamps, fix, headed)
        step_inputs[ROW_HEADING_INTERVAL, lane] = interval


def add_fixes(
    place: PlaceRecord, lane: int, lanes: LaneRecords, measured: Measured, fix: int, speed: float
) -> bool:
    """Add fixes up to an index, at a speed [m/s]; False if it repeats a position."""
    is_repeated = False
    while lanes.fixes[lane] <= fix:
        k = lanes.fixes[lane]
        x, y = measured.fixes[lane, k, 0], measured.fixes[lane, k, 1]
        # Fixes before it came before the first track speeds, so they have no speed.
        is_repeated = repeats(place, measured.fix_stamps[k], x, y, speed if k == fix else 0.0)
        if k < fix:
            lanes.judged[lane] = k
        lanes.fixes[lane] = k + 1
    return not is_repeated


def counted_interval(stamps: Stamps, fix: int, before: int) -> float:
    """Time between two fixes, as far as gates count it [s]; 0 without one before."""
    if before < 0:
        return 0.0
    return min(LONGEST_COUNTED, float(stamps[fix] - stamps[before]) * NANOSECOND)


def check_sizes(
    inputs: Floats, lanes: LaneRecords, measured: Measured, steps: Steps, added: int
) -> None:
    """Raise ValueError if sizes differ: compiled code does not check its indices."""
    count, n, tracks = len(lanes.records), len(steps.starts), len(measured.track_stamps)
    sizes_fit = len(inputs) >= n and inputs.shape[1] == ROWS and inputs.shape[2] >= count > 0
    sizes_fit &= len(lanes.quiet_stamps) == len(lanes.fixes) == len(lanes.judged) == count
    sizes_fit &= lanes.quiet_stamps.shape == lanes.quiet_rates.shape
    sizes_fit &= measured.tracks.shape == (count, tracks, 2) and 0 <= added <= tracks
    for wheels in (measured.left_wheels, measured.right_wheels):
        sizes_fit &= wheels.shape[:2] == (count, tracks)
    sizes_fit &= len(measured.rates) == count == len(measured.forces)
    sizes_fit &= measured.forces.shape[1:] == (measured.rates.shape[1], 2)
    sizes_fit &= measured.rates.shape[2] == 4
    sizes_fit &= measured.fixes.shape[0] == count and measured.fixes.shape[2] == FIX_VALUES
    sizes_fit &= measured.fixes.shape[1] == len(measured.fix_stamps)
    sizes_fit &= n == len(steps.ends) == len(steps.kinds) == len(steps.extras) == len(steps.tracks)
    if not (sizes_fit and n == len(steps.samples) == len(steps.fixes)):
        raise ValueError(WRONG_SIZE)
    for k in range(n):
        # Counts are ends of ranges, samples and fixes are indices.
        inside = 0 <= steps.tracks[k] <= tracks
        inside &= 0 <= steps.samples[k] < max(1, measured.rates.shape[1])
        if steps.extras[k] & POSITION:
            inside &= 0 <= steps.fixes[k] < measured.fixes.shape[1]
        if not inside:
            raise ValueError(WRONG_SIZE)


fill_entry = entry(fill_inputs)
