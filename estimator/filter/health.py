"""Health: counts of measurements, innovations, excitation of parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.records import Count, Size
from icreckon.estimator.faults.failed_gyro import BEYOND, JUMPED, REPEATS
from icreckon.estimator.filter.fault_table import (
    GYRO_FAULTS,
    REPEATED,
    Finding,
    findings_of,
    refused_stream,
    times_of,
)
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import Imu
from icreckon.estimator.sensors.imu_noise import NoiseRecord, imu_noise, measured_noise
from icreckon.estimator.sensors.imu_tilt import TiltRecord, tilt_of
from icreckon.estimator.sensors.input_settings import InputSettings
from icreckon.estimator.sensors.standstill import tracks_rest

# Verdicts of a gate. A re-acquired measurement is used after the variance of the states that it measures
# was inflated.
ADMITTED, REJECTED, REACQUIRED = range(3)
VERDICTS = ("admitted", "rejected", "reacquired")
# An error of a parameter that changes the twist by this share of the slip's standard deviation is
# observable after some hundred correlation times of the slip: about a minute of such motion.
EXCITED = 0.1
# Reasons to reject a late measurement.
TOO_OLD, HISTORY_FULL = "older than Settings.history", "history is full"
# Tilt of a wrong mounting, in standard deviations of the robot file's levelling plus of the estimate, and
# largest standard deviation of a known tilt [rad].
TILTED, KNOWN_TILT = 5.0, 0.02
# Stamp [ns], verdict, innovation and its covariance, see `JudgedInnovation`.
Judged = tuple[int, int, tuple[float, ...], tuple[tuple[float, ...], ...]]


class JudgedInnovation(NamedTuple):
    """Innovation of a gated measurement, and the verdict of its gate.

    Components by sensor: gyro [rad/s]; accelerometer_x forward, _y left [m/s²]; position x, y [m];
    heading [rad]; pose x, y [m], yaw [rad]; body velocity forward, left [m/s]; zero velocity v_x, v_y
    [m/s], w [rad/s]. Positions and poses are in the axes of odom.

    Attributes:
        stamp: stamp of the measurement [ns].
        verdict: "admitted", "rejected", or "reacquired": used after too long a time of rejections.
        residual: (n,) innovation, measured less predicted; angles from -pi to pi.
        covariance: (n, n) innovation covariance S: of the prediction and of the measurement.
    """

    stamp: int
    verdict: str
    residual: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]


@dataclass
class SensorHealth:
    """Counts of one sensor.

    Attributes:
        used: number of measurements that updated the filter.
        rejected: reason -> number of measurements that did not.
        nis_sum: sum of the normalised innovations squared (NIS) of admitted measurements.
        degrees: sum of their degrees of freedom, the expectation of `nis_sum`.
        late: number of measurements that came after newer ones and were judged at their own stamps.
        judged_count: number of measurements that the gate tested.
        newest_nis: NIS of the newest of these; None before the first.
        recent_nis: mean NIS per degree of freedom of the newest hundred or so of these, rejected ones
            included; None before the first.
        newest_judged: innovation of the newest of these, for `newest`; None before the first.
        reacquired: number of measurements that were used after too long a time of rejections.
    """

    used: Count = 0
    rejected: dict[str, Count] = field(default_factory=dict)
    nis_sum: Size = 0.0
    degrees: Count = 0
    late: Count = 0
    judged_count: Count = 0
    newest_nis: float | None = None
    recent_nis: float | None = None
    newest_judged: Judged | None = None
    reacquired: Count = 0

    @property
    def too_late(self) -> int:
        """Number of measurements that came too late; counted in `rejected`, not in `late`."""
        return self.rejected.get(TOO_OLD, 0) + self.rejected.get(HISTORY_FULL, 0)

    @property
    def newest(self) -> JudgedInnovation | None:
        """Innovation of the newest gated measurement; None before the first."""
        if self.newest_judged is None:
            return None
        stamp, verdict, residual, covariance = self.newest_judged
        return JudgedInnovation(stamp, VERDICTS[verdict], residual, covariance)

    @property
    def nis_per_degree(self) -> float:
        """Mean NIS per degree of freedom; 1 if consistent, NaN if unused."""
        return self.nis_sum / self.degrees if self.degrees else float("nan")

    def reject(self, reason: str) -> None:
        """Count a measurement that did not update the filter."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

    def take_back(self, reason: str) -> None:
        """Take back a call of `reject`."""
        self.rejected[reason] -= 1
        if not self.rejected[reason]:
            del self.rejected[reason]

    def copy(self) -> SensorHealth:
        """Copy the counts."""
        return replace(self, rejected=self.rejected.copy())


