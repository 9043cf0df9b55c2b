"""Schedule of the steps of filters side by side, from the stamps of measurements.

`walk_stamps` makes the steps that `streaming.reckoning` takes with each measurement, and finds the fixes
that wait for the IMU. `fill_table` computes the constants of each step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.errors import WRONG_SIZE, BatchError
from icreckon.estimator.base.records import record_array
from icreckon.estimator.engine.constants import PER_STEP, step_constants
from icreckon.estimator.robot.settings import LONGEST_TIME
from icreckon.estimator.sensors.held_tracks import USUAL_TRACK_INTERVAL
from icreckon.estimator.sensors.imu_clock import LEAST_WAIT, ClockRecord, is_due_after, take_stamp
from icreckon.estimator.tracing.jit_kernel import entry

Places = NDArray[np.int32]

# Kinds of steps: propagation up to an IMU sample, an IMU sample alone, propagation alone, and a fix
# alone, ahead of the next step.
MOVE_AND_UPDATE, UPDATE, MOVE, AHEAD = range(4)
# Bits of a step: a fix at its end or ahead of it; the fix has a heading; and a tick.
POSITION, HEADING, TICK = 1, 2, 4
END = 2**62  # after the last measurement
STEP_COLUMNS = PER_STEP + 1  # columns of a table of constants, with the interval of the IMU last


class Steps(NamedTuple):
    """Steps of a run, in columns."""

    starts: Stamps  # (n,) stamps of their starts, since the first stamp [ns]
    ends: Stamps  # (n,) stamps of their ends [ns]; for a fix ahead, the stamp of the fix
    kinds: Stamps  # (n,) kinds
    intervals: NDArray[Any]  # (n,) time between the newest two IMU samples [s]
    extras: Stamps  # (n,) bits, see `POSITION` and the others
    tracks: Stamps  # (n,) number of track-speed samples before the end of the step
    samples: Stamps  # (n,) index of the IMU sample at the end
    fixes: Stamps  # (n,) index of the fix at the end
    ticks: Stamps  # (n,) index of the tick at the end

    def part(self, begin: int, end: int) -> Steps:
        """Steps from `begin` to before `end`."""
        return Steps(*(column[begin:end] for column in self))


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
    fast enough that filters never wait for it. Stamps ascend [ns]; `ticks` are those of the estimates to
    output. With `heading` the fixes have one.

    Raises:
        BatchError: filters cannot run side by side with such stamps.
    """
    reason = why_not_steps(tracks, imu, fixes, ticks)
    if reason is not None:
        raise BatchError(f"filters cannot run side by side over these runs: {reason}")
    begin, until_end = int(imu[0]), tracks[tracks <= imu[-1]]
    steps = _walk_from_first_tracks(SensorStamps(until_end, imu, fixes))
    absolute = steps.ends + begin
    is_tick = np.isin(absolute, ticks) & (steps.kinds <= UPDATE)
    extras = steps.extras | np.where(is_tick, TICK, 0)
    extras |= np.where(heading & (steps.extras > 0), HEADING, 0)
    return steps._replace(extras=extras, ticks=np.searchsorted(ticks, absolute))


class SensorStamps(NamedTuple):
    """Stamps of all measurements of runs [ns]."""

    tracks: Stamps  # (n,) of the track speeds
    imu: Stamps  # (m,) of the IMU
    fixes: Stamps  # (k,) of the fixes


class Walk(msgspec.Struct):
    """State of a walk through the stamps, see `icreckon.estimator.base.records`."""

    now: int = 0  # stamp that the filter has reached [ns]
    steps: int = 0  # number of steps so far
    tracks: int = 0  # number of track-speed samples so far
    samples: int = 0  # number of IMU samples so far
    fixes: int = 0  # number of fixes so far
    fails: int = 0  # 1 if there is an IMU sample at a stamp that the filter has reached without it


def _walk_from_first_tracks(stamps: SensorStamps) -> Steps:
    """Steps of a filter over these stamps [ns], from the first track speeds on."""
    tracks, imu, fixes = stamps
    begin = int(tracks[0])
    most_steps = 2 * (len(tracks) + len(imu)) + len(fixes)
    kinds = [float if name == "intervals" else np.int64 for name in Steps._fields]
    columns: list[Any] = [np.zeros(most_steps, kind) for kind in kinds]
    state = record_array(Walk(), 1)
    new_clocks = ClockRecord(interval=USUAL_TRACK_INTERVAL), ClockRecord()
    clocks = np.concatenate([record_array(clock, 1) for clock in new_clocks])
    relative = SensorStamps(tracks - begin, imu - begin, fixes - begin)
    walk_entry(state, clocks, relative, Steps(*columns))
    if state[0]["fails"]:
        raise BatchError("there is an IMU sample at a stamp that the filter has reached without it")
    return Steps(*columns).part(0, int(state[0]["steps"]))


