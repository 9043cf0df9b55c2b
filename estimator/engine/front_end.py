"""What a step of the filter is told of the track speeds and the IMU, worked out ahead of the filters.

It depends on the measurements alone, so the variants that are compared share it. It does, for numba, what
`HeldTrackSpeeds` and `StandstillDetector` do for one filter.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.errors import BatchError
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.fixes import AS_USUAL
from icreckon.estimator.engine.layout import FIX_INPUTS, INPUTS
from icreckon.estimator.engine.log_steps import LogSteps
from icreckon.estimator.engine.schedule import MOVE_AND_UPDATE, POSITION, SILENT, UPDATE, Steps
from icreckon.estimator.engine.stuck import (
    STUCK_MEMORY,
    begin_repeating,
    repeating_after,
    stuck_from,
)
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.held_tracks import (
    ACCELERATION_AVERAGING,
    SMOOTHING,
    TrackMemory,
    acceleration_after,
    left_of_speed,
    mean_left_of_speed,
    smoothing_share,
    walked_density,
)
from icreckon.estimator.tracing.jit_kernel import entry

# What the front end remembers of a lane: times are since the start of the run [ns].
(
    STAMP,
    LEFT,
    RIGHT,
    INTERVAL,
    ACCELERATION_LEFT,
    ACCELERATION_RIGHT,
    SMOOTH_LEFT,
    SMOOTH_RIGHT,
    STOPPED_SINCE,
    KEPT_READINGS,
    STUCK_TRACKS,
    REPEATING_LEFT,
) = range(12)
REPEATING_RIGHT = REPEATING_LEFT + STUCK_MEMORY
MEMORY = REPEATING_RIGHT + STUCK_MEMORY
NEVER = -1.0

ROW_SMOOTH_LEFT = INPUTS["smooth_left"]
ROW_SMOOTH_RIGHT = INPUTS["smooth_right"]
ROW_LEFT, ROW_RIGHT = INPUTS["left"], INPUTS["right"]
ROW_MEAN_LEFT, ROW_MEAN_RIGHT = INPUTS["mean_left"], INPUTS["mean_right"]
ROW_LEFT_DENSITY, ROW_RIGHT_DENSITY = INPUTS["left_density"], INPUTS["right_density"]
ROW_GAP_DENSITY = INPUTS["gap_density"]
ROW_ACCELERATION_LEFT = INPUTS["acceleration_left"]
ROW_ACCELERATION_RIGHT = INPUTS["acceleration_right"]
ROW_WINDOW, ROW_SPEED_VARIANCE = INPUTS["window"], INPUTS["speed_variance"]
ROW_AGE, ROW_SLOW, ROW_QUIET_MEAN = INPUTS["age"], INPUTS["slow"], INPUTS["quiet_mean"]
ROW_RATE, ROW_FORCE = INPUTS["rate"], INPUTS["force"]
ROW_NOW_LEFT, ROW_NOW_RIGHT = INPUTS["now_left"], INPUTS["now_right"]
ROW_FIX = INPUTS[FIX_INPUTS[0]]
ROWS, FIX_VALUES = len(INPUTS), len(FIX_INPUTS) - 1


class FrontSettings(NamedTuple):
    """What the front end goes by, see `Settings` and `StandstillSettings`."""

    hold: float
    gap_acceleration: float
    fastest: float
    track_density: float
    track_speed: float
    duration: float
    quiet_gyro: float
    gyro_noise_density: float


SETTINGS = len(FrontSettings._fields)


def front_settings(robot: Robot, settings: Settings) -> FrontSettings:
    """Of a robot and the settings of a filter."""
    standstill = settings.standstill
    return FrontSettings(
        settings.hold,
        settings.gap_acceleration,
        robot.vehicle.max_track_speed,
        robot.tracks.speed_noise_density**2,
        standstill.track_speed,
        standstill.duration,
        standstill.quiet_gyro,
        robot.imu.gyro_noise_density,
    )


def take_tracks(of: Floats, stamp: float, left: float, right: float, settings: Floats) -> None:
    """A sample of the track speeds; `of` (MEMORY,) is what is remembered of the lane.

    Args:
        of: changed in place.
        stamp: since the start of the run [ns].
        left: speed of the left track [m/s].
        right: of the right.
        settings: `FrontSettings`.
    """
    hold, track_speed = settings[0], settings[4]
    share = 1.0
    if of[STAMP] != NEVER:
        interval = (stamp - of[STAMP]) * NANOSECOND
        if interval <= hold:
            of[INTERVAL] = interval
            share = smoothing_share(interval, SMOOTHING)
            of[ACCELERATION_LEFT] = acceleration_after(
                of[ACCELERATION_LEFT], interval, left, of[LEFT]
            )
            of[ACCELERATION_RIGHT] = acceleration_after(
                of[ACCELERATION_RIGHT], interval, right, of[RIGHT]
            )
        else:
            of[ACCELERATION_LEFT] = of[ACCELERATION_RIGHT] = 0.0
    of[SMOOTH_LEFT] += share * (left - of[SMOOTH_LEFT])
    of[SMOOTH_RIGHT] += share * (right - of[SMOOTH_RIGHT])
    of_left = of[REPEATING_LEFT : REPEATING_LEFT + STUCK_MEMORY]
    of_right = of[REPEATING_RIGHT : REPEATING_RIGHT + STUCK_MEMORY]
    if of[STAMP] == NEVER:
        begin_repeating(of_left, stamp, left, right)
        begin_repeating(of_right, stamp, right, left)
    else:
        for side in range(2):
            of_side = of_right if side else of_left
            reading, other = (right, left) if side else (left, right)
            was_stuck = not math.isnan(stuck_from(of_side, hold))
            repeating_after(of_side, stamp, reading, other, hold)
            is_stuck = not math.isnan(stuck_from(of_side, hold))
            of[STUCK_TRACKS] += 1.0 if is_stuck and not was_stuck else 0.0
    of[LEFT], of[RIGHT], of[STAMP] = left, right, stamp
    if max(abs(left), abs(right)) >= track_speed:
        of[STOPPED_SINCE], of[KEPT_READINGS] = NEVER, 0.0
    elif of[STOPPED_SINCE] == NEVER:
        of[STOPPED_SINCE] = stamp


def tell_step(
    inputs: Floats,
    lane: int,
    of: Floats,
    start: float,
    end: float,
    settings: Floats,
) -> None:
    """What a step is told of the tracks.

    Args:
        inputs: (rows, lanes) written to.
        lane: whose.
        of: (MEMORY,) what is remembered of it.
        start: of the step, since the start of the run [ns].
        end: of the step; at the start itself no time passes.
        settings: `FrontSettings`.
    """
    hold, gap_acceleration, fastest, track_density, track_speed = (
        settings[0],
        settings[1],
        settings[2],
        settings[3],
        settings[4],
    )
    left, right, stamp = of[LEFT], of[RIGHT], of[STAMP]
    hold_ns = float(int(hold / NANOSECOND))
    inputs[ROW_SMOOTH_LEFT, lane], inputs[ROW_SMOOTH_RIGHT, lane] = (
        of[SMOOTH_LEFT],
        of[SMOOTH_RIGHT],
    )
    share = mean = 1.0
    gap_density = 0.0
    if start - stamp > hold_ns:
        share = left_of_speed((start - stamp - hold_ns) * NANOSECOND)
    if end > start and end - stamp > hold_ns:
        dt = (end - start) * NANOSECOND
        from_age = max(0.0, start - stamp - hold_ns) * NANOSECOND
        to_age = max(0.0, end - stamp - hold_ns) * NANOSECOND
        mean = mean_left_of_speed(dt, from_age, to_age)
        gap_density = walked_density(dt, from_age, to_age, gap_acceleration, fastest)
    inputs[ROW_LEFT, lane], inputs[ROW_RIGHT, lane] = share * left, share * right
    inputs[ROW_MEAN_LEFT, lane], inputs[ROW_MEAN_RIGHT, lane] = mean * left, mean * right
    density = 0.0 if left == 0.0 and right == 0.0 else track_density
    for row, place in ((ROW_LEFT_DENSITY, REPEATING_LEFT), (ROW_RIGHT_DENSITY, REPEATING_RIGHT)):
        inputs[row, lane] = density
        since = stuck_from(of[place : place + STUCK_MEMORY], hold)
        if end > start and not math.isnan(since):
            dt = (end - start) * NANOSECOND
            from_age = max(0.0, start - since) * NANOSECOND
            to_age = max(0.0, end - since) * NANOSECOND
            more = walked_density(dt, from_age, to_age, gap_acceleration, fastest)
            inputs[row, lane] = density + more
    inputs[ROW_GAP_DENSITY, lane] = gap_density
    inputs[ROW_ACCELERATION_LEFT, lane] = of[ACCELERATION_LEFT]
    inputs[ROW_ACCELERATION_RIGHT, lane] = of[ACCELERATION_RIGHT]
    inputs[ROW_WINDOW, lane] = max(ACCELERATION_AVERAGING, of[INTERVAL])
    inputs[ROW_SPEED_VARIANCE, lane] = density / of[INTERVAL]
    inputs[ROW_AGE, lane] = min((start - stamp) * NANOSECOND + 0.5 * of[INTERVAL], hold)
    slow = max(abs(left), abs(right)) < track_speed
    inputs[ROW_SLOW, lane] = 1.0 if slow else 0.0
    share = 1.0
    if end - stamp > hold_ns:
        share = left_of_speed((end - stamp - hold_ns) * NANOSECOND)
    inputs[ROW_NOW_LEFT, lane], inputs[ROW_NOW_RIGHT, lane] = share * left, share * right


def quiet_mean(of: Floats, readings: Floats, stamp: float, rate: float, settings: Floats) -> float:
    """Mean of the gyro's readings since the tracks stopped, where they were quiet for long enough.

    Args:
        of: (MEMORY,) what is remembered of the lane.
        readings: (n, 2) room for stamps [ns] and readings [rad/s].
        stamp: of the newest, since the start of the run [ns].
        rate: the newest [rad/s].
        settings: `FrontSettings`.

    Returns:
        The mean [rad/s], NaN where the robot cannot be found standing.
    """
    if of[STOPPED_SINCE] == NEVER:
        return math.nan
    duration, quiet_gyro, density = settings[5], settings[6], settings[7]
    count = int(of[KEPT_READINGS])
    oldest_needed = stamp - float(int(duration * 1e9))
    first = 0
    while first + 1 < count and readings[first + 1, 0] <= oldest_needed:
        first += 1
    if first > 0:
        for k in range(first, count):
            readings[k - first, 0], readings[k - first, 1] = readings[k, 0], readings[k, 1]
        count -= first
    if count >= len(readings):
        raise ValueError(WRONG_SIZE)
    readings[count, 0], readings[count, 1] = stamp, rate
    count += 1
    of[KEPT_READINGS] = count
    if of[STOPPED_SINCE] > oldest_needed or readings[0, 0] > oldest_needed:
        return math.nan
    total = 0.0
    for k in range(count):
        total += readings[k, 1]
    mean = total / count
    per_second = (count - 1) * 1e9 / (readings[count - 1, 0] - readings[0, 0])
    quiet = max(quiet_gyro, 5.0 * density * math.sqrt(per_second))
    for k in range(count):
        if abs(readings[k, 1] - mean) > quiet:
            return math.nan
    return mean


class Measured(NamedTuple):
    """What some runs have measured at the same times.

    Attributes:
        track_stamps: (n,) [ns].
        tracks: (runs, n, 2) speeds of the left and the right track [m/s]; NaN where a sample is missing.
        imu_stamps: (m,) [ns].
        rates: (runs, m) as the gyros say, see `SensorModels.yaw_rate` [rad/s].
        forces: (runs, m) specific force to the left [m/s²].
        fix_stamps: (k,) [ns].
        fixes: (runs, k, 5) x, y [m], yaw [rad], variance of position [m²] and of yaw [rad²].
    """

    track_stamps: Stamps
    tracks: Floats
    imu_stamps: Stamps
    rates: Floats
    forces: Floats
    fix_stamps: Stamps
    fixes: Floats


class FrontEnd:
    """What the steps of some runs are told, a part of the run at a time.

    Args:
        measured: what was measured, of as many runs as there are lanes.
        steps: all steps.
        settings: what it goes by.

    Attributes:
        stuck_tracks: (lanes,) how often the sensor of a track was found stuck so far.

    Raises:
        BatchError: the steps are those of other stamps, or a run lacks its first track speeds.
    """

    def __init__(
        self, measured: Measured, steps: Steps | LogSteps, settings: FrontSettings
    ) -> None:
        last = steps.tracks.max(initial=0), steps.samples.max(initial=0)
        counts = measured.tracks.shape[1], measured.rates.shape[1]
        fixes = steps.fixes[(steps.extras & POSITION) > 0]
        if (
            counts != (len(measured.track_stamps), len(measured.imu_stamps))
            or last[0] > counts[0]
            or last[1] >= counts[1]
            or (len(fixes) and fixes.max() >= measured.fixes.shape[1])
        ):
            raise BatchError("the steps of a run and what was measured have other stamps")
        if not np.isfinite(measured.tracks[:, 0]).all():
            raise BatchError("a run lacks its first track speeds")
        self._measured, self._steps = measured, steps
        self._settings = np.array(settings)
        lanes = len(measured.tracks)
        # Times are since the first track speeds, which no step begins before.
        begin = measured.track_stamps[0]
        self._track_stamps = (measured.track_stamps - begin).astype(float)
        shortest = np.diff(measured.imu_stamps, append=measured.imu_stamps[-1] + 10**9).min()
        most = int(settings.duration * 1e9 / shortest) + 4
        self._memory = np.zeros((lanes, MEMORY))
        self._memory[:, STAMP] = self._memory[:, STOPPED_SINCE] = NEVER
        self._memory[:, INTERVAL] = TrackMemory().interval
        self._readings = np.zeros((lanes, most, 2))
        self._taken = 0

    @property
    def stuck_tracks(self) -> Floats:
        """See the class."""
        return self._memory[:, STUCK_TRACKS].copy()

    def tell(self, begin: int, end: int, inputs: Floats) -> None:
        """Write down what the steps from `begin` to before `end` are told.

        Args:
            begin: the first step; each call goes on where the last one ended.
            end: one after the last.
            inputs: (end - begin, rows, lanes) written to; lanes beyond those of the runs are told what
                the last of them is.
        """
        steps, measured = self._steps.part(begin, end), self._measured
        tell_steps_entry(
            inputs,
            self._memory,
            self._readings,
            self._settings,
            self._taken,
            self._track_stamps,
            measured.tracks,
            measured.rates,
            measured.forces,
            measured.fixes,
            steps.starts.astype(float),
            steps.ends.astype(float),
            steps.kinds,
            steps.extras,
            steps.tracks,
            steps.samples,
            steps.fixes,
            steps.known,
        )
        if end > begin:
            self._taken = int(steps.tracks[-1])


def tell_steps(
    inputs: Floats,
    memory: Floats,
    readings: Floats,
    settings: Floats,
    taken: int,
    track_stamps: Floats,
    tracks: Floats,
    rates: Floats,
    forces: Floats,
    fixes: Floats,
    starts: Floats,
    ends: Floats,
    kinds: Any,
    extras: Any,
    counts: Any,
    samples: Any,
    fix_numbers: Any,
    known: Any,
) -> None:
    """See `FrontEnd.tell`."""
    lanes, n = len(memory), len(starts)
    sizes_fit = len(inputs) >= n and inputs.shape[1] == ROWS and inputs.shape[2] >= lanes > 0
    sizes_fit &= memory.shape[1] == MEMORY and len(settings) == SETTINGS
    sizes_fit &= readings.shape[0] == lanes and readings.shape[2] == 2
    sizes_fit &= tracks.shape == (lanes, len(track_stamps), 2) and 0 <= taken <= len(track_stamps)
    sizes_fit &= len(rates) == lanes and rates.shape == forces.shape
    sizes_fit &= fixes.shape[0] == lanes and fixes.shape[2] == FIX_VALUES
    sizes_fit &= n == len(ends) == len(kinds) == len(extras) == len(counts) == len(samples)
    if not (sizes_fit and n == len(fix_numbers) == len(known)):
        raise ValueError(WRONG_SIZE)
    for k in range(n):
        # Counts are ends of ranges, samples and fixes are places.
        inside = 0 <= counts[k] <= known[k] <= len(track_stamps)
        inside &= 0 <= samples[k] < max(1, rates.shape[1])
        if extras[k] & POSITION:
            inside &= 0 <= fix_numbers[k] < fixes.shape[1]
        if not inside:
            raise ValueError(WRONG_SIZE)
    for lane in range(len(memory)):
        of, count = memory[lane], taken
        for k in range(len(starts)):
            while count < counts[k]:
                left, right = tracks[lane, count, 0], tracks[lane, count, 1]
                if left == left:
                    take_tracks(of, track_stamps[count], left, right, settings)
                count += 1
            tell_step(inputs[k], lane, of, starts[k], ends[k], settings)
            if extras[k] & SILENT:
                inputs[k, ROW_SLOW, lane] = 0.0
            if known[k] > counts[k]:
                inputs[k, ROW_NOW_LEFT, lane] = tracks[lane, known[k] - 1, 0]
                inputs[k, ROW_NOW_RIGHT, lane] = tracks[lane, known[k] - 1, 1]
            if kinds[k] == MOVE_AND_UPDATE or kinds[k] == UPDATE:
                rate = rates[lane, samples[k]]
                inputs[k, ROW_RATE, lane] = rate
                inputs[k, ROW_FORCE, lane] = forces[lane, samples[k]]
                mean = quiet_mean(of, readings[lane], ends[k], rate, settings)
                inputs[k, ROW_QUIET_MEAN, lane] = mean
            if extras[k] & POSITION:
                for part in range(FIX_VALUES):
                    inputs[k, ROW_FIX + part, lane] = fixes[lane, fix_numbers[k], part]
                inputs[k, ROW_FIX + FIX_VALUES, lane] = AS_USUAL
    for lane in range(len(memory), inputs.shape[2]):
        for k in range(len(starts)):
            inputs[k, :, lane] = inputs[k, :, len(memory) - 1]


tell_steps_entry = entry(tell_steps)