@dataclass(frozen=True)
class TrackLatencyHealth:
    """Latency of the track speeds' stamps.

    Attributes:
        used: latency that is subtracted from the stamps [s].
        estimated: estimate from turning, by gyro and tracks; None before there was enough (5 rad) [s].
        sigma: standard error of `estimated` [s].
    """

    used: float = 0.0
    estimated: float | None = None
    sigma: float | None = None


class NoiseHealth(NamedTuple):
    """Noise density of one axis of the IMU.

    Units are rad/s/√Hz for the gyro and m/s²/√Hz for the accelerometers.

    Attributes:
        measured: from the differences of the newest readings; None before there are any.
        of_file: in the robot file.
        assumed: in the filter: the file's density, unless the measured density differs clearly.
    """

    measured: float | None
    of_file: float
    assumed: float


def noise_health(
    record: NoiseRecord, at_rest: bool, settings: InputSettings
) -> dict[str, NoiseHealth]:
    """Noise of each axis of an IMU, by the name of its sensor.

    While the tracks rest (`at_rest`), the assumed noise follows a measured one sooner.
    """
    health, accelerometer_density = {}, settings.accelerometer_noise_density
    for name, squared_density in imu_noise(record, at_rest, settings)._asdict().items():
        measured = measured_noise(getattr(record, name)) or None  # 0 before there is one
        of_file = settings.gyro_noise_density if name == "gyro" else accelerometer_density
        health[name] = NoiseHealth(measured, of_file, math.sqrt(squared_density))
    return health


class TiltHealth(NamedTuple):
    """Tilt of the IMU beyond that of the robot file, by its gyros in turns.

    Attributes:
        roll_deg: to be added to the roll of `rotation_rpy_deg` [deg].
        pitch_deg: to be added to its pitch [deg].
        sigma_deg: standard deviation of each [deg].
        is_wrong: True if they are beyond what the robot file expects: five times the angle that looks
            like `accelerometer_bias_sigma`.
    """

    roll_deg: float
    pitch_deg: float
    sigma_deg: float
    is_wrong: bool

    @property
    def text(self) -> str:
        """Text for people."""
        return f"roll {self.roll_deg:+.1f}, pitch {self.pitch_deg:+.1f} deg, +- {self.sigma_deg:.1f} deg"


def tilt_health(sums: TiltRecord, imu: Imu) -> TiltHealth | None:
    """Tilt of the IMU; None while it is not known, or with a gyro of one axis."""
    tilt = tilt_of(sums)
    if tilt is None or tilt.sigma > KNOWN_TILT:
        return None
    levelling_sigma = imu.accelerometer_bias_sigma / GRAVITY
    is_wrong = max(abs(tilt.roll), abs(tilt.pitch)) > TILTED * (levelling_sigma + tilt.sigma)
    roll, pitch, sigma = map(math.degrees, tilt)
    return TiltHealth(roll, pitch, sigma, is_wrong)


class WanderHealth(NamedTuple):
    """Estimated wander of the position fixes, at the newest of them.

    Attributes:
        x: part of the fixes' error that wanders, along x of `odom` [m].
        y: along y [m].
        sigma: standard deviation of the estimate, the larger of the two [m].
    """

    x: float
    y: float
    sigma: float

    @property
    def text(self) -> str:
        """Text for people."""
        return f"x {self.x:+.2f} m, y {self.y:+.2f} m, +- {self.sigma:.2f} m"


def wander_health(x: Floats, P: Floats) -> WanderHealth | None:
    """Wander of the fixes in a state (n,) and covariance (n, n), or None."""
    if len(x) == s.SIZE:
        return None
    variance = float(P.diagonal()[s.WANDER].max())
    return WanderHealth(x.item(s.WANDER_X), x.item(s.WANDER_Y), math.sqrt(max(variance, 0.0)))