def walk_stamps(state: Any, clocks: Any, stamps: SensorStamps, steps: Steps) -> None:
    """Make steps from stamps [ns] since the first track speeds.

    `state` (1,) is a `Walk`, `clocks` (2,) are the `ClockRecord` of tracks and IMU; they are changed.
    `state.fails` is 1 if the walk ends early. `steps` have room for two per sample and one per fix.

    Raises:
        ValueError: an array has the wrong size.
    """
    most = 2 * (len(stamps.tracks) + len(stamps.imu)) + len(stamps.fixes)
    sizes_fit = len(state) == 1 and len(clocks) == 2
    sizes_fit &= min(len(steps.starts), len(steps.ends), len(steps.intervals)) >= most
    sizes_fit &= min(len(steps.kinds), len(steps.extras), len(steps.tracks)) >= most
    sizes_fit &= min(len(steps.samples), len(steps.fixes)) >= most
    if not sizes_fit:
        raise ValueError(WRONG_SIZE)
    walk, tracks, imu = state[0], clocks[0], clocks[1]
    while not walk.fails:
        track = stamps.tracks[walk.tracks] if walk.tracks < len(stamps.tracks) else END
        sample = stamps.imu[walk.samples] if walk.samples < len(stamps.imu) else END
        fix = stamps.fixes[walk.fixes] if walk.fixes < len(stamps.fixes) else END
        stamp = min(track, sample, fix)
        if stamp == END:
            return
        if stamp == track:
            walk_to_tracks(walk, tracks, imu, stamp, steps)
        elif stamp == sample:
            walk_to_sample(walk, imu, stamp, steps)
        else:
            walk_to_fix(walk, imu, stamp, steps)


def walk_to_tracks(
    walk: Walk, tracks: ClockRecord, imu: ClockRecord, stamp: int, steps: Steps
) -> None:
    """Add track speeds at a stamp [ns], after a step to the stamp of those before."""
    if walk.tracks > 0 and not is_due_after(imu, tracks.stamp):
        move(walk, imu, tracks.stamp, steps)
    take_stamp(tracks, stamp, LONGEST_TIME)
    walk.tracks += 1


def walk_to_sample(walk: Walk, imu: ClockRecord, stamp: int, steps: Steps) -> None:
    """Add an IMU sample at a stamp [ns], which ends a step."""
    number = walk.samples
    walk.samples += 1
    if walk.tracks == 0:
        imu.stamp = stamp
        return
    take_stamp(imu, stamp, LONGEST_TIME)
    if stamp <= walk.now and walk.steps > 0:
        walk.fails = 1
        return
    step = add_step(walk, imu, stamp, MOVE_AND_UPDATE if stamp > walk.now else UPDATE, steps)
    steps.samples[step] = number
    walk.now = stamp


def walk_to_fix(walk: Walk, imu: ClockRecord, stamp: int, steps: Steps) -> None:
    """Add a fix at the end of a step, or ahead of one."""
    number = walk.fixes
    walk.fixes += 1
    if walk.tracks == 0:
        return
    # Before the first step, no step ends at the stamp of the fix.
    is_first = stamp == walk.now and walk.steps == 0
    waits = is_first or (stamp > walk.now and is_due_after(imu, stamp))
    if not waits:
        move(walk, imu, stamp, steps)
    step = add_step(walk, imu, stamp, AHEAD, steps) if waits else walk.steps - 1
    steps.extras[step] = POSITION
    steps.fixes[step] = number


def move(walk: Walk, imu: ClockRecord, to: int, steps: Steps) -> None:
    """Add a step of propagation to a stamp [ns], unless the filter is there already."""
    if to > walk.now:
        add_step(walk, imu, to, MOVE, steps)
        walk.now = to


def add_step(walk: Walk, imu: ClockRecord, end: int, kind: int, steps: Steps) -> int:
    """Add a step from the present stamp to another [ns]; return its index."""
    step = walk.steps
    steps.starts[step], steps.ends[step], steps.kinds[step] = walk.now, end, kind
    steps.intervals[step], steps.tracks[step] = imu.interval, walk.tracks
    walk.steps = step + 1
    return step


walk_entry = entry(walk_stamps)


# --- constants of steps ------------------------------------------------------------------------------


def fill_table(table: Floats, starts: Stamps, ends: Stamps, intervals: Floats) -> None:
    """Fill the constants (n, k) of each step, the interval of the IMU last.

    Steps go from `starts` to `ends` [ns]; `intervals` are times between IMU samples [s].

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
        table[k, PER_STEP] = intervals[k]


fill_step_constants = entry(fill_table)
