"""Latency of track speeds and headings against the gyro, from yaw changes.

Drivers report a speed that was averaged, filtered or sampled earlier, and loggers repeat it until the
next one. A latency of 0.2 s at a start or stop is an error of 0.2 s of driving, which exceeds the effect
of slip in that time. The estimate needs neither truth nor fixes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.lag_search import BEYOND, BLOCKS, beside_lowest, jackknife_sigma
from icreckon.estimator.log.scores import even_grid, pieces
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries

LATENCIES = np.arange(-0.5, 1.0, 0.02)
"""Grid of candidate latencies [s]; negative if the gyro is late."""
WINDOW, WINDOW_STEP = 1.0, 0.1
"""Length and spacing of the windows over which yaw changes are compared [s]."""
LEAST_TURNING = 0.02
"""Smallest yaw change in the windows, root mean square, at which a latency is observable [rad]."""
LARGEST_HOLE = 0.5
"""Windows with a longer gap between samples are omitted [s]."""
TRIMMED_SHARE = 0.8
"""Share of the windows that is used: those with the smallest residuals."""
LEAST_CORRELATION = 0.7
"""Smallest correlation of tracks and gyro at which a latency is estimated [-]."""
LEAST = 0.03
"""Smallest size of a latency that is proposed [s]."""


class Latency(NamedTuple):
    """Latency of one sensor's stamps against another's.

    Attributes:
        seconds: estimate [s].
        sigma: its standard error [s].
    """

    seconds: float
    sigma: float

    @property
    def clear(self) -> bool:
        """True if the latency is beyond its error and large enough to be corrected."""
        return not self.reason

    @property
    def reason(self) -> str:
        """Reason not to correct the latency, empty if there is none."""
        if abs(self.seconds) <= BEYOND * self.sigma:
            return "within its error"
        return "" if abs(self.seconds) > LEAST else f"less than {LEAST:g} s"


def track_latency(tracks: TrackSpeedSeries, imu: ImuSeries, vertical: Floats) -> Latency | None:
    """Estimate the latency of track speeds against the gyro.

    Args:
        tracks: the track speeds, in any unit; each holds until the next.
        imu: the IMU, for its stamps.
        vertical: (n,) its rate about the vertical [rad/s].

    Returns:
        The latency, or None if it is not observable: the log is too short, there is too little turning,
        or tracks and gyro disagree.
    """
    if len(tracks.stamps) < 2:
        return None
    difference = tracks.speeds[:, 1] - tracks.speeds[:, 0]
    steps = np.diff(tracks.stamps) * NANOSECOND
    angle = np.concatenate([[0.0], np.cumsum(steps * difference[:-1])])
    return _latency(tracks.stamps, angle, imu, vertical)


def heading_latency(
    stamps: Stamps, yaw: Floats, imu: ImuSeries, vertical: Floats
) -> Latency | None:
    """Estimate the latency of a heading against the gyro; None as for `track_latency`.

    Args:
        stamps: (m,) stamps of the heading [ns].
        yaw: (m,) the heading [rad].
        imu: the IMU, for its stamps.
        vertical: (n,) its rate about the vertical [rad/s].
    """
    return _latency(stamps, np.unwrap(yaw), imu, vertical)


def _latency(stamps: Stamps, angle: Floats, imu: ImuSeries, vertical: Floats) -> Latency | None:
    """Estimate the latency of an angle (m,), in any unit, against the integrated gyro."""
    if len(stamps) < 2 or len(imu.stamps) < 2:
        return None
    margin = float(np.abs(LATENCIES).max())
    origin = max(stamps[0], imu.stamps[0])
    end = (min(stamps[-1], imu.stamps[-1]) - origin) * NANOSECOND - margin - WINDOW
    starts = even_grid(margin, end, WINDOW_STEP, (imu.stamps - origin) * NANOSECOND)
    starts = starts[_whole(stamps, origin, starts, margin) & _whole(imu.stamps, origin, starts)]
    if len(starts) < 10 * BLOCKS:
        return None
    steps = np.diff(imu.stamps) * NANOSECOND * 0.5 * (vertical[1:] + vertical[:-1])
    turned = _turned(imu.stamps, np.concatenate([[0.0], np.cumsum(steps)]), origin, starts)
    if np.sqrt(np.mean(turned**2)) < LEAST_TURNING:
        return None
    shifted = np.stack([_turned(stamps, angle, origin, starts + late) for late in LATENCIES])
    best = _best(turned, shifted)
    if best is None or best.correlation < LEAST_CORRELATION:
        return None
    blocks = np.array_split(np.arange(len(starts)), BLOCKS)
    parts = [_best(np.delete(turned, block), np.delete(shifted, block, axis=1)) for block in blocks]
    values = np.array([part.latency for part in parts if part is not None])
    if len(values) < BLOCKS:
        return None
    return Latency(best.latency, jackknife_sigma(values))


class _Best(NamedTuple):
    latency: float
    correlation: float


def _best(turned: Floats, shifted: Floats) -> _Best | None:
    """Latency of the smallest misfit of a straight line, refined by a parabola."""
    misfits = np.array([_misfit(turned, row) for row in shifted])
    if not np.isfinite(misfits).all():
        return None
    at = int(np.argmin(misfits))
    if at in (0, len(LATENCIES) - 1):
        return None
    latency = LATENCIES[at] + beside_lowest(misfits, at) * (LATENCIES[1] - LATENCIES[0])
    return _Best(float(latency), float(np.corrcoef(turned, shifted[at])[0, 1]))


def _misfit(turned: Floats, other: Floats) -> float:
    keep = np.ones(len(turned), dtype=bool)
    misfit = turned
    for _ in range(3):
        if np.ptp(other[keep]) == 0.0:
            return np.inf
        slope, offset = np.polyfit(other[keep], turned[keep], 1)
        misfit = np.abs(turned - slope * other - offset)
        keep = misfit <= np.quantile(misfit, TRIMMED_SHARE)
    return float(np.mean(misfit[keep] ** 2))


def _turned(stamps: Stamps, angle: Floats, origin: int, starts: Floats) -> Floats:
    """Change of an angle within the windows."""
    seconds = (stamps - origin) * NANOSECOND
    return np.asarray(
        np.interp(starts + WINDOW, seconds, angle) - np.interp(starts, seconds, angle)
    )


def _whole(stamps: Stamps, origin: int, starts: Floats, margin: float = 0.0) -> NDArray[np.bool_]:
    """Mask of the windows that, widened by a margin, have no gap in the stamps."""
    seconds = (stamps - origin) * NANOSECOND
    holes = pieces(stamps, LARGEST_HOLE)
    first = np.searchsorted(seconds, starts - margin, side="right") - 1
    last = np.searchsorted(seconds, starts + WINDOW + margin)
    return np.asarray(holes[np.clip(first, 0, None)] == holes[np.minimum(last, len(holes) - 1)])