@dataclass
class Health:
    """Counts of all sensors, events of the filter, and the noise of the IMU.

    Attributes:
        sensors: counts by name of the sensor.
        standstill_updates: number of IMU samples at which the robot was found standing.
        track_gaps: number of gaps in the track speeds longer than `Settings.hold`.
        clock_steps: number of times that the clock of all sensors was set: found set back, or by
            `PoseEstimator.set_clock`.
        track_latency: latency of the track speeds, used and estimated.
        noise: noise of the gyro and of the accelerometers by name; empty without a filter.
        findings: faults that last, see `icreckon.FAULTS`.
        times: number of times that each fault of `icreckon.FAULTS` was found by its name; of fixes that
            repeat or scatter, the number of those concerned. Silence, slip, rejections, wander,
            departures and faults of your own are not counted.
        slip_factor: slip that position fixes have shown, over that of the robot file; at least 1.
        wander: estimated wander of the position fixes; None if it is not estimated.
        tilt: tilt of the IMU beyond that of the robot file; None while it is not known.
    """

    sensors: dict[str, SensorHealth] = field(default_factory=dict)
    standstill_updates: Count = 0
    track_gaps: Count = 0
    clock_steps: Count = 0
    track_latency: TrackLatencyHealth = TrackLatencyHealth()
    noise: dict[str, NoiseHealth] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    times: dict[str, Count] = field(default_factory=dict)
    slip_factor: Size = 1.0
    wander: WanderHealth | None = None
    tilt: TiltHealth | None = None

    def sensor(self, name: str) -> SensorHealth:
        """Counts of one sensor; new ones if there are none yet."""
        if name not in self.sensors:
            self.sensors[name] = SensorHealth()
        return self.sensors[name]

    def finding(self, fault: str) -> Finding | None:
        """Newest finding of a fault by its name; None if the fault does not last."""
        findings = [finding for finding in self.findings if finding.fault == fault]
        return max(findings, key=lambda finding: finding.since or 0, default=None)

    def rejections(self) -> dict[str, int]:
        """Number of rejected measurements, by "sensor: reason"."""
        return {
            f"{name}: {reason}": count
            for name, sensor in self.sensors.items()
            for reason, count in sorted(sensor.rejected.items())
        }

    def copy(self) -> Health:
        """Copy the counts."""
        sensors = {name: sensor.copy() for name, sensor in self.sensors.items()}
        copies = {name: getattr(self, name).copy() for name in ("noise", "times", "findings")}
        return replace(self, sensors=sensors, **copies)


def add_findings(health: Health, record: Any, x: Floats, P: Floats, imu: Imu) -> None:
    """Add noise, findings, slip, wander and tilt of a filter with this `FilterRecord`."""
    gyro = record.tracks.gyro
    health.noise = noise_health(record.noise, tracks_rest(record.still), record.settings)
    health.findings, health.times = findings_of(record), times_of(record)
    health.slip_factor = float(record.slip_factor)
    health.wander, health.tilt = wander_health(x, P), tilt_health(record.tilt, imu)
    for sensor, reason, count in (
        ("gyro", GYRO_FAULTS[JUMPED], gyro.jumped),
        ("gyro", GYRO_FAULTS[REPEATS], gyro.repeated),
        ("gyro", GYRO_FAULTS[BEYOND], gyro.beyond),
        ("position", REPEATED, record.positions.rejected),
        ("pose", REPEATED, record.poses.rejected),
    ):
        if count:
            health.sensor(sensor).rejected[reason] = count


def add_arrivals(health: Health, arrivals: Health) -> None:
    """Add the counts of refused and late measurements, and findings from them."""
    health.clock_steps += arrivals.clock_steps
    for stream, arrived in arrivals.sensors.items():
        total = health.sensor(stream)
        total.late += arrived.late
        for reason, count in arrived.rejected.items():
            total.rejected[reason] = total.rejected.get(reason, 0) + count
        # IMU samples that reach the filter are counted by its gyro.
        in_filter = health.sensors.get("gyro" if stream == "imu" else stream, SensorHealth())
        reached = max(in_filter.used, in_filter.judged_count)
        health.findings += refused_stream(stream, arrived.rejected, reached)


@dataclass(frozen=True)
class ParameterHealth:
    """Uncertainty of a parameter, and its excitation by the present motion.

    Attributes:
        sigma: its standard deviation now, in its own unit (docs/explanation/model.md).
        sigma_at_start: its initial standard deviation; 0 if the variant does not estimate it.
        excitation: change of the twist by a deviation of `sigma_at_start` at the present track speeds, in
            standard deviations of the slip; largest of the three components [-].
    """

    sigma: float
    sigma_at_start: float
    excitation: float

    @property
    def share(self) -> float:
        """Ratio of `sigma` to `sigma_at_start`; NaN if it is not estimated."""
        return self.sigma / self.sigma_at_start if self.sigma_at_start else math.nan

    @property
    def excited(self) -> bool:
        """True if the present motion excites the parameter by at least `EXCITED`."""
        return self.excitation >= EXCITED
