"""First estimates of wheels, units and standstills from a log, without a filter."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.lag_search import BLOCKS, jackknife_sigma
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.scores import even_grid
from icreckon.estimator.log.series import running_integral
from icreckon.replay.inspection import imu_mounting

GRAVITY = 9.81
WRONG_GRAVITY = 0.03
"""Relative error of the mean specific force from which it is suspicious [-]."""
DEGREES = (20.0, 180.0)
"""Ratio range to the odometry's yaw rates at which rates are in degrees (57.3, with some slip)."""
TOO_MUCH_TURNING = 2.5
"""Factor by which slip hardly makes odometry overestimate the yaw rate [-]."""
STRAIGHT = 1.0
"""Largest turning within a window at which its path is assumed an arc [rad]."""
WINDOWS = {"truth": 2.0, "fixes": 10.0}
FEWEST_WINDOWS = 5
FEWEST_SAMPLES = 100
"""Samples from which on a standard error of the effective track is estimated."""
COURSE_LENGTH, COURSE_TIME, CLEAR_COURSE = 0.5, 5.0, 0.8
"""Course over ground: least distance [m], longest time [s]; least mean vector of its offsets [-]."""


class WheelEstimates(NamedTuple):
    """Estimates of the wheels from ground distance and gyro; None if unknown."""

    # distance over ground over that of the track speeds: the effective radius [m] if these are
    # rates [rad/s], otherwise 1 [-]
    way_ratio: float | None
    way_source: str  # source of the distance over ground, "truth" or "fixes"
    # V_r - V_l over the yaw rate: effective track over effective radius [-] if track speeds are
    # rates, otherwise the effective track [m]
    track_ratio: float | None
    way_sigma: float | None = None  # standard error of `way_ratio`, or None
    track_sigma: float | None = None  # standard error of `track_ratio`, or None


NO_WHEELS = WheelEstimates(None, "", None)


def wheel_estimates(
    log: Log, vertical: Floats | None, correlation: float | None, straight: float = STRAIGHT
) -> WheelEstimates:
    """Estimate the effective radius and track; track speeds may be rates.

    `vertical` (n,) is the rate about the vertical at the IMU's stamps [rad/s], `correlation` that with
    V_r - V_l. Windows that turn by more than `straight` [rad] do not count for the radius.
    """
    if vertical is None or log.imu is None or not imu_mounting.are_usable(log.tracks):
        return NO_WHEELS
    track_ratio = track_sigma = None
    if (correlation or 0.0) > imu_mounting.CLEAR_TURNING:
        speeds = log.tracks.speeds
        difference = np.interp(log.imu.stamps, log.tracks.stamps, speeds[:, 1] - speeds[:, 0])
        track_ratio, track_sigma = _turning_ratio(vertical, difference)
    if log.truth is not None:
        source, stamps, places = "truth", log.truth.poses.stamps, log.truth.poses.poses[:, :2]
    elif log.fixes is not None:
        source, stamps, places = "fixes", log.fixes.stamps, log.fixes.poses[:, :2]
    else:
        return WheelEstimates(None, "", track_ratio, track_sigma=track_sigma)
    ratio, sigma = _distance_ratio(log, vertical, stamps, places, WINDOWS[source], straight)
    return WheelEstimates(ratio, source, track_ratio, sigma, track_sigma)


def _turning_ratio(vertical: Floats, difference: Floats) -> tuple[float, float | None]:
    """Ratio of V_r - V_l to the yaw rate by linear regression, and its standard error."""

    def ratio(rows: NDArray[np.int_]) -> float:
        turning = difference[rows]
        return float(np.var(turning, ddof=1) / np.cov(vertical[rows], turning)[0, 1])

    if len(vertical) < FEWEST_SAMPLES:
        return ratio(np.arange(len(vertical))), None
    with np.errstate(divide="ignore", invalid="ignore"):
        value, sigma = jackknifed(ratio, len(vertical))
    return value, sigma if np.isfinite(sigma) else None


def jackknifed(estimate: Callable[[NDArray[np.int_]], float], count: int) -> tuple[float, float]:
    """Estimate from all rows, and its standard error: blocks are left out in turn."""
    every = np.arange(count)
    without = [estimate(np.delete(every, one)) for one in np.array_split(every, BLOCKS)]
    return estimate(every), float(jackknife_sigma(np.array(without)))


