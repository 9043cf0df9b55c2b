"""Lag of one series behind another, for inspect, calibrate and replay.

Changes over short windows are compared, so that drift and frames do not matter: turns of angles,
distances of places. At each candidate lag a straight line is fitted, since units, scale and bias may
differ. The cost is the mean absolute residual: jumps of a truth and slip of a track do not move its
minimum. The standard error is that of a jackknife over blocks of windows. If there is no clear lag, the
result is a `NoLag`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.lag_search import BEYOND, BLOCKS, beside_lowest, jackknife_sigma
from icreckon.estimator.log.scores import are_within, even_grid, pieces
from icreckon.estimator.log.series import ImuSeries, PoseSeries, TrackSpeedSeries, running_integral

NEAR = np.arange(-0.5, 1.2001, 0.02)  # candidate lags [s]; negative if the reference is late
FAR = np.arange(-10.0, 10.001, 0.05)  # candidate lags [s] if none of those agrees
AROUND = np.arange(-0.3, 0.3001, 0.02)  # grid about a lag of `FAR` [s]
WINDOW, SPACING = 1.0, 0.1  # length of the windows, and least distance between them [s]
FEWEST, FEWEST_FAR, MOST = 10 * BLOCKS, 300, 20_000
"""Least numbers of windows for lags of `NEAR` and `FAR`, and the most that are used."""
LARGEST_HOLE = 0.5  # windows with a longer gap between samples are excluded [s]
LEAST_AGREEMENT, LEAST_FAR = 0.1, 0.5
"""Share of the spread that the line has to explain, at lags of `NEAR` and `FAR` [-]."""
CERTAIN = 0.04  # standard error up to which an insignificant lag is reported, too [s]
LEAST_TURN, LEAST_SPEEDING = 0.02, 0.05
"""Least spread of turns [rad] and of distances [m] over the windows at which a lag is observable."""
ROUNDS = 5  # rounds of the line of least absolute residuals


class Lag(NamedTuple):
    """Lag of a series behind its reference, and its standard error [s]."""

    seconds: float
    sigma: float


class NoLag(NamedTuple):
    """Reason why the data show no lag, as the end of a sentence."""

    reason: str


NOWHERE = NoLag(
    f"nothing agrees at {NEAR[0]:g} to {NEAR[-1]:g} s, nor clearly at ten seconds either way"
)


@dataclass(frozen=True)
class Curve:
    """Angle or place over time."""

    stamps: Stamps  # (n,) [ns]
    values: Floats  # (n,) an angle, not wrapped, or (n, 2) places; in any unit

    def changes(self, origin: int, starts: Floats) -> Floats:
        """Changes (k,) over windows that begin at some times after a stamp [s]."""
        seconds = (self.stamps - origin) * NANOSECOND
        columns = self.values if self.values.ndim > 1 else self.values[:, None]
        steps = [
            np.interp(starts + WINDOW, seconds, column) - np.interp(starts, seconds, column)
            for column in columns.T
        ]
        return np.asarray(steps[0] if self.values.ndim == 1 else np.hypot(*steps))


def turned(stamps: Stamps, rates: Floats) -> Curve:
    """Angle by rates (n,), each of which is the mean since the sample before."""
    steps = np.diff(stamps) * NANOSECOND * rates[1:]
    return Curve(stamps, np.concatenate([[0.0], np.cumsum(steps)])[: len(rates)])


def heading_of(poses: PoseSeries) -> Curve:
    """Headings of a series of poses."""
    return Curve(poses.stamps, np.unwrap(poses.poses[:, 2]))


def places_of(poses: PoseSeries) -> Curve:
    """Places of a series of poses."""
    return Curve(poses.stamps, poses.poses[:, :2])


def plain_path(tracks: TrackSpeedSeries, imu: ImuSeries, rates: Floats) -> PoseSeries:
    """Path at the IMU's stamps, by yaw rates (n,) [rad/s] and the mean of both tracks."""
    yaw = turned(imu.stamps, rates).values
    ends = np.searchsorted(tracks.stamps, imu.stamps).clip(max=len(tracks.stamps) - 1)
    speed = tracks.speeds.mean(axis=1)[ends]
    velocity = speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    places = running_integral(imu.stamps, velocity)
    return PoseSeries(imu.stamps, np.column_stack([places, yaw]))


