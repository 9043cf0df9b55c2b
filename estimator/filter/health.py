"""What became of the measurements, and which parameters they can show."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from icreckon.estimator.filter.gate import ADMITTED, REACQUIRED, REJECTED, VERDICTS

# A deviation that moves the twist by this share of the slip's standard deviation shows after some
# hundred correlation times of the slip: in a minute or so of such motion.
EXCITED = 0.1
# Why a measurement that comes late is not taken in.
TOO_OLD, HISTORY_FULL = "older than Settings.history", "history is full"
# So many judged measurements are recent.
RECENT = 100
# Stamp [ns], verdict (see `estimator.filter.gate`), residual and its covariance, see `JudgedInnovation`;
# made with each step, and plain because that is quick.
Judged = tuple[int, int, tuple[float, ...], tuple[tuple[float, ...], ...]]


class JudgedInnovation(NamedTuple):
    """A measurement against what the filter expected of it, as its gate saw the two.

    Of the gyro the residual is in rad/s, of the accelerometer (to the left) in m/s², of positions x, y in
    m, of headings in rad, of poses x, y, yaw in m and rad, of body velocities forward, left in m/s, of
    zero velocities v_x, v_y, w in m/s and rad/s. Positions and poses are in the axes of odom.

    Attributes:
        stamp: of the measurement [ns].
        verdict: "admitted", "rejected", or "reacquired": used after too many rejections in a row.
        residual: (n,) measured less expected; angles from -pi to pi.
        covariance: (n, n) that the residual should have: of the estimate and of the measurement.
    """

    stamp: int
    verdict: str
    residual: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]


@dataclass
class SensorHealth:
    """Counts of one kind of measurement.

    Attributes:
        used: how many updated the filter.
        rejected: reason -> how many did not.
        nis_sum: sum of the normalised innovations squared of those that were used.
        degrees: sum of their degrees of freedom, which `nis_sum` should be near.
        late: how many came after newer ones and were taken in at their own stamps.
        judged_count: how many the gate has judged.
        newest_nis: normalised innovation squared of the newest that it has judged; None before.
        recent_nis: mean over the newest hundred or so of them, those that were rejected included, per
            degree of freedom; None before the first.
        newest_judged: the newest that it has judged, for `newest`; None before.
        reacquired: how many were used after too many rejections in a row, whatever they said.
    """

    used: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    nis_sum: float = 0.0
    degrees: int = 0
    late: int = 0
    judged_count: int = 0
    newest_nis: float | None = None
    recent_nis: float | None = None
    newest_judged: Judged | None = None
    reacquired: int = 0

    @property
    def too_late(self) -> int:
        """How many came too late to be taken in; they are among those `rejected`, and not `late`."""
        return self.rejected.get(TOO_OLD, 0) + self.rejected.get(HISTORY_FULL, 0)

    @property
    def newest(self) -> JudgedInnovation | None:
        """The innovation of the newest that the gate has judged; None before."""
        if self.newest_judged is None:
            return None
        stamp, verdict, residual, covariance = self.newest_judged
        return JudgedInnovation(stamp, VERDICTS[verdict], residual, covariance)

    @property
    def nis_per_degree(self) -> float:
        """Mean NIS per degree of freedom; 1 when the filter's uncertainty is right, NaN if unused."""
        return self.nis_sum / self.degrees if self.degrees else float("nan")

    def reject(self, reason: str) -> None:
        """Count one that did not update the filter."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

    def judged(
        self,
        verdict: int,
        nis: float,
        degrees: int = 1,
        judged: Judged | None = None,
    ) -> bool:
        """Count what a gate has judged; whether it was used.

        Args:
            verdict: see `estimator.filter.gate`.
            nis: normalised innovation squared.
            degrees: its degrees of freedom.
            judged: the innovation itself.
        """
        self.newest_judged = judged
        self.judged_count += 1
        self.newest_nis = nis
        before = self.recent_nis or 0.0
        self.recent_nis = before + (nis / degrees - before) / min(self.judged_count, RECENT)
        if verdict == REJECTED:
            self.reject("gate")
            return False
        if verdict == ADMITTED:
            self.nis_sum += nis
            self.degrees += degrees
        elif verdict == REACQUIRED:
            self.reacquired += 1
        self.used += 1
        return True

    def copy(self) -> SensorHealth:
        """The same counts, on their own."""
        return SensorHealth(
            self.used,
            self.rejected.copy(),
            self.nis_sum,
            self.degrees,
            self.late,
            self.judged_count,
            self.newest_nis,
            self.recent_nis,
            self.newest_judged,
            self.reacquired,
        )

    def add(self, other: SensorHealth) -> None:
        """Count what the other has counted, too."""
        self.used += other.used
        for reason, count in other.rejected.items():
            self.rejected[reason] = self.rejected.get(reason, 0) + count
        self.nis_sum += other.nis_sum
        self.degrees += other.degrees
        self.late += other.late
        self.reacquired += other.reacquired
        if self.judged_count < other.judged_count:
            self.newest_nis, self.recent_nis = other.newest_nis, other.recent_nis
            self.newest_judged = other.newest_judged
        self.judged_count += other.judged_count


@dataclass
class Health:
    """Counts of all kinds of measurements, by name, and of what the filter has made of them.

    Attributes:
        sensors: by name.
        standstill_updates: how many IMU samples of a robot that was found standing.
        track_gaps: how many gaps in the track speeds were bridged, longer than `Settings.hold`.
        stuck_tracks: how often the sensor of a track was found stuck.
        clock_steps: how often the clock of all sensors was found set back; the estimate goes on by it.
    """

    sensors: dict[str, SensorHealth] = field(default_factory=dict)
    standstill_updates: int = 0
    track_gaps: int = 0
    stuck_tracks: int = 0
    clock_steps: int = 0

    def sensor(self, name: str) -> SensorHealth:
        """The counts of one kind, made when first asked for."""
        found = self.sensors.get(name)
        if found is None:
            found = self.sensors[name] = SensorHealth()
        return found

    def rejections(self) -> dict[str, int]:
        """How many measurements were rejected, by "sensor: reason"."""
        return {
            f"{name}: {reason}": count
            for name, sensor in self.sensors.items()
            for reason, count in sorted(sensor.rejected.items())
        }

    def copy(self) -> Health:
        """The same counts, on their own."""
        sensors = {name: sensor.copy() for name, sensor in self.sensors.items()}
        return Health(
            sensors,
            self.standstill_updates,
            self.track_gaps,
            self.stuck_tracks,
            self.clock_steps,
        )

    def add(self, other: Health) -> None:
        """Count what the other has counted, too."""
        for name, sensor in other.sensors.items():
            self.sensor(name).add(sensor)
        self.standstill_updates += other.standstill_updates
        self.track_gaps += other.track_gaps
        self.stuck_tracks += other.stuck_tracks
        self.clock_steps += other.clock_steps


@dataclass(frozen=True)
class ParameterHealth:
    """How well one of the parameters is known, and whether the present motion shows it.

    Attributes:
        sigma: its standard deviation now, in its own unit (docs/model.md).
        sigma_at_start: the variant's, before anything was learnt; 0 where it does not estimate it.
        excitation: how far a deviation by `sigma_at_start` moves the twist at the present track
            speeds, in standard deviations of the slip of that component which it moves most [-].
    """

    sigma: float
    sigma_at_start: float
    excitation: float

    @property
    def share(self) -> float:
        """`sigma` over `sigma_at_start`: 1 where nothing was learnt, NaN where it is not estimated."""
        return self.sigma / self.sigma_at_start if self.sigma_at_start else math.nan

    @property
    def excited(self) -> bool:
        """Whether the present motion shows the parameter: `excitation` of at least `EXCITED`."""
        return self.excitation >= EXCITED
