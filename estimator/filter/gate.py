"""Chi-square gates with re-acquisition.

A wrong measurement cannot capture the filter, and a right one cannot be rejected for ever: after some
time of rejections the next one is used. A position has to wait for longer, the further it is away: a
robot that was carried, or that slid, has moved at some speed.
"""

import math
from collections.abc import Callable, Mapping, Sized
from typing import Annotated, Any

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.records import NEVER, Count, Size, Stamp, zeros
from icreckon.estimator.filter.health import ADMITTED, REACQUIRED, REJECTED, Judged, SensorHealth
from icreckon.estimator.log.measurements import Vector3
from icreckon.estimator.robot.settings import GateSettings

# Quantiles of the chi-square distribution at a right-tail probability of 1e-4, by degrees of freedom
# (scipy.stats.chi2.isf, which is not imported here for the sake of a light library).
CHI_SQUARE_1E4 = {1: 15.137, 2: 18.421, 3: 21.108}

# Modes of an update with a fix: none, with the gate, or re-acquisition whatever its innovation is.
SKIPPED, GATED, FORCED = range(3)
MOST = max(CHI_SQUARE_1E4)  # largest number of components of an innovation
RECENT = 100  # number of gated measurements that are recent
# Most of `GateSettings.patience` that counts for samples of the IMU [s]: less than one sample lasts, so
# the second in a row is used. Tracks that slip make samples unexpected more often than a faulty IMU does.
IMU_PATIENCE = 1e-3
LONGEST_COUNTED = 1.0  # most that a rejected fix counts of the time since the fix before it [s]
LARGEST_PATIENCE_FACTOR = 6.0  # largest factor on the patience by the distance of a position
# Largest inflation, over the variance of the innovation: next to more, double precision would lose it.
LARGEST_INFLATION = 1e10


def patience_for(squared_distance: Any, patience: Any, fastest: Any) -> Any:
    """Time of rejections [s] until a position at a squared distance [m²] is used."""
    driving_time = math.sqrt(squared_distance) / fastest
    return max(patience, min(LARGEST_PATIENCE_FACTOR * patience, driving_time))


def inflation(square: float, expected: float) -> float:
    """Variance to add to a state: square of an innovation, limited by its variance."""
    return min(square, LARGEST_INFLATION * expected)


class GateRecord(msgspec.Struct):
    """Counts of one gate, and the newest innovation that it tested."""

    rejected_for: Size = 0.0  # time of the rejections since a measurement was last used [s]
    judged: Count = 0  # number of measurements that it tested
    used: Count = 0  # number of measurements that it let pass
    rejected: Count = 0  # number of measurements that it rejected
    reacquired: Count = 0  # number of measurements used after too long a time of rejections
    degrees: Count = 0  # sum of the degrees of freedom of admitted measurements
    nis_sum: Size = 0.0  # sum of their normalised innovations squared (NIS)
    newest_nis: float = 0.0  # NIS of the newest measurement
    recent_nis: float = 0.0  # mean NIS per degree of freedom of the newest hundred or so
    stamp: Stamp = NEVER  # stamp of the newest measurement [ns], or NEVER
    verdict: Annotated[int, msgspec.Meta(ge=ADMITTED, le=REACQUIRED)] = ADMITTED  # verdict on it
    # its innovation (n,); the rest is unused
    z: Annotated[list[float], msgspec.Meta(min_length=MOST, max_length=MOST)] = zeros(MOST)
    # its innovation covariance (n, n) in rows; the rest is unused
    S: Annotated[list[float], msgspec.Meta(min_length=MOST**2, max_length=MOST**2)] = zeros(MOST**2)


def count_verdict(
    counts: GateRecord, verdict: int, nis: float, degrees: int, interval: float
) -> None:
    """Count a verdict; a rejection counts an interval [s]. Plain Python, also numba."""
    counts.judged += 1
    counts.newest_nis = nis
    counts.recent_nis += (nis / degrees - counts.recent_nis) / min(counts.judged, RECENT)
    if verdict == REJECTED:
        counts.rejected_for += interval
        counts.rejected += 1
        return
    counts.rejected_for = 0.0
    counts.used += 1
    if verdict == ADMITTED:
        counts.nis_sum += nis
        counts.degrees += degrees
    else:
        counts.reacquired += 1


