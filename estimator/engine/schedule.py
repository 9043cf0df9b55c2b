"""When the steps of a run are: the same for all filters that run side by side."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Stamps
from icreckon.estimator.base.errors import BatchError
from icreckon.estimator.sensors.imu_clock import LEAST_WAIT, USUAL_INTERVAL

# What a step is: with time passing and an IMU sample at its end, such a sample alone, time alone, or no
# step at all but a fix on the way to the next.
MOVE_AND_UPDATE, UPDATE, MOVE, AHEAD = range(4)
# What there is at the end of a step besides, or on the way to it; and that the IMU has long been silent
# at its start.
POSITION, HEADING, TICK, SILENT = 1, 2, 4, 8


class Steps(NamedTuple):
    """The steps of a run.

    Attributes:
        starts: (n,) since the first stamp [ns].
        ends: (n,) [ns]; for a fix on the way its own stamp.
        kinds: (n,) what each is.
        intervals: (n,) between the newest two IMU samples [s].
        extras: (n,) what there is at its end besides, as bits.
        tracks: (n,) so many samples of the track speeds come before the end of the step.
        samples: (n,) which IMU sample is at its end.
        fixes: (n,) which fix is at its end.
        ticks: (n,) which tick is at its end.
        known: (n,) so many samples of the track speeds are known when its estimate is looked at.
    """

    starts: Stamps
    ends: Stamps
    kinds: Stamps
    intervals: np.ndarray
    extras: Stamps
    tracks: Stamps
    samples: Stamps
    fixes: Stamps
    ticks: Stamps
    known: Stamps

    def part(self, begin: int, end: int) -> Steps:
        """Some of them."""
        return Steps(*(column[begin:end] for column in self))


def why_not_steps(tracks: Stamps, imu: Stamps, fixes: Stamps, ticks: Stamps) -> str | None:
    """Why filters cannot run side by side with sensors at these stamps [ns]; None where they can."""
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
        return "there are fixes before the second IMU sample, which nothing is known to wait for"
    return None


def steps_of(tracks: Stamps, imu: Stamps, fixes: Stamps, ticks: Stamps, *, heading: bool) -> Steps:
    """The steps of a run whose sensors sample at these stamps [ns].

    Args:
        tracks: (n,) of the track speeds, ascending.
        imu: of the IMU.
        fixes: of the fixes.
        ticks: when the estimate is wanted.
        heading: whether fixes have a heading.

    Raises:
        BatchError: filters cannot run side by side with such stamps.
    """
    reason = why_not_steps(tracks, imu, fixes, ticks)
    if reason is not None:
        raise BatchError(f"these runs cannot be worked through side by side: {reason}")
    begin = int(imu[0])
    rows = []
    now, taken = 0, 1
    track_stamps = (tracks - begin).tolist()
    between_samples = (fixes[~np.isin(fixes, imu)] - begin).tolist()
    waiting = deque([*between_samples, math.inf])
    for sample, stamp in enumerate((imu - begin).tolist()):
        while True:
            track = track_stamps[taken] if taken < len(track_stamps) else math.inf
            if track <= min(waiting[0], stamp):
                # New speeds end what the old ones had to say, where no IMU sample has done so.
                old = track_stamps[taken - 1]
                if old > now:
                    rows.append((now, old, MOVE, taken, sample))
                    now = old
                taken += 1
            elif waiting[0] < stamp:
                rows.append((now, int(waiting.popleft()), AHEAD, taken, sample))
            else:
                break
        rows.append((now, stamp, MOVE_AND_UPDATE if stamp > now else UPDATE, taken, sample))
        now = stamp
    starts, ends, kinds, counts, samples = (np.array(column) for column in zip(*rows, strict=True))
    between = np.concatenate([[USUAL_INTERVAL], np.diff(imu) * NANOSECOND])
    at_imu = (kinds == MOVE_AND_UPDATE) | (kinds == UPDATE)
    absolute = ends + begin
    is_fix = (kinds == AHEAD) | (np.isin(absolute, fixes) & at_imu)
    is_tick = np.isin(absolute, ticks) & at_imu
    fix_bits = POSITION | (HEADING if heading else 0)
    extras = np.where(is_fix, fix_bits, 0) | np.where(is_tick, TICK, 0)
    return Steps(
        starts,
        ends,
        kinds,
        between[samples],
        extras.astype(np.int64),
        counts,
        samples,
        np.searchsorted(fixes, absolute),
        np.searchsorted(ticks, absolute),
        counts,
    )
