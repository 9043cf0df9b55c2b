"""Latency of track speeds and truth against the gyro, and whether to propose it.

Drivers report a speed that was averaged, filtered or sampled earlier, and loggers repeat it until the
next one. A latency of 0.2 s at a start or stop is an error of 0.2 s of driving, which exceeds the effect
of slip in that time. The estimate needs neither truth nor fixes.
"""

from dataclasses import replace
from typing import TypeVar

from icreckon.estimator.base.array_types import NANOSECOND, Floats
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
from icreckon.estimator.log.series import ImuSeries, PoseSeries, TrackSpeedSeries, Truth

_Series = TypeVar("_Series", TrackSpeedSeries, PoseSeries)

LEAST_LATENCY = 0.03  # smallest size of a latency that is proposed [s]


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
