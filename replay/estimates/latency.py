"""Latency of track speeds and truth against the gyro, and clocks that are apart.

Drivers report a speed that was averaged, filtered or sampled earlier, and loggers repeat it until the
next one. A latency of 0.2 s at a start or stop is an error of 0.2 s of driving, which exceeds the effect
of slip in that time. The estimate needs neither truth nor fixes.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from msgspec import structs

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.lag_search import BEYOND
from icreckon.estimator.log.lag import (
    LEAST_TURN,
    Curve,
    Lag,
    NoLag,
    find_lag,
    heading_of,
    places_of,
    plain_path,
    turned,
)
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.path_heading import heading_fault
from icreckon.estimator.log.series import (
    ImuSeries,
    PoseSeries,
    TrackSpeedSeries,
    Truth,
    running_integral,
)
from icreckon.replay.estimates.imu_mounting import (
    YawRates,
    are_usable,
    estimate_mounting,
    vertical_rate,
)
from icreckon.replay.mapping.columns import TrackColumns
from icreckon.replay.mapping.topics import TopicMap

_Series = TypeVar("_Series", TrackSpeedSeries, PoseSeries)

LEAST_LATENCY = 0.03  # smallest size of a latency that is proposed [s]
LEAST_OFFSET = 1.0  # least offset of a clock; less is a latency [s]
STEP, LEAST_OVERLAP = 0.1, 60.0  # time between yaw rates that are compared, and least overlap [s]
LONGEST = 1e5  # longest series that is compared [s]
DRIFTS = np.linspace(-0.006, 0.006, 25).round(4).tolist()  # candidate drifts of a clock [s/s]
LEAST_CHANGE, CLEAR_CHANGE = 0.1, 5.0
"""Least change of the lag in half a log that is a drift of the clock [s], and in standard errors."""
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


def track_latency(tracks: TrackSpeedSeries, yaw_rates: YawRates) -> Lag | NoLag:
    """Estimate the latency of track speeds, in any unit, against the gyro."""
    # Each track speed is the mean since the one before.
    return find_lag(turned(tracks.stamps, tracks.difference), turned(*yaw_rates), least=LEAST_TURN)


def heading_lag(headings: Sequence[HeadingFix], yaw_rates: YawRates) -> Lag | NoLag:
    """Estimate the lag of headings behind the gyro."""
    stamps = np.array([heading.stamp for heading in headings])
    yaws = np.unwrap([heading.yaw for heading in headings])
    return find_lag(Curve(stamps, yaws), turned(*yaw_rates), least=LEAST_TURN)


def truth_lag(
    truth: Truth, tracks: TrackSpeedSeries, imu: ImuSeries, yaw_rates: YawRates
) -> Lag | NoLag:
    """Estimate the lag of a truth by headings that fit its path, or else by the path.

    Headings are compared with the gyro, positions with the path of tracks (in any unit) and gyro.
    """
    if truth.headings and heading_fault(truth) is None:
        return find_lag(heading_of(truth.poses), turned(*yaw_rates), least=LEAST_TURN)
    if not len(tracks.stamps):
        return NoLag("there are neither headings nor track speeds")
    return find_lag(places_of(truth.poses), places_of(plain_path(tracks, imu, yaw_rates.rates)))


def with_truth_in_time(log: Log, lag: Lag | NoLag | None) -> Log:
    """Log whose truth has no lag, if that is clear."""
    if log.truth is None or not isinstance(lag, Lag) or objection(lag):
        return log
    return replace(log, truth=replace(log.truth, poses=without_lag(log.truth.poses, lag)))


class ClockFit(NamedTuple):
    """Clock of the tracks against the IMU's."""

    offset: float  # time by which the tracks' clock is ahead at its first sample [s]
    drift: float  # growth of the offset over time [s/s]

    @property
    def is_apart(self) -> bool:
        """True if the clocks differ by more than a latency."""
        return abs(self.offset) >= LEAST_OFFSET or self.drift != 0.0

    def undone(self, tracks: TrackSpeedSeries) -> TrackSpeedSeries:
        """Track speeds on the clock of the IMU."""
        ahead = self.offset / NANOSECOND + self.drift * (tracks.stamps - tracks.stamps[0])
        return replace(tracks, stamps=tracks.stamps - np.round(ahead).astype(np.int64))

    def keys(self, tracks: TrackColumns) -> dict[str, float]:
        """Keys of the tracks' columns for a log that was read with these."""
        keys = {"clock_offset": round(tracks.clock_offset + self.offset, 2)}
        drift = round(tracks.clock_drift + self.drift, 6)
        if drift != tracks.clock_drift:
            keys["clock_drift"] = drift
        return keys


def clock_fit(tracks: TrackSpeedSeries, yaw_rates: YawRates) -> ClockFit | None:
    """Fit the clock of the tracks to that of the IMU, by yaw rates; None if not clear.

    Any offset is tried at which both overlap for a minute and half of the shorter, and drifts as those of
    ceramic resonators. A drift shows as a lag that differs in both halves.
    """
    for stamps in (tracks.stamps, yaw_rates.stamps):
        if len(stamps) < 2 or (stamps[-1] - stamps[0]) * NANOSECOND > LONGEST:
            return None
    by_gyro = _even_rates(*yaw_rates)
    starts_apart = int(tracks.stamps[0] - yaw_rates.stamps[0]) * NANOSECOND
    candidates = {}
    for drift in DRIFTS:
        steady = ClockFit(0.0, drift).undone(tracks)
        correlation, shift = _best_shift(_even_rates(steady.stamps, steady.difference), by_gyro)
        candidates[drift] = correlation, ClockFit(starts_apart - shift, drift)
    correlation, best = max(candidates.values(), key=lambda candidate: candidate[0])
    if not correlation:
        return None
    refined = _with_drift(best, tracks, yaw_rates)
    if refined is not None:
        return refined
    correlation, without_drift = candidates[0.0]
    if not correlation:
        return None
    lag = track_latency(without_drift.undone(tracks), yaw_rates)
    return ClockFit(without_drift.offset + (lag.seconds if isinstance(lag, Lag) else 0.0), 0.0)


