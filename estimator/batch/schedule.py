"""When the steps of a run are: the same for all filters that run side by side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimator.batch.errors import BatchError
from estimator.imu_clock import USUAL_INTERVAL
from estimator.log import NANOSECOND, Stamps

# What a step is: with time passing and an IMU sample at its end, such a sample alone, time alone.
MOVE_AND_UPDATE, UPDATE, MOVE = range(3)
# What there is at the end of a step besides.
POSITION, HEADING, TICK = 1, 2, 4


class Steps(NamedTuple):
    """The steps of a run.

    Attributes:
        starts: (n,) since the first stamp [ns].
        ends: (n,) [ns].
        kinds: (n,) what each is.
        intervals: (n,) between the newest two IMU samples [s].
        extras: (n,) what there is at its end besides, as bits.
        tracks: (n,) so many samples of the track speeds come before the end of the step.
        samples: (n,) which IMU sample is at its end.
        fixes: (n,) which fix is at its end.
        ticks: (n,) which tick is at its end.
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

    def part(self, begin: int, end: int) -> Steps:
        """Some of them."""
        return Steps(*(column[begin:end] for column in self))


def why_not_steps(tracks: Stamps, imu: Stamps, fixes: Stamps, ticks: Stamps) -> str | None:
    """Why filters cannot run side by side with sensors at these stamps [ns]; None where they can."""
    if len(tracks) == 0 or len(imu) == 0:
        return "there are no track speeds, or no IMU samples"
    if tracks[0] != imu[0]:
        return "the first track speeds and the first IMU sample are not at the same time"
    for stamps, what in ((fixes, "fixes"), (ticks, "the truth's stamps")):
        if not np.isin(stamps, imu).all():
            return f"{what} are not all at the stamps of IMU samples"
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
    for sample, stamp in enumerate((imu - begin).tolist()):
        while taken < len(track_stamps) and track_stamps[taken] <= stamp:
            # New speeds end what the old ones had to say, where no IMU sample has done so.
            old = track_stamps[taken - 1]
            if old > now:
                rows.append((now, old, MOVE, taken, sample))
                now = old
            taken += 1
        rows.append((now, stamp, MOVE_AND_UPDATE if stamp > now else UPDATE, taken, sample))
        now = stamp
    starts, ends, kinds, counts, samples = (np.array(column) for column in zip(*rows, strict=True))
    between = np.concatenate([[USUAL_INTERVAL], np.diff(imu) * NANOSECOND])
    at_imu = kinds != MOVE
    absolute = ends + begin
    is_fix, is_tick = (np.isin(absolute, stamps) & at_imu for stamps in (fixes, ticks))
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
    )
