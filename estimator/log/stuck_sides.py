"""Sides of a log that repeat one reading while the other side drives."""

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries

LEFT, RIGHT = 0, 1
# Least time of one reading [s], and distance of the other side meanwhile [m].
LEAST_TIME, LEAST_DISTANCE = 3.0, 1.0
# Least difference between the turning of tracks and gyro, over the speed of the other side.
LEAST_SHARE = 0.2
# Without a gyro: least share of the log, since a robot may turn about a side that it holds.
SHARE_WITHOUT_GYRO = 0.3


class StuckSide(NamedTuple):
    """Side that is stuck during some spans."""

    side: int  # `LEFT` or `RIGHT`
    spans: tuple[slice, ...]  # rows of the track speeds
    text: str  # which side, what it reads, from when and for how long


def stuck_sides(tracks: TrackSpeedSeries, turning: Floats | None) -> list[StuckSide]:
    """Sides that repeat one reading, contradicted by the other side and the gyro.

    Args:
        tracks: the track speeds.
        turning: (n,) right speed less left speed by the gyro [m/s]; None without a gyro.
    """
    if not len(tracks.stamps):
        return []
    times = (tracks.stamps - tracks.stamps[0]) * NANOSECOND
    left, right = tracks.speeds.T
    difference = np.zeros(len(times)) if turning is None else np.abs(right - left - turning)
    found = []
    for side, (own, other) in enumerate(((left, right), (right, left))):
        ends = np.array([*np.flatnonzero(np.diff(own)) + 1, len(own)])
        firsts = np.array([0, *ends[:-1]])
        lasts = times[ends - 1] - times[firsts]
        spans, seconds = [], 0.0
        for k in np.flatnonzero(lasts > LEAST_TIME):
            rows = slice(int(firsts[k]), int(ends[k]))
            speed = float(np.abs(other[rows]).mean())
            drives = speed * lasts[k] > LEAST_DISTANCE and np.ptp(other[rows]) > 0.0
            if drives and (turning is None or difference[rows].mean() > LEAST_SHARE * speed):
                spans.append(rows)
                seconds += lasts[k]
        if spans and (turning is not None or seconds > SHARE_WITHOUT_GYRO * times[-1]):
            first, name = spans[0].start, ("left", "right")[side]
            text = (
                f"the {name} side repeats one reading ({own[first]:.3g} m/s at {times[first]:.0f} s) "
                f"for {seconds:.0f} of {times[-1]:.0f} s while the other one drives"
            )
            found.append(StuckSide(side, tuple(spans), text))
    return found


def turning_at(tracks: TrackSpeedSeries, imu: ImuSeries, rates: Floats, width: float) -> Floats:
    """Turning (n,) by yaw rates (m,) [rad/s], at the stamps of tracks [m/s]."""
    return np.asarray(np.interp(tracks.stamps, imu.stamps, rates) * width)
