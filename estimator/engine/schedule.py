"""Schedule of the steps of filters side by side, from the stamps of measurements.

`walk_stamps` makes the steps that `streaming.reckoning` takes with each measurement, and finds the fixes
that wait for the IMU. Of a log it also finds the estimates that `streaming.run` writes as rows.
`fill_table` computes the constants of each step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.errors import WRONG_SIZE, BatchError
from icreckon.estimator.base.records import NEVER, record_array
from icreckon.estimator.engine.constants import PER_STEP, step_constants
from icreckon.estimator.robot.settings import LONGEST_TIME, Settings
from icreckon.estimator.sensors.held_tracks import (
    USUAL_TRACK_INTERVAL,
    is_hole,
)
from icreckon.estimator.sensors.imu_clock import (
    LEAST_WAIT,
    ClockRecord,
    interval_start,
    is_alive,
    is_due_after,
    take_stamp,
)
from icreckon.estimator.tracing.jit_kernel import entry

Bytes = NDArray[np.int8]
Places = NDArray[np.int32]

# Kinds of steps: propagation up to an IMU sample, an IMU sample alone, propagation alone, and a fix
# alone, ahead of the next step.
MOVE_AND_UPDATE, UPDATE, MOVE, AHEAD = range(4)
# Bits of a step: a fix at its end or ahead of it; the fix has a heading; and a tick.
POSITION, HEADING, TICK = 1, 2, 4
# After the last measurement.
END = 2**62
# Reasons why a walk through the stamps of a log ends early, by number.
REASONS = (
    "",
    "there is an IMU sample at a stamp that the filter has reached without it",
    "there is a stamp further ahead than Settings.longest_gap",
)


# Columns of a table of constants, with the interval of the IMU last.
STEP_COLUMNS = PER_STEP + 1


class Steps(NamedTuple):
    """Steps of a run, in columns.

    Attributes:
        starts: (n,) stamps of their starts, since the first stamp [ns].
        ends: (n,) stamps of their ends [ns]; for a fix ahead, the stamp of the fix.
        kinds: (n,) kinds.
        intervals: (n,) time between the newest two IMU samples [s].
        extras: (n,) bits, see `POSITION` and the others.
        tracks: (n,) number of track-speed samples before the end of the step.
        samples: (n,) index of the IMU sample at the end.
        fixes: (n,) index of the fix at the end.
        ticks: (n,) index of the tick at the end.
        output_tracks: (n,) number of track-speed samples before the output of the estimate.
    """

    starts: Stamps
    ends: Stamps
    kinds: Stamps
    intervals: NDArray[Any]
    extras: Stamps
    tracks: Stamps
    samples: Stamps
    fixes: Stamps
    ticks: Stamps
    output_tracks: Stamps

    def part(self, begin: int, end: int) -> Steps:
        """Steps from `begin` to before `end`."""
        return Steps(*(column[begin:end] for column in self))


class LogSteps(NamedTuple):
    """Steps and rows of a log, in columns; stamps since the first track speeds [ns].

    Attributes:
        starts: (n,) see `Steps`, as are those up to `output_tracks`.
        ends: (n,).
        kinds: (n,).
        intervals: (n,).
        extras: (n,).
        tracks: (n,).
        samples: (n,).
        fixes: (n,).
        rows: (n,) index of the row that is the estimate at the end of the step; -1 for none.
        output_tracks: (n,).
        row_stamps: (k,) stamps of the estimates that are rows [ns].
        row_samples: (k,) 1 if there was an IMU sample since the row before.
        row_fixes: (k,) index of the newest fix since the row before; -1 for none.
        gaps: number of gaps in the track speeds.
    """

    starts: Stamps
    ends: Stamps
    kinds: Bytes
    intervals: Floats
    extras: Bytes
    tracks: Places
    samples: Places
    fixes: Places
    rows: Places
    output_tracks: Places
    row_stamps: Stamps
    row_samples: Bytes
    row_fixes: Places
    gaps: int

    @property
    def before_steps(self) -> bool:
        """True if the first row is the estimate before any step."""
        return bool(len(self.row_stamps)) and not (self.rows == 0).any()

    def part(self, begin: int, end: int) -> Steps:
        """Steps from `begin` to before `end`, with the ticks numbered from 0."""

        def long(column: NDArray[Any]) -> Stamps:
            return np.asarray(column[begin:end].astype(np.int64))

        extras = long(self.extras)
        return Steps(
            self.starts[begin:end],
            self.ends[begin:end],
            long(self.kinds),
            self.intervals[begin:end],
            extras,
            long(self.tracks),
            long(self.samples),
            long(self.fixes),
            np.maximum(np.cumsum((extras & TICK) > 0) - 1, 0),
            long(self.output_tracks),
        )


def why_not_steps(tracks: Stamps, imu: Stamps, fixes: Stamps, ticks: Stamps) -> str | None:
    """Reason against filters side by side over these stamps [ns], or None."""
    if len(tracks) == 0 or len(imu) == 0:
        return "there are no track speeds, or no IMU samples"
    if tracks[0] != imu[0]:
        return "the first track speeds and the first IMU sample are not at the same time"
    if not np.isin(ticks, imu).all():
        return "the truth's stamps are not all at those of IMU samples"
    if len(fixes) and (fixes[0] < imu[0] or fixes[-1] > imu[-1]):
        return "there are fixes before the first IMU sample or after the last"
    early = fixes[(fixes > imu[0]) & (fixes < imu[min(1, len(imu) - 1)])]
    if len(early) and (early[-1] - imu[0]) * NANOSECOND > LEAST_WAIT:
        return "there are fixes before the second IMU sample, too early to wait for it"
    return None


def steps_of(tracks: Stamps, imu: Stamps, fixes: Stamps, ticks: Stamps, *, heading: bool) -> Steps:
    """Make the steps of runs with the same stamps, up to the last IMU sample.

    Gaps in the track speeds of a run are not bridged, since other runs have none there: the IMU must be
    fast enough that filters never wait for it.

    Args:
        tracks: (n,) stamps of the track speeds, ascending [ns].
        imu: stamps of the IMU [ns].
        fixes: stamps of the fixes [ns].
        ticks: stamps of the estimates to output [ns].
        heading: True if fixes have a heading.

    Raises:
        BatchError: filters cannot run side by side with such stamps.
    """
    reason = why_not_steps(tracks, imu, fixes, ticks)
    if reason is not None:
        raise BatchError(f"filters cannot run side by side over these runs: {reason}")
    headings = np.full(len(fixes), heading, dtype=np.int8)
    begin, until_end = int(imu[0]), tracks[tracks <= imu[-1]]
    found = _walked(SensorStamps(until_end, imu, fixes, headings), WalkLimits(LONGEST_TIME, END))
    steps, absolute = found.part(0, len(found.kinds)), found.ends + begin
    is_tick = np.isin(absolute, ticks) & (steps.kinds <= UPDATE)
    return steps._replace(
        extras=(steps.extras & ~TICK) | np.where(is_tick, TICK, 0),
        ticks=np.searchsorted(ticks, absolute),
        output_tracks=steps.tracks,
    )


def steps_of_log(
    tracks: Stamps, imu: Stamps, fixes: Stamps, headings: Bytes, settings: Settings, output: int
) -> LogSteps:
    """Make the steps of a log from its first track speeds on.

    Args:
        tracks: stamps of the track speeds, at least one [ns].
        imu: stamps of the IMU [ns].
        fixes: stamps of the fixes [ns].
        headings: 1 for each fix with a heading.
        settings: settings of the filters.
        output: number of steps at the end whose estimates are output, rows or not.

    Raises:
        BatchError: filters side by side cannot process such stamps.
    """
    limits = WalkLimits(float(settings.hold), int(settings.longest_gap / NANOSECOND))
    steps = _walked(SensorStamps(tracks, imu, fixes, headings), limits)
    at_end = slice(max(0, len(steps.kinds) - output), None)
    steps.extras[at_end] |= np.where(steps.kinds[at_end] <= UPDATE, TICK, 0).astype(np.int8)
    return steps


class SensorStamps(NamedTuple):
    """Stamps of all measurements of a log [ns].

    Attributes:
        tracks: (n,) of the track speeds.
        imu: (m,) of the IMU.
        fixes: (k,) of the fixes.
        headings: (k,) 1 for each fix with a heading.
    """

    tracks: Stamps
    imu: Stamps
    fixes: Stamps
    headings: Bytes


class WalkLimits(NamedTuple):
    """Limits of times between stamps.

    Attributes:
        hold: see `Settings` [s].
        longest_gap: see `Settings` [ns].
    """

    hold: float
    longest_gap: int


class Walk(msgspec.Struct):
    """State of a walk through the stamps, see `icreckon.estimator.base.records`.

    Attributes:
        now: stamp that the filter has reached [ns].
        newest: stamp of the newest measurement [ns].
        written: stamp of the newest row [ns].
        due: 1 if a row is due as soon as a later measurement comes.
        steps: number of steps so far.
        rows: number of rows so far.
        tracks: number of track-speed samples so far.
        samples: number of IMU samples so far.
        fixes: number of fixes so far.
        last_step: index of the newest step that is not a fix alone; -1 for none.
        last_sample: index of the newest step with an IMU sample since the last row; -1 for none.
        newest_fix: index of the newest fix since the last row; -1 for none.
        gaps: number of gaps in the track speeds.
        reason: number of the one of `REASONS` that ended the walk.
    """

    now: int = 0
    newest: int = NEVER
    written: int = NEVER
    due: int = 0
    steps: int = 0
    rows: int = 0
    tracks: int = 0
    samples: int = 0
    fixes: int = 0
    last_step: int = -1
    last_sample: int = -1
    newest_fix: int = -1
    gaps: int = 0
    reason: int = 0


def _walked(
    stamps: SensorStamps,
    limits: WalkLimits,
    start: Walk | None = None,
    clocks_at_start: tuple[ClockRecord, ClockRecord] | None = None,
) -> LogSteps:
    """Walk through stamps [ns] from a state, or from the first track speeds."""
    tracks, imu, fixes, headings = stamps
    begin = int(tracks[0])
    most = 2 * (len(tracks) + len(imu)) + len(fixes)
    of_steps = (np.int64, np.int64, np.int8, np.float64, np.int8, *(np.int32,) * 5)
    columns: list[Any] = [np.empty(most, kind) for kind in of_steps]
    columns += [np.empty(len(tracks), kind) for kind in (np.int64, np.int8, np.int32)]
    state = record_array(start or Walk(), 1)
    usual = ClockRecord(interval=USUAL_TRACK_INTERVAL), ClockRecord()
    clocks = np.concatenate([record_array(one, 1) for one in clocks_at_start or usual])
    since = SensorStamps(tracks - begin, imu - begin, fixes - begin, headings)
    empty: list[Any] = [*columns, 0]
    walk_entry(state, clocks, since, limits, LogSteps(*empty))
    walk = state[0]
    if walk["reason"]:
        raise BatchError(REASONS[walk["reason"]])
    counts = [walk["steps"]] * len(of_steps) + [walk["rows"]] * 3
    filled: list[Any] = [column[:count] for column, count in zip(columns, counts, strict=True)]
    filled.append(int(walk["gaps"]))
    return LogSteps(*filled)


def walk_stamps(
    state: Any,
    clocks: Any,
    stamps: SensorStamps,
    limits: WalkLimits,
    steps: LogSteps,
) -> None:
    """Walk through the stamps of a log.

    Args:
        state: (1,) state of the walk, changed in place; its reason is set if the walk ends early.
        clocks: (2,) clocks of the track speeds and of the IMU.
        stamps: stamps since the first track speeds.
        limits: limits of times between them.
        steps: written to; with room for two steps for each sample and one for each fix, and for a row
            for each sample of the track speeds.

    Raises:
        ValueError: an array has the wrong size.
    """
    most = 2 * (len(stamps.tracks) + len(stamps.imu)) + len(stamps.fixes)
    sizes_fit = len(state) == 1 and len(clocks) == 2 and len(stamps.headings) == len(stamps.fixes)
    sizes_fit &= min(len(steps.starts), len(steps.ends), len(steps.intervals)) >= most
    sizes_fit &= min(len(steps.kinds), len(steps.extras), len(steps.tracks)) >= most
    sizes_fit &= min(len(steps.samples), len(steps.fixes)) >= most
    sizes_fit &= min(len(steps.rows), len(steps.output_tracks)) >= most
    sizes_fit &= min(len(steps.row_stamps), len(steps.row_samples)) >= len(stamps.tracks)
    if not sizes_fit or len(steps.row_fixes) < len(stamps.tracks):
        raise ValueError(WRONG_SIZE)
    walk, tracks, imu = state[0], clocks[0], clocks[1]
    while True:
        track = stamps.tracks[walk.tracks] if walk.tracks < len(stamps.tracks) else END
        sample = stamps.imu[walk.samples] if walk.samples < len(stamps.imu) else END
        fix = stamps.fixes[walk.fixes] if walk.fixes < len(stamps.fixes) else END
        stamp = min(track, sample, fix)
        if walk.due and walk.now != walk.written and stamp > walk.newest:
            add_row(walk, steps)
        if stamp == END:
            return
        walk.newest = stamp
        if walk.tracks > 0 and stamp - walk.now > limits.longest_gap:
            walk.reason = 2
            return
        if stamp == track:
            walk_to_tracks(walk, tracks, imu, stamp, limits.hold, steps)
        elif stamp == sample:
            walk_to_sample(walk, imu, stamp, limits.hold, steps)
        else:
            bits = POSITION | (HEADING if stamps.headings[walk.fixes] else 0)
            walk_to_fix(walk, imu, stamp, bits, steps)
        if walk.reason:
            return


def walk_to_tracks(
    walk: Walk, tracks: ClockRecord, imu: ClockRecord, stamp: int, hold: float, steps: LogSteps
) -> None:
    """Add track speeds: old ones hold up to their stamp, or up to the new interval."""
    begun = walk.tracks > 0
    if begun and is_hole(tracks, stamp, hold):
        move(walk, imu, interval_start(tracks, stamp), steps)
        walk.gaps += 1
    elif begun and not is_due_after(imu, tracks.stamp):
        move(walk, imu, tracks.stamp, steps)
    take_stamp(tracks, stamp, hold)
    walk.tracks += 1
    walk.due = 1
    if not is_alive(imu, stamp, hold):
        move(walk, imu, stamp, steps)


def walk_to_sample(walk: Walk, imu: ClockRecord, stamp: int, hold: float, steps: LogSteps) -> None:
    """Add an IMU sample: it ends a step, and does not measure a gap before it."""
    number = walk.samples
    walk.samples += 1
    if walk.tracks == 0:
        imu.stamp = stamp
        return
    take_stamp(imu, stamp, hold)
    if (stamp - walk.now) * NANOSECOND > hold:
        move(walk, imu, interval_start(imu, stamp), steps)
    if stamp <= walk.now and walk.steps > 0:
        walk.reason = 1
        return
    step = add_step(walk, imu, stamp, MOVE_AND_UPDATE if stamp > walk.now else UPDATE, steps)
    steps.samples[step] = number
    walk.last_step, walk.last_sample, walk.now = step, step, stamp


def walk_to_fix(walk: Walk, imu: ClockRecord, stamp: int, bits: int, steps: LogSteps) -> None:
    """Add a fix: at the end of a step, or before the end of a step under way."""
    number = walk.fixes
    walk.fixes += 1
    if walk.tracks == 0:
        return
    # Before the first step, no step ends at the stamp of the fix.
    waits = walk.steps == 0 if stamp == walk.now else stamp > walk.now and is_due_after(imu, stamp)
    if not waits:
        move(walk, imu, stamp, steps)
    walk.newest_fix = number
    # Innovations of fixes are output in any case, of a fix ahead with the step before.
    for k in range(max(walk.last_step, 0), walk.steps):
        steps.extras[k] |= TICK
    step = add_step(walk, imu, stamp, AHEAD, steps) if waits else walk.steps - 1
    steps.extras[step] |= bits | TICK
    steps.fixes[step] = number


def move(walk: Walk, imu: ClockRecord, to: int, steps: LogSteps) -> None:
    """Add a step of propagation to a stamp [ns], unless the filter is there already."""
    if to > walk.now:
        walk.last_step = add_step(walk, imu, to, MOVE, steps)
        walk.now = to


def add_step(walk: Walk, imu: ClockRecord, end: int, kind: int, steps: LogSteps) -> int:
    """Add a step from the present stamp to another [ns]; return its index."""
    step = walk.steps
    steps.starts[step], steps.ends[step], steps.kinds[step] = walk.now, end, kind
    steps.intervals[step], steps.extras[step] = imu.interval, 0
    steps.tracks[step] = steps.output_tracks[step] = walk.tracks
    steps.samples[step], steps.fixes[step], steps.rows[step] = 0, 0, -1
    walk.steps = step + 1
    return step


def add_row(walk: Walk, steps: LogSteps) -> None:
    """Make the present estimate the next row."""
    row = walk.rows
    if walk.last_sample >= 0:
        steps.extras[walk.last_sample] |= TICK
    for k in range(max(walk.last_step, 0), walk.steps):
        steps.extras[k] |= TICK
        steps.rows[k], steps.output_tracks[k] = row, walk.tracks
    steps.row_stamps[row], steps.row_fixes[row] = walk.now, walk.newest_fix
    steps.row_samples[row] = walk.last_sample >= 0
    walk.rows, walk.written, walk.due = row + 1, walk.now, 0
    walk.last_sample = walk.newest_fix = -1


walk_entry = entry(walk_stamps)


# --- constants of steps ------------------------------------------------------------------------------


def fill_table(table: Floats, starts: Stamps, ends: Stamps, intervals: Floats) -> None:
    """Fill the constants of each step, the interval of the IMU last.

    Args:
        table: (n, k) written to.
        starts: stamps of the starts of the steps [ns].
        ends: stamps of their ends [ns].
        intervals: time between IMU samples [s].

    Raises:
        ValueError: an array has the wrong size.
    """
    count = min(len(ends), len(intervals), len(table))
    if count < len(starts) or table.shape[1] != STEP_COLUMNS:
        raise ValueError(WRONG_SIZE)
    for k in range(len(starts)):
        elapsed = ends[k] - starts[k]
        if k == 0 or elapsed != ends[k - 1] - starts[k - 1]:
            constants = step_constants(elapsed * NANOSECOND)
            for c in range(PER_STEP):
                table[k, c] = constants[c]
        else:
            for c in range(PER_STEP):
                table[k, c] = table[k - 1, c]
        table[k, PER_STEP] = intervals[k]


fill_step_constants = entry(fill_table)
