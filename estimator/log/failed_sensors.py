"""Sensors that fail in a log, or in a part of it, by the log alone."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps, true_runs
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import TrackSpeedSeries

LEFT, RIGHT = 0, 1
# Least time of one reading [s], and distance that the robot or the other side drives meanwhile [m].
LEAST_TIME, LEAST_DISTANCE = 3.0, 1.0
# Least difference between the turning of tracks and gyro, or without a gyro least change of the other
# side, over the speed of the other side. With a frozen gyro: least change of the tracks' turning.
LEAST_SHARE = 0.2
# Without a gyro: least share of the log, since a robot may turn about a side that it holds.
SHARE_WITHOUT_GYRO = 0.3
# Turning over speed of a straight stretch, and least speed in it over the highest [-]; difference of the
# sides that counts [-]; the time with it less the time without it, since it began, is at least this [s],
# and this share of both [-].
STRAIGHT_SHARE, SPEED_SHARE = 0.1, 0.3
LEAST_RATIO, LEAST_UNEQUAL, NEARLY_ALL = 0.2, 5.0, 0.8
# Least time without the IMU that is reported [s], and its least share of the log [-].
LEAST_WITHOUT_IMU, SHARE_WITHOUT_IMU = 5.0, 0.05


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
        spans, seconds = [], 0.0
        for rows in _repeats(own, tracks.stamps):
            time = times[rows.stop - 1] - times[rows.start]
            speed = float(np.abs(other[rows]).mean())
            # Without a gyro, a steady speed that a coarse encoder repeats is no contradiction.
            change = np.ptp(np.percentile(other[rows], [5, 95]))
            contradiction = change if turning is None else difference[rows].mean()
            drives = speed * time > LEAST_DISTANCE and np.ptp(other[rows]) > 0.0
            if drives and contradiction > LEAST_SHARE * speed:
                spans.append(rows)
                seconds += time
        if spans and (turning is not None or seconds > SHARE_WITHOUT_GYRO * times[-1]):
            first, name = spans[0].start, ("left", "right")[side]
            text = (
                f"the {name} side repeats one reading ({own[first]:.3g} m/s at {times[first]:.0f} s) "
                f"for {seconds:.0f} of {times[-1]:.0f} s while the other one drives"
            )
            found.append(StuckSide(side, tuple(spans), text))
    return found


class UnequalSides(NamedTuple):
    """Side that reads less than the other one where the robot drives straight on."""

    side: int  # `LEFT` or `RIGHT`, the one that reads less
    ratio: float  # its speed over the speed of the other side [-]
    begin: int  # row of the track speeds from which on it does
    text: str  # which side, how much less, from when on


def unequal_sides(tracks: TrackSpeedSeries, stamps: Stamps, rates: Floats) -> UnequalSides | None:
    """Compare the sides on straight stretches, from some time on to the log's end.

    Args:
        tracks: the track speeds.
        stamps: (m,) stamps of the yaw rates [ns].
        rates: (m,) yaw rates [rad/s].
    """
    left, right = tracks.speeds.T
    speed, rate = np.abs(tracks.speeds).max(axis=1), rates_at(tracks, stamps, rates)
    if np.ptp(rate) == 0.0:
        return None
    # Effective track where one side may read less: the difference that goes with the turning alone.
    by_speed_and_rate = np.column_stack([tracks.speeds.mean(axis=1), rate])
    (_, width), *_ = np.linalg.lstsq(by_speed_and_rate, tracks.difference, rcond=None)
    width = abs(width)
    is_straight = np.abs(rate) * width < STRAIGHT_SHARE * speed
    is_straight &= speed > SPEED_SHARE * speed.max()
    rows = np.flatnonzero(is_straight & (left * right > 0.0))
    seconds = (tracks.stamps - tracks.stamps[0]) * NANOSECOND
    for side, ratios in ((LEFT, left[rows] / right[rows]), (RIGHT, right[rows] / left[rows])):
        # Straight samples that read less, less those that do not, from each on to the end.
        signs = np.where(ratios < 1.0 - LEAST_RATIO, 1, -1)
        excess = np.cumsum(signs[::-1])[::-1]
        begin = int(np.argmax(excess)) if len(rows) else 0
        least_count = LEAST_UNEQUAL * len(seconds) / seconds[-1]
        # Slip makes the sides unequal now and then; what fails is unequal nearly always.
        if not len(rows) or excess[begin] < max(least_count, NEARLY_ALL * (len(rows) - begin)):
            continue
        ratio, from_on = float(np.median(ratios[begin:])), seconds[rows[begin]]
        is_later = seconds[rows[begin]] - seconds[rows[0]] > LEAST_UNEQUAL
        text = (
            f"straight on by the gyro, the {('left', 'right')[side]} side reads {ratio:.2f} times what "
            f"the other one reads{f', from {from_on:.0f} s on' if is_later else ''}"
        )
        return UnequalSides(side, ratio, int(rows[begin]) if is_later else 0, text)
    return None


def working_imu(log: Log, upward: Floats | None = None) -> tuple[Log, str]:
    """Longest part of a log in which the IMU works, and what it does in the others.

    The log and "" if there are no others. The part is without the IMU if that works nowhere for long.
    With the vertical `upward` (3,) in the IMU's axes, a gyro that shows no turning is frozen, too.
    """
    imu, tracks = log.imu, log.tracks
    if imu is None or len(imu.stamps) < 2 or not len(tracks.stamps):
        return log, ""
    works = np.ones(len(imu.stamps), dtype=bool)
    rates = imu.angular_velocity if upward is None else imu.angular_velocity @ upward
    for rows in _repeats(rates, imu.stamps):
        span = imu.stamps[rows][[0, -1]]
        meanwhile = slice(*np.searchsorted(tracks.stamps, span))
        speed, turning = np.abs(tracks.speeds[meanwhile]), tracks.difference[meanwhile]
        seconds = float(np.diff(span)[0]) * NANOSECOND
        # A robot that drives steadily, or not at all, may repeat its readings; means are free of noise.
        if speed.size and speed.mean() * seconds > LEAST_DISTANCE:
            means = [part.mean() for part in np.array_split(turning, int(seconds)) if len(part)]
            works[rows] = np.ptp(np.percentile(means, [5, 95])) <= LEAST_SHARE * speed.mean()
    begin, end = tracks.stamps[[0, -1]]
    edges, whole = np.concatenate([[begin], imu.stamps[works], [end]]), (end - begin) * NANOSECOND
    # A hole in the track speeds, too, is none of the IMU alone.
    gaps = np.diff(np.searchsorted(tracks.stamps, edges)) * whole / len(tracks.stamps)
    failures = np.flatnonzero(gaps > (least := max(LEAST_WITHOUT_IMU, SHARE_WITHOUT_IMU * whole)))
    if not len(failures):
        return log, ""
    what = "has no samples" if works.all() else "repeats one reading while the tracks turn"
    text = f"{what}, for {gaps[failures].sum():.0f} of {whole:.0f} s"
    parts = edges[[0, *(failures + 1)]], edges[[*failures, -1]]
    longest = int(np.argmax(parts[1] - parts[0]))
    start, stop = (int(ends[longest]) for ends in parts)
    works_long = (stop - start) * NANOSECOND > least
    return log.between(start, stop) if works_long else replace(log, imu=None), text


def _repeats(readings: Floats, stamps: Stamps) -> Iterator[slice]:
    """Rows in which readings (n,) or (n, k) stay the same for `LEAST_TIME`."""
    changes = np.diff(readings.reshape(len(stamps), -1), axis=0)
    for first, last in true_runs(~np.any(changes, axis=1)):
        if (stamps[last + 1] - stamps[first]) * NANOSECOND > LEAST_TIME:
            yield slice(first, last + 2)


def rates_at(tracks: TrackSpeedSeries, stamps: Stamps, rates: Floats) -> Floats:
    """Yaw rates (m,) at the stamps (n,) of tracks [rad/s]."""
    return np.asarray(np.interp(tracks.stamps, stamps, rates))