def find_lag(late: Curve, reference: Curve, *, least: float = 0.0) -> Lag | NoLag:
    """Find the lag of a series behind a reference, perhaps in another unit or frame.

    The reference's changes over the windows need a standard deviation of `least`, in its unit.

    Returns:
        The lag, or the reason why there is none: the series are too short, move too little, or do not
        agree at any lag, or the lag is insignificant with an error above `CERTAIN`.
    """
    if min(len(late.stamps), len(reference.stamps)) < 2:
        return NoLag("there are no samples")
    near = _search(late, reference, NEAR, FEWEST, LEAST_AGREEMENT, least)
    if near != NOWHERE:
        return near
    far = _search(late, reference, FAR, FEWEST_FAR, LEAST_FAR, least)
    if isinstance(far, Lag):
        far = _search(late, reference, far.seconds + AROUND, FEWEST_FAR, LEAST_FAR, least)
    return far if isinstance(far, Lag) else NOWHERE


def _search(
    late: Curve,
    reference: Curve,
    lags: Floats,
    fewest_windows: int,
    least_agreement: float,
    least_spread: float,
) -> Lag | NoLag:
    """Search an even grid of lags (m,) [s].

    `NOWHERE` if no lag agrees, or the best is at an end of the grid. Other `NoLag`s: too few windows, too
    little motion, or an insignificant lag with an error above `CERTAIN`.
    """
    origin = int(late.stamps[0])
    starts = _windows(late, reference, origin, lags)
    if len(starts) < fewest_windows:
        return NoLag(
            f"the log is too short, or its samples are more than {LARGEST_HOLE:g} s apart, with "
            f"{len(starts) * SPACING:.0f} s to compare"
        )
    late_changes = late.changes(origin, starts)
    spread = np.std(reference.changes(origin, starts))
    if spread < least_spread or np.ptp(late_changes) == 0.0:
        return NoLag("the robot turns or speeds up too little")
    shifted_changes = [reference.changes(origin, starts - lag) for lag in lags]
    residuals = np.array([_residuals(late_changes, changes) for changes in shifted_changes])
    costs = residuals.mean(axis=1)
    # R² with absolute values: 1 for a perfect line, 0 for one that is no better than the median.
    agreement = 1.0 - costs.min() / np.mean(np.abs(late_changes - np.median(late_changes)))
    if agreement < least_agreement or int(np.argmin(costs)) in (0, len(lags) - 1):
        return NOWHERE
    # Jackknife: lags from all windows but one block, for each block.
    blocks = np.array_split(np.arange(len(starts)), BLOCKS)
    costs_without = [np.delete(residuals, block, axis=1).mean(axis=1) for block in blocks]
    sigma = jackknife_sigma(np.array([_lowest(others, lags) for others in costs_without]))
    best = Lag(_lowest(costs, lags), float(sigma))
    if best.sigma > CERTAIN and abs(best.seconds) <= BEYOND * best.sigma:
        return NoLag(f"{best.seconds:.2f} ± {best.sigma:.2f} s is within its error")
    return best


def _windows(late: Curve, reference: Curve, origin: int, lags: Floats) -> Floats:
    """Starts (k,) of windows [s] that both series cover without a gap, at all lags."""
    late_s = np.asarray((late.stamps - origin) * NANOSECOND, dtype=float)
    reference_s = np.asarray((reference.stamps - origin) * NANOSECOND, dtype=float)
    low = max(late_s[0], reference_s[0] + lags[-1])
    high = min(late_s[-1], reference_s[-1] + lags[0]) - WINDOW
    starts = even_grid(low, high, max(SPACING, (high - low) / MOST), late_s)
    late_pieces, reference_pieces = (pieces(c.stamps, LARGEST_HOLE) for c in (late, reference))
    covered = are_within(late_pieces, late_s, starts, starts + WINDOW)
    # At the largest lag the reference's window begins first, at the smallest it ends last.
    begins, ends = starts - lags[-1], starts + WINDOW - lags[0]
    covered &= are_within(reference_pieces, reference_s, begins, ends)
    return np.asarray(starts[covered])


def _residuals(values: Floats, regressor: Floats) -> Floats:
    """Absolute residuals (n,) of the line with the least sum of them, by reweighting."""
    smallest = 0.01 * np.std(values)
    weights = np.ones(len(values))
    for _ in range(ROUNDS):
        weights /= weights.sum()
        x, y = regressor - weights @ regressor, values - weights @ values
        variance = weights @ x**2
        slope = weights @ (x * y) / variance if variance > 0.0 else 0.0
        residuals = np.abs(y - slope * x)
        weights = 1.0 / np.maximum(residuals, smallest)
    return np.asarray(residuals)


def _lowest(costs: Floats, lags: Floats) -> float:
    """Lag [s] of the lowest cost, refined by a parabola."""
    lowest = int(np.clip(np.argmin(costs), 1, len(lags) - 2))
    offset = float(np.clip(beside_lowest(costs, lowest), -1.0, 1.0))
    return float(lags[lowest]) + offset * float(lags[1] - lags[0])