def _with_drift(fit: ClockFit, tracks: TrackSpeedSeries, yaw_rates: YawRates) -> ClockFit | None:
    """Fit, refined by the lags of both halves of a log; None without a clear drift."""
    undone = fit.undone(tracks)
    stamps = undone.stamps
    middle = int(stamps[0] + stamps[-1]) // 2
    halves = (
        TrackSpeedSeries(stamps[part], undone.speeds[part])
        for part in (stamps < middle, stamps >= middle)
    )
    early, late = (track_latency(half, yaw_rates) for half in halves)
    if not (isinstance(early, Lag) and isinstance(late, Lag)):
        return None
    # Time between the middles of both halves [s], and growth of the lag per time [s/s].
    span = 0.5 * float(stamps[-1] - stamps[0]) * NANOSECOND
    growth = (late.seconds - early.seconds) / span
    refined = ClockFit(fit.offset + early.seconds - 0.5 * growth * span, fit.drift + growth)
    sigma = float(np.hypot(early.sigma, late.sigma))
    is_clear = abs(refined.drift) * span >= max(LEAST_CHANGE, CLEAR_CHANGE * sigma)
    return refined if is_clear else None


def _best_shift(by_tracks: Floats, by_gyro: Floats) -> tuple[float, float]:
    """Largest correlation of two yaw rates, of either sign, and its shift [s].

    Both are even series (n,) of period `STEP`, without their means. The shift is positive if the gyro's
    is later. The correlation is 0 if it is not clear, see `CLEAR`.
    """
    from scipy.signal import correlate

    shifts = np.arange(1 - len(by_tracks), len(by_gyro))
    # Track samples first to last (not included) overlap with the gyro's.
    first, last = np.maximum(0, -shifts), np.minimum(len(by_tracks), len(by_gyro) - shifts)
    shorter = STEP * min(len(by_tracks), len(by_gyro))
    is_long = STEP * (last - first) >= max(LEAST_OVERLAP, 0.5 * shorter)
    of_tracks, of_gyro = (
        np.concatenate([[0.0], np.cumsum(rates**2)]) for rates in (by_tracks, by_gyro)
    )
    energy = of_tracks[last] - of_tracks[first]
    energy *= of_gyro[last + shifts] - of_gyro[first + shifts]
    products = np.abs(correlate(by_gyro, by_tracks, "full", "fft"))
    correlations = np.where(is_long & (energy > 0.0), products, 0.0)
    correlations /= np.sqrt(np.maximum(energy, 1e-12))
    best = int(np.argmax(correlations))
    others = correlations[np.abs(shifts - shifts[best]) * STEP > APART]
    highest = float(correlations[best])
    is_clear = highest >= CLEAR and others.max(initial=0.0) <= NEXT * highest
    return (highest if is_clear else 0.0), STEP * float(shifts[best])


def _even_rates(stamps: Stamps, rates: Floats) -> Floats:
    """Means of a rate (n,) over steps of `STEP`, less their mean."""
    seconds = (stamps - stamps[0]) * NANOSECOND
    angle = np.interp(np.arange(0.0, seconds[-1], STEP), seconds, running_integral(stamps, rates))
    means = np.diff(angle) / STEP
    return np.asarray(means - means.mean())


def on_one_clock(mapping: TopicMap, read: Callable[[TopicMap, str], Log]) -> TopicMap:
    """Mapping of tables with offset and drift of the tracks' clock if they are clear.

    Fixes and truth that share the time of the tracks, and not that of the IMU, get the offset, too. It is
    the same object if they are not clear. `read` reads one stream of a mapping, by its purpose.
    """
    columns = mapping.columns
    if columns is None or columns.tracks is None:
        return mapping
    tracks, imu_log = read(mapping, "tracks").tracks, read(mapping, "imu")
    mounting = estimate_mounting(imu_log)
    if imu_log.imu is None or mounting is None or not are_usable(tracks):
        return mapping
    fit = clock_fit(tracks, vertical_rate(imu_log.imu, mounting))
    if fit is None or not fit.is_apart:
        return mapping
    keys = fit.keys(columns.tracks)
    changed: dict[str, Any] = {"tracks": structs.replace(columns.tracks, **keys)}
    for purpose in ("fixes", "truth"):
        stream = getattr(columns, purpose)
        if stream is not None and not stream.clock_offset:
            log = read(mapping, purpose)
            poses = log.truth.poses if log.truth is not None else log.fixes
            if (
                poses is not None
                and _share_time(poses.stamps, tracks.stamps)
                and not _share_time(poses.stamps, imu_log.imu.stamps)
            ):
                changed[purpose] = structs.replace(stream, clock_offset=keys["clock_offset"])
    return structs.replace(mapping, columns=structs.replace(columns, **changed))


def _share_time(one: Stamps, other: Stamps) -> bool:
    """Return True if two series of stamps overlap."""
    return bool(len(one) and len(other) and one[0] <= other[-1] and other[0] <= one[-1])