def _distance_ratio(
    log: Log, vertical: Floats, stamps: Stamps, places: Floats, window: float, turning: float
) -> tuple[float | None, float | None]:
    """Median ratio of chord to track distance over windows [s], and its error."""
    assert log.imu is not None  # noqa: S101 - checked by the caller
    start, end = max(stamps[0], log.start), min(stamps[-1], log.end)
    edges = even_grid(start, end, round(window / NANOSECOND), stamps)
    if len(edges) < FEWEST_WINDOWS + 1:
        return None, None
    mean = log.tracks.speeds.mean(axis=1)
    tracks, imu = log.tracks.stamps, log.imu.stamps
    distance = np.interp(edges, tracks, running_integral(tracks, mean))
    turned, yaw = (
        np.interp(edges, imu, running_integral(imu, rate)) for rate in (np.abs(vertical), vertical)
    )
    places_at_edges = np.column_stack([np.interp(edges, stamps, column) for column in places.T])
    # Ratio of chord to arc for this turning.
    shortened = np.sinc(np.diff(yaw) / (2.0 * np.pi))
    chords, arcs = (
        np.hypot(*np.diff(places_at_edges, axis=0).T),
        np.abs(np.diff(distance)) * shortened,
    )
    gaps = np.diff(np.searchsorted(stamps, edges)) < 2
    straight = (np.diff(turned) < turning) & (arcs > 0.3 * np.abs(mean).max() * window) & ~gaps
    if straight.sum() < FEWEST_WINDOWS:
        return None, None
    ratios = chords[straight] / arcs[straight]
    if len(ratios) < 2 * BLOCKS:
        return float(np.median(ratios)), None
    return jackknifed(lambda rows: float(np.median(ratios[rows])), len(ratios))


def standstills(log: Log) -> list[tuple[float, float]]:
    """Standstills of a second or more: (start, end) since the log's start [s]."""
    if not len(log.tracks.stamps):
        return []
    still = imu_mounting.standstill(log.tracks, log.tracks.stamps)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    stops = []
    for first, end in edges.reshape(-1, 2):
        begin, finish = (
            (int(log.tracks.stamps[place]) - log.start) * NANOSECOND for place in (first, end - 1)
        )
        stops.append(
            (max(0.0, begin - imu_mounting.STILL_MARGIN), finish + imu_mounting.STILL_MARGIN)
        )
    return stops


def turning_suspicion(log: Log, vertical: Floats, gauge: float = 1.0) -> list[str]:
    """Compare the spread of the odometry's yaw rate with the gyro's; note a misfit.

    `vertical` (n,) is the rate about the vertical at the IMU's stamps [rad/s], `gauge` [m] the one with
    which track speeds were computed from the twist.
    """
    turning = float((log.tracks.speeds[:, 1] - log.tracks.speeds[:, 0]).std()) / gauge
    gyro = float((vertical - vertical.mean()).std())
    if not (turning > 0.0 and gyro > 0.0):
        return []
    if DEGREES[0] < gyro / turning < DEGREES[1]:
        return [f"the gyro reads {gyro / turning:.0f} times the odometry's yaw rate; in deg/s?"]
    if turning / gyro > TOO_MUCH_TURNING:
        return [
            f"the odometry's yaw rate is {turning / gyro:.1f} times the gyro's, more than slip explains;"
            " is the gauge of its controller known?"
        ]
    return []


def unit_of_gravity(force: float) -> str:
    """Question about the likely unit of a mean specific force; empty without a guess."""
    for unit, size in (("g", 1.0), ("mg", 1000.0), ("cm/s²", 981.0), ("ft/s²", 32.2)):
        if abs(force - size) <= 0.015 * size or (unit == "g" and abs(force - size) < 0.05):
            return f"; in {unit}?"
    return ""


def heading_offset(log: Log) -> float | None:
    """Offset from measured heading to course over ground [deg]; None if not clear."""
    headings = [one for one in log.others if isinstance(one, HeadingFix)]
    if log.fixes is None or len(log.fixes.stamps) < 2 or len(headings) < 2:
        return None
    stamps, places = log.fixes.stamps, log.fixes.poses[:, :2]
    sigma = float(np.sqrt(np.median(log.fixes.variances[:, 0])))
    offsets = []
    last = 0
    for place in range(1, len(stamps)):
        step = places[place] - places[last]
        if np.hypot(*step) < max(COURSE_LENGTH, 5.0 * sigma):
            continue
        seconds = (stamps[place] - stamps[last]) * NANOSECOND
        if seconds < COURSE_TIME:
            at = (stamps[place] + stamps[last]) // 2
            nearest = min(headings, key=lambda one: abs(one.stamp - at))
            offsets.append(np.exp(1j * (np.arctan2(step[1], step[0]) - nearest.yaw)))
        last = place
    if len(offsets) < FEWEST_WINDOWS:
        return None
    mean = complex(np.mean(offsets))
    return float(np.degrees(np.angle(mean))) if abs(mean) > CLEAR_COURSE else None
