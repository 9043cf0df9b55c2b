"""Latency of track speeds and truth against the gyro, and clocks that are apart.

Drivers report a speed that was averaged, filtered or sampled earlier, and loggers repeat it until the
next one. A latency of 0.2 s at a start or stop is an error of 0.2 s of driving, which exceeds the effect
of slip in that time. The estimate needs neither truth nor fixes.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from msgspec import structs

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.lag_search import BEYOND
from icreckon.estimator.log.lag import (
    LEAST_TURN,
    Lag,
    NoLag,
    find_lag,
    heading_of,
    places_of,
    plain_path,
    turned,
    turned_in_steps,
)
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import (
    ImuSeries,
    PoseSeries,
    TrackSpeedSeries,
    Truth,
    running_integral,
)
from icreckon.replay.inspection.imu_mounting import (
    CLEAR_TURNING,
    are_usable,
    estimate_mounting,
    vertical_rate,
)
from icreckon.replay.mapping.topics import TopicMap

_Series = TypeVar("_Series", TrackSpeedSeries, PoseSeries)

LEAST_LATENCY = 0.03  # smallest size of a latency that is proposed [s]
LEAST_OFFSET = 1.0  # least offset of a clock; less is a latency [s]
STEP, LEAST_OVERLAP = 0.1, 60.0  # time between yaw rates that are compared, and least overlap [s]
LONGEST = 1e6  # longest series that is compared [s]
CLEAR, NEXT, APART = 0.7, 0.8, 5.0
"""Least correlation at which clocks fit, its largest share at other offsets, how far these are [s]."""


def objection(latency: Lag) -> str:
    """Reason not to correct a latency, empty if there is none."""
    if abs(latency.seconds) <= BEYOND * latency.sigma:
        return "within its error"
    return "" if abs(latency.seconds) > LEAST_LATENCY else f"less than {LEAST_LATENCY:g} s"


def without_lag(series: _Series, lag: Lag) -> _Series:
    """Copy of a series with a lag subtracted from its stamps."""
    return replace(series, stamps=series.stamps - round(lag.seconds / NANOSECOND))


def track_latency(tracks: TrackSpeedSeries, imu: ImuSeries, vertical: Floats) -> Lag | NoLag:
    """Estimate the latency of track speeds against the gyro."""
    # Each track speed, in any unit, is the mean since the one before. `vertical` (n,) is the rate of the
    # IMU about the vertical [rad/s].
    by_tracks = turned_in_steps(tracks.stamps, tracks.difference)
    return find_lag(by_tracks, turned_in_steps(imu.stamps, vertical), least=LEAST_TURN)


def truth_lag(truth: Truth, tracks: TrackSpeedSeries, imu: ImuSeries, rate: Floats) -> Lag | NoLag:
    """Estimate the lag of a truth by its headings, or else by its positions."""
    # Headings are compared with the gyro: `rate` (n,) is the IMU's rate about the vertical [rad/s].
    # Positions are compared with the path of tracks and gyro; the track speeds may have any unit.
    if truth.headings:
        return find_lag(heading_of(truth.poses), turned(imu.stamps, rate), least=LEAST_TURN)
    if not len(tracks.stamps):
        return NoLag("there are neither headings nor track speeds")
    return find_lag(places_of(truth.poses), places_of(plain_path(tracks, imu, rate)))


def clock_offset(tracks: TrackSpeedSeries, imu: ImuSeries, vertical: Floats) -> float | None:
    """Time by which the clock of the tracks is ahead of the IMU's, by yaw rates [s].

    Any offset is tried at which both overlap for a minute and half of the shorter. None if none is clear.
    """
    from scipy.signal import correlate

    series = tracks.stamps, imu.stamps
    if any(len(one) < 2 or (one[-1] - one[0]) * NANOSECOND > LONGEST for one in series):
        return None
    by_tracks, by_gyro = (
        _even_rates(stamps, rates)
        for stamps, rates in ((tracks.stamps, tracks.difference), (imu.stamps, vertical))
    )
    shifts = np.arange(1 - len(by_tracks), len(by_gyro))
    first, last = np.maximum(0, -shifts), np.minimum(len(by_tracks), len(by_gyro) - shifts)
    shorter = STEP * min(len(by_tracks), len(by_gyro))
    overlaps = STEP * (last - first) >= max(LEAST_OVERLAP, 0.5 * shorter)
    squares = [np.concatenate([[0.0], np.cumsum(rates**2)]) for rates in (by_tracks, by_gyro)]
    energy = squares[0][last] - squares[0][first]
    energy *= squares[1][(last + shifts)] - squares[1][(first + shifts)]
    products = correlate(by_gyro, by_tracks, "full", "fft")
    correlation = np.where(overlaps & (energy > 0.0), products, 0.0)
    correlation /= np.sqrt(np.maximum(energy, 1e-12))
    best = int(np.argmax(np.abs(correlation)))
    others = np.abs(correlation)[np.abs(shifts - shifts[best]) * STEP > APART]
    size = float(np.abs(correlation[best]))
    if size < CLEAR or others.max(initial=0.0) > NEXT * size:
        return None
    apart = int(tracks.stamps[0]) - int(imu.stamps[0])
    coarse = apart * NANOSECOND - STEP * float(shifts[best])
    shifted = replace(tracks, stamps=tracks.stamps - round(coarse / NANOSECOND))
    rest = track_latency(shifted, imu, vertical)
    return coarse + (rest.seconds if isinstance(rest, Lag) else 0.0)


def _even_rates(stamps: Stamps, rates: Floats) -> Floats:
    """Means of a rate (n,) over steps of `STEP`, less their mean."""
    seconds = (stamps - stamps[0]) * NANOSECOND
    angle = np.interp(np.arange(0.0, seconds[-1], STEP), seconds, running_integral(stamps, rates))
    means = np.diff(angle) / STEP
    return np.asarray(means - means.mean())


def turn_alike(log: Log) -> bool:
    """Test whether tracks and gyro clearly turn alike, or opposite; True without them."""
    mounting = estimate_mounting(log)
    correlation = None if mounting is None else mounting.turning_correlation
    return correlation is None or abs(correlation) > CLEAR_TURNING


def on_one_clock(mapping: TopicMap, read: Callable[[TopicMap, str], Log]) -> TopicMap:
    """Mapping with the offset of the tracks' clock, of tables in which it is clear.

    `read` reads one stream of a mapping, by its purpose.
    """
    columns = mapping.columns
    if columns is None or columns.tracks is None:
        return mapping
    tracks, of_imu = read(mapping, "tracks").tracks, read(mapping, "imu")
    mounting = estimate_mounting(of_imu)
    if of_imu.imu is None or mounting is None or not are_usable(tracks):
        return mapping
    offset = clock_offset(tracks, of_imu.imu, vertical_rate(of_imu.imu, mounting)) or 0.0
    if abs(offset) < LEAST_OFFSET:
        return mapping
    by = round(columns.tracks.clock_offset + offset, 2)
    changed = structs.replace(columns.tracks, clock_offset=by)
    return structs.replace(mapping, columns=structs.replace(columns, tracks=changed))