class Gate:
    """Gate of one sensor.

    Args:
        degrees: number of components of the innovation.
        patience: time of rejections after which the next measurement is re-acquired [s].
        counts: its counts; None to start again.
    """

    def __init__(self, degrees: int, patience: float, counts: GateRecord | None = None) -> None:
        self._degrees, self.threshold = degrees, CHI_SQUARE_1E4[degrees]
        self.patience = patience
        self.counts = GateRecord() if counts is None else counts

    def judge(self, nis: float, interval: float, patience: float | None = None) -> int:
        """Return the verdict on a normalised innovation squared, and count it.

        A rejection counts `interval` [s]; re-acquisition is after `patience` [s], by default the gate's.
        """
        counts, verdict = self.counts, ADMITTED
        if not nis <= self.threshold:
            limit = self.patience if patience is None else patience
            verdict = REACQUIRED if counts.rejected_for >= limit else REJECTED
        count_verdict(counts, verdict, nis, self._degrees, interval)
        return verdict

    def count(
        self, stamp: int, verdict: int, z: tuple[float, float], S: Vector3, interval: float
    ) -> None:
        """Count the verdict on a position fix at a stamp [ns].

        Its innovation z [m] has the covariance S, xx, xy and yy [m²]. A rejection counts `interval` [s].
        """
        (z_x, z_y), (xx, xy, yy) = z, S
        nis = (z_x * (z_x * yy - z_y * xy) + z_y * (z_y * xx - z_x * xy)) / (xx * yy - xy * xy)
        count_verdict(self.counts, verdict, nis, self._degrees, interval)
        self.keep(stamp, verdict, np.array(z), np.array([[xx, xy], [xy, yy]]))

    def interval_to(self, stamp: int) -> float:
        """Time from the last measurement to a stamp [ns], at most `LONGEST_COUNTED` [s]."""
        if self.counts.stamp == NEVER:
            return 0.0
        # A clock that was set back has left a later stamp.
        return max(0.0, min(LONGEST_COUNTED, (stamp - self.counts.stamp) * NANOSECOND))

    def keep(self, stamp: int, verdict: int, z: Floats, S: Floats) -> None:
        """Keep the newest innovation z (n,), and its covariance S (n, n)."""
        counts, n = self.counts, self._degrees
        counts.stamp, counts.verdict = stamp, verdict
        counts.z[:n], counts.S[: n * n] = z.tolist(), S.ravel().tolist()

    @property
    def newest(self) -> Judged | None:
        """Newest innovation; None before the first."""
        counts, n = self.counts, self._degrees
        if counts.stamp == NEVER:
            return None
        S = counts.S[: n * n]
        rows = tuple(tuple(S[k : k + n]) for k in range(0, n * n, n))
        return counts.stamp, counts.verdict, tuple(counts.z[:n]), rows

    def health(self) -> SensorHealth:
        """Counts as users see them."""
        counts = self.counts
        return SensorHealth(
            used=counts.used,
            rejected={"gate": counts.rejected} if counts.rejected else {},
            nis_sum=counts.nis_sum,
            degrees=counts.degrees,
            judged_count=counts.judged,
            newest_nis=counts.newest_nis,
            recent_nis=counts.recent_nis,
            newest_judged=self.newest,
            reacquired=counts.reacquired,
        )


def gates_of(
    components: Mapping[str, Sized],
    settings: GateSettings,
    records: Mapping[str, GateRecord],
    make_record: Callable[[GateRecord], GateRecord],
) -> dict[str, Gate]:
    """Make the gates of all sensors, by the names of their components.

    Gates of the IMU have their counts in `records`; counts of others are made by `make_record`.
    """
    gates = {}
    for name, component_names in components.items():
        patience = imu_patience(settings) if name in records else settings.patience
        counts = records.get(name) or make_record(GateRecord())
        gates[name] = Gate(len(component_names), patience, counts)
    return gates


def imu_patience(settings: GateSettings) -> float:
    """Patience with samples of the IMU [s]."""
    return min(IMU_PATIENCE, settings.patience)
