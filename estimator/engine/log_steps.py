"""The steps of one log, at whatever stamps its sensors have sampled, and when its rows are written.

It does, for numba, what `estimator.filter.filter` and `estimator.streaming.run` decide by stamps alone:
to where the filter moves with each measurement, which fixes wait for the IMU, and which estimates become
rows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Stamps
from icreckon.estimator.base.errors import BatchError
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.schedule import (
    AHEAD,
    HEADING,
    MOVE,
    MOVE_AND_UPDATE,
    POSITION,
    SILENT,
    TICK,
    UPDATE,
    Steps,
)
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.held_tracks import TrackMemory
from icreckon.estimator.sensors.imu_clock import INTERVALS_TO_WAIT, LEAST_WAIT, USUAL_INTERVAL
from icreckon.estimator.tracing.jit_kernel import entry

Bytes = NDArray[np.int8]
Places = NDArray[np.int32]

# What cannot be done, by the number that the compiled walk gives.
REASONS = (
    "",
    "there is an IMU sample at a stamp that the filter has reached without it",
    "there is a stamp further ahead than Settings.longest_gap",
)
NEVER = -(2**62)
TRACK_INTERVAL = TrackMemory().interval


class LogSteps(NamedTuple):
    """The steps of a log and its rows; stamps are since the first track speeds [ns].

    Attributes:
        starts: (n,) of the steps, see `estimator.engine.schedule.Steps`; the columns up to `known`, too.
        ends: (n,).
        kinds: (n,).
        intervals: (n,) [s].
        extras: (n,).
        tracks: (n,).
        samples: (n,).
        fixes: (n,).
        rows: (n,) which row the estimate at the end of the step is; -1 for none.
        known: (n,).
        row_stamps: (k,) of the estimates that are the rows.
        row_samples: (k,) whether there was an IMU sample since the row before.
        row_fixes: (k,) the newest fix since the row before; -1 for none.
        gaps: how many gaps in the track speeds were bridged.
        unused: how many IMU samples came before the first track speeds.
    """

    starts: Stamps
    ends: Stamps
    kinds: Bytes
    intervals: NDArray[np.float64]
    extras: Bytes
    tracks: Places
    samples: Places
    fixes: Places
    rows: Places
    known: Places
    row_stamps: Stamps
    row_samples: Bytes
    row_fixes: Places
    gaps: int
    unused: int

    @property
    def before_steps(self) -> bool:
        """Whether the first row is the estimate before any step."""
        return bool(len(self.row_stamps)) and not (self.rows == 0).any()

    def part(self, begin: int, end: int) -> Steps:
        """Some of the steps; each estimate that is told is a tick of its own."""

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
            long(self.known),
        )


def steps_of_log(
    tracks: Stamps, imu: Stamps, fixes: Stamps, headings: Bytes, settings: Settings, told: int
) -> LogSteps:
    """The steps from the first track speeds on, with sensors that sampled at these stamps [ns].

    Args:
        tracks: of the track speeds, at least one.
        imu: of the IMU.
        fixes: of the fixes.
        headings: of each fix whether it has a heading.
        settings: of the filters.
        told: of so many steps at the end the estimate is told, whether it is a row or not.

    Raises:
        BatchError: filters side by side cannot take such stamps.
    """
    begin = int(tracks[0])
    most = 2 * (len(tracks) + len(imu)) + len(fixes)
    kinds_of = (np.int64, np.int64, np.int8, np.float64, np.int8, *(np.int32,) * 5)
    columns: list[NDArray[Any]] = [np.empty(most, kind) for kind in kinds_of]
    rows = (
        np.empty(len(tracks), np.int64),
        np.empty(len(tracks), np.int8),
        np.empty(len(tracks), np.int32),
    )
    stamps = tracks - begin, imu - begin, fixes - begin, headings
    clocks = np.array([settings.hold, settings.longest_gap])
    count, count_of_rows, gaps, unused, reason = walk_entry(*stamps, clocks, *columns, *rows)
    if reason:
        raise BatchError(REASONS[reason])
    filled: list[Any] = [column[:count] for column in columns]
    filled += [*(column[:count_of_rows] for column in rows), gaps, unused]
    steps = LogSteps(*filled)
    at_end = slice(max(0, count - told), count)
    steps.extras[at_end] |= np.where(steps.kinds[at_end] <= UPDATE, TICK, 0).astype(np.int8)
    return steps


def walk(
    tracks: Stamps,
    imu: Stamps,
    fixes: Stamps,
    headings: Bytes,
    clocks: NDArray[np.float64],
    starts: Stamps,
    ends: Stamps,
    kinds: Bytes,
    intervals: NDArray[np.float64],
    extras: Bytes,
    counts: Places,
    samples: Places,
    fix_numbers: Places,
    row_numbers: Places,
    known: Places,
    row_stamps: Stamps,
    row_samples: Bytes,
    row_fixes: Places,
) -> tuple[int, int, int, int, int]:
    """Walk through the stamps of a log; see `steps_of_log`.

    Returns:
        How many steps and rows were written down, how many gaps and unused IMU samples there were, and
        which of `REASONS` ended it, or 0.

    Raises:
        ValueError: an array has the wrong size.
    """
    most = 2 * (len(tracks) + len(imu)) + len(fixes)
    sizes_fit = len(headings) == len(fixes) and len(clocks) == 2
    sizes_fit &= min(len(starts), len(ends), len(kinds), len(intervals), len(extras)) >= most
    sizes_fit &= min(len(counts), len(samples), len(fix_numbers), len(row_numbers)) >= most
    sizes_fit &= min(len(row_stamps), len(row_samples), len(row_fixes)) >= len(tracks)
    if not sizes_fit or len(known) < most:
        raise ValueError(WRONG_SIZE)
    hold, longest_gap = clocks[0], int(clocks[1] / NANOSECOND)
    n = count = gaps = unused = 0
    i = j = f = 0
    now, written, newest = 0, NEVER, NEVER
    due = False
    imu_stamp, imu_interval = NEVER, USUAL_INTERVAL
    track_stamp, track_interval = 0, TRACK_INTERVAL
    last_step = last_sample = newest_fix = -1
    end = 2**62
    while True:
        track = tracks[i] if i < len(tracks) else end
        sample = imu[j] if j < len(imu) else end
        fix = fixes[f] if f < len(fixes) else end
        stamp = min(track, sample, fix)
        if due and now != written and (stamp > newest):
            # The estimate that stands is the next row.
            if last_sample >= 0:
                extras[last_sample] |= TICK
            for k in range(max(last_step, 0), n):
                extras[k] |= TICK
                row_numbers[k], known[k] = count, i
            row_stamps[count], row_fixes[count] = now, newest_fix
            row_samples[count] = last_sample >= 0
            count, written, due = count + 1, now, False
            last_sample = newest_fix = -1
        if stamp == end:
            return n, count, gaps, unused, 0
        newest = stamp
        begun = i > 0
        if begun and stamp - now > longest_gap:
            return n, count, gaps, unused, 2
        moves, waits = 0, False
        to, silent, taken = now, False, i
        kind, number, bits = MOVE, -1, 0
        if stamp == track:
            if begun:
                to = track_stamp
                if (stamp - track_stamp) * NANOSECOND > hold:
                    to = stamp - int(track_interval / NANOSECOND)
                    gaps += 1
                moves = 1
        elif stamp == sample:
            if begun and imu_stamp != NEVER and (stamp - imu_stamp) * NANOSECOND <= hold:
                imu_interval = (stamp - imu_stamp) * NANOSECOND
            imu_stamp = stamp
            if not begun:
                unused, j = unused + 1, j + 1
                continue
            if (stamp - now) * NANOSECOND > hold:
                to, moves = stamp - int(imu_interval / NANOSECOND), 1
        else:
            bits = POSITION | (HEADING if headings[f] else 0)
            patience = max(INTERVALS_TO_WAIT * imu_interval, LEAST_WAIT)
            waits = stamp > now and imu_stamp != NEVER
            waits = waits and (stamp - imu_stamp) * NANOSECOND <= patience
            if not begun:
                f += 1
                continue
            if n == 0 and stamp == now:
                # There is no step yet that it could be at the end of.
                waits = True
            if not waits:
                to, moves = stamp, 1
        for again in range(2):
            # Time alone passes: to where the old speeds count, and with the new ones where no IMU
            # can be waited for.
            if moves and to > now:
                silent = imu_stamp == NEVER or (now - imu_stamp) * NANOSECOND > hold
                starts[n], ends[n], kinds[n], intervals[n] = now, to, MOVE, imu_interval
                extras[n] = SILENT if silent else 0
                counts[n] = known[n] = taken
                samples[n], fix_numbers[n], row_numbers[n] = 0, 0, -1
                last_step, now, n = n, to, n + 1
            if again or stamp != track:
                break
            if begun and (stamp - track_stamp) * NANOSECOND <= hold:
                track_interval = (stamp - track_stamp) * NANOSECOND
            track_stamp, i, due = stamp, i + 1, True
            taken, to, moves = i, stamp, 1
            if not begun or (imu_stamp != NEVER and (stamp - imu_stamp) * NANOSECOND <= hold):
                break
        if stamp == track:
            continue
        if stamp == sample:
            kind = MOVE_AND_UPDATE if stamp > now else UPDATE
            if kind == UPDATE and n > 0:
                return n, count, gaps, unused, 1
            number, j = j, j + 1
        else:
            newest_fix, f = f, f + 1
            # What gates judge of fixes is told in any case; on the way, with the step before.
            for k in range(max(last_step, 0), n):
                extras[k] |= TICK
            bits |= TICK
            if not waits:
                extras[n - 1] |= bits
                fix_numbers[n - 1] = newest_fix
                continue
            kind = AHEAD
        starts[n], ends[n], kinds[n], intervals[n] = now, stamp, kind, imu_interval
        extras[n], row_numbers[n] = bits, -1
        counts[n] = known[n] = i
        samples[n], fix_numbers[n] = max(number, 0), max(newest_fix, 0)
        if kind != AHEAD:
            last_step, last_sample, now = n, n, stamp
        n += 1


walk_entry = entry(walk)
