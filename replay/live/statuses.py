"""Statuses of a live run for /diagnostics: estimate, sensors, parameters, clocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from icreckon.estimator.base.lag_search import BEYOND
from icreckon.estimator.filter.health import (
    GyroHealth,
    OddWheel,
    ScatterHealth,
    SensorHealth,
    SlipHealth,
    TiltHealth,
)
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.base.diagnostic_status import (
    ERROR,
    LARGE_NIS,
    OK,
    STALE,
    WARN,
    DiagnosticStatus,
    estimate_status,
)
from icreckon.replay.live.odometry import LiveOdometry, loss_of

CHANGED_LATENCY = 0.05
"""Difference of latencies from which a latency is reported as changed [s]."""
MANY_REJECTED = 0.1
"""Share of rejected measurements between two reports from which a sensor is reported as WARN."""
GYRO, IMU, POSITION = "gyro", "imu", "position"
"""Sensor whose use shows that the IMU works, the stream that counts rejected samples, and the fixes."""
LARGE_FACTOR = 3.0
"""Factor on the slip that is reported, see `SlipHealth.factor`."""


class Counts(NamedTuple):
    """Measurements of a sensor, used and rejected."""

    used: int
    rejected: int


class LiveStatuses:
    """Statuses of a live run, with changes since the last report.

    Args:
        live: the run.
    """

    def __init__(self, live: LiveOdometry) -> None:
        self._live = live
        self._before: dict[str, Counts] = {}
        self._lost: dict[str, int] = {}
        self._estimates: dict[str, tuple[int, int, int]] = {}

    def report(self) -> list[DiagnosticStatus]:
        """Make the statuses of the present moment."""
        live = self._live
        statuses = [self._estimate("odom", live.odom)]
        if live.map is not None:
            statuses.append(self._map())
        newest = live.odom if live.map is None or live.map.estimator is None else live.map.estimator
        sensors = newest.health.sensors
        new = {name: self._new(name, sensor) for name, sensor in sensors.items()}
        gyro_now = new[GYRO].used if GYRO in new else 0
        for name, sensor in sorted(sensors.items()):
            # Samples that are used count as those of the gyro.
            used = gyro_now if name == IMU else new[name].used
            statuses.append(sensor_status(name, sensor, new[name]._replace(used=used)))
        if newest.stamp is not None:
            statuses.append(_parameters(newest))
            statuses += self._never_heard()
        statuses.append(self._slip(newest.health.slip))
        if GYRO in sensors:
            statuses.append(gyro_status(newest.health.gyro, is_silent=gyro_now == 0))
        if newest.health.tilt is not None:
            statuses.append(tilt_status(newest.health.tilt))
        if POSITION in sensors:
            statuses.append(scatter_status(newest.health.scatter))
        statuses += [self._messages(), self._clocks(), self._latency(newest)]
        return statuses

    def _estimate(self, frame: str, estimator: PoseEstimator) -> DiagnosticStatus:
        name = f"icreckon: pose in {frame}"
        if estimator.stamp is None:
            topics = ", ".join(one.topic for one in self._live.inputs.subscriptions())
            return DiagnosticStatus(ERROR, name, f"no estimate yet; listening to {topics}", {})
        if loss := loss_of(estimator):
            text = f"{loss}; call the service ~/reset, or restart the node. Until then nothing is saved"
            return DiagnosticStatus(ERROR, name, text, {})
        health = estimator.health
        details = {
            "standing": str(estimator.stands).lower(),
            "standstill_updates": str(health.standstill_updates),
            "gaps_in_track_speeds": str(health.track_gaps),
            "stuck_tracks": str(health.stuck_tracks),
            "warm_start": str(self._live.warm).lower(),
        }
        if frame == "map" and health.wander is not None:
            details["wander_of_fixes_m"] = health.wander.text
        status = estimate_status(name, estimator.pose_covariance, estimator.twist, details)
        return self._with_changes(frame, status, estimator)

    def _with_changes(
        self, frame: str, status: DiagnosticStatus, estimator: PoseEstimator
    ) -> DiagnosticStatus:
        """Status of an estimate, with faults of the tracks since the last report."""
        health, stamp = estimator.health, estimator.stamp or 0
        now = stamp, health.track_gaps, health.stuck_tracks
        before = self._estimates.get(frame, (-1, 0, 0))
        self._estimates[frame] = now
        if now == before:
            text = f"no estimate since the last report; {status.message}"
            return status._replace(level=STALE, message=text)
        texts = []
        if now[1] > before[1]:
            texts.append("a gap in the track speeds was bridged")
        if now[2] > before[2]:
            texts.append("the sensor of a track repeats its reading and is not trusted")
        if not texts:
            return status
        return status._replace(level=WARN, message=f"{status.message}; {'; '.join(texts)}")

    def _never_heard(self) -> list[DiagnosticStatus]:
        """Status of an IMU from which nothing has come, though the robot is reckoned."""
        inputs = self._live.inputs
        topics = {one.topic for one in inputs.subscriptions() if one.purpose == IMU}
        if not topics or any(topic in inputs.heard for topic in topics):
            return []
        text = f"nothing has come on {', '.join(sorted(topics))}: the heading is that of the tracks"
        return [DiagnosticStatus(ERROR, "icreckon: imu", text, {})]

    def _map(self) -> DiagnosticStatus:
        in_map = self._live.map
        estimator = in_map.estimator if in_map is not None else None
        if in_map is not None and in_map.waiting:
            text = f"{in_map.waiting} fixes do not show the heading yet: drive on"
            return DiagnosticStatus(WARN, "icreckon: pose in map", text, {})
        if estimator is None or estimator.stamp is None:
            return DiagnosticStatus(STALE, "icreckon: pose in map", "no fix yet", {})
        return self._estimate("map", estimator)

    def _new(self, name: str, sensor: SensorHealth) -> Counts:
        """Counts of a sensor since the last report, or since the estimator started anew."""
        now = Counts(sensor.used, sum(sensor.rejected.values()))
        before = self._before.get(name, Counts(0, 0))
        self._before[name] = now
        if now.used < before.used or now.rejected < before.rejected:
            return now
        return Counts(now.used - before.used, now.rejected - before.rejected)

    def _messages(self) -> DiagnosticStatus:
        """Messages that could not be used since the last report."""
        lost, name = self._live.inputs.lost, "icreckon: messages"
        new = {
            reason: count - self._lost.get(reason, 0)
            for reason, count in lost.items()
            if count > self._lost.get(reason, 0)
        }
        self._lost = dict(lost)
        values = {reason: str(count) for reason, count in lost.items()}
        if not new:
            return DiagnosticStatus(OK, name, "all since the last report can be used", values)
        text = "; ".join(f"{reason} ({count})" for reason, count in new.items())
        return DiagnosticStatus(
            WARN, name, f"not usable since the last report, with counts: {text}", values
        )

    def _slip(self, slip: SlipHealth) -> DiagnosticStatus:
        tracks = self._live.inputs.mapping.tracks
        return slip_status(slip, *((tracks.left, tracks.right) if tracks else ()))

    def _clocks(self) -> DiagnosticStatus:
        inputs = self._live.inputs
        values = {
            f"{purpose} clock": f"{choice.clock}: {choice.reason}"
            for purpose, choice in inputs.clocks.items()
        }
        steps = self._live.odom.health.clock_steps
        values["clock_steps"] = str(steps)
        by_arrival = [one for one, choice in inputs.clocks.items() if not choice.by_default]
        name = "icreckon: clocks"
        if not inputs.clocks:
            return DiagnosticStatus(STALE, name, "not chosen yet", values)
        if by_arrival:
            text = f"{', '.join(by_arrival)} by time of arrival, not by header stamps"
            return DiagnosticStatus(WARN, name, text, values)
        text = f"header stamps; clock set {steps} times" if steps else "header stamps"
        return DiagnosticStatus(WARN if steps else OK, name, text, values)

    def _latency(self, estimator: PoseEstimator) -> DiagnosticStatus:
        """Latencies that are used; WARN if turning shows another one of the tracks."""
        inputs, health = self._live.inputs, estimator.health.track_latency
        mapped = {
            one.purpose: getattr(inputs.mapping, one.purpose) for one in inputs.subscriptions()
        }
        values = {f"{purpose}_s": f"{one.latency:g}" for purpose, one in mapped.items()}
        given = mapped["tracks"].latency
        used = given + health.used
        values["tracks_s"] = f"{used:.3f}"
        name = "icreckon: latency"
        if health.estimated is None or health.sigma is None:
            return DiagnosticStatus(OK, name, "tracks: not enough turning yet to see it", values)
        estimated = given + health.estimated
        values["tracks_estimated_s"] = f"{estimated:.3f} +- {health.sigma:.3f}"
        text = (
            f"tracks: {used:.2f} s taken off, turning shows {estimated:.2f} +- {health.sigma:.2f} s"
        )
        off = abs(estimated - used)
        wrong = off > max(CHANGED_LATENCY, BEYOND * health.sigma)
        return DiagnosticStatus(WARN if wrong else OK, name, text, values)


def sensor_status(name: str, sensor: SensorHealth, new: Counts) -> DiagnosticStatus:
    """Status of a sensor.

    Args:
        name: its name.
        sensor: its counts and innovations.
        new: its counts since the last report.
    """
    values = {"used": str(sensor.used), "late": str(sensor.late)}
    values |= {
        f"rejected: {reason}": str(count) for reason, count in sorted(sensor.rejected.items())
    }
    nis = sensor.recent_nis
    if nis is not None:
        values["nis_recent"] = f"{nis:.3f}"
    title = f"icreckon: {name}"
    if not any(new):
        return DiagnosticStatus(STALE, title, "nothing since the last report", values)
    share = new.rejected / sum(new)
    if share > MANY_REJECTED:
        reasons = ", ".join(sorted(sensor.rejected))
        return DiagnosticStatus(WARN, title, f"{share:.0%} rejected: {reasons}", values)
    if nis is not None and nis > LARGE_NIS:
        text = f"NIS {nis:.1f} (ideal 1): its noise in the robot file is too small, or it is wrong"
        return DiagnosticStatus(WARN, title, text, values)
    return DiagnosticStatus(OK, title, f"{new.used} used since the last report", values)


def slip_status(
    slip: SlipHealth, left: Sequence[str] = (), right: Sequence[str] = ()
) -> DiagnosticStatus:
    """Slip beyond what bends explain.

    Args:
        slip: the slip.
        left: names of the left wheels.
        right: names of the right wheels.
    """
    name = "icreckon: slip"
    values = {
        "times": str(slip.times),
        "slides": str(slip.slides),
        "carries": str(slip.carries),
        "odd_wheels": str(slip.odd_wheels),
        "slip_factor": f"{slip.factor:.2f}",
    }
    texts = []
    if slip.track is not None:
        values |= {
            "track": slip.track,
            "since_ns": str(slip.since),
            "mismatch_m_s": f"{slip.mismatch:.3f}",
        }
        which = "one track" if slip.track == "unknown" else f"the {slip.track} track"
        texts.append(f"{which} spins, or its sensor fails: {slip.mismatch:.2f} m/s too much")
    for side, odd, names in (("left", slip.left_wheels, left), ("right", slip.right_wheels, right)):
        if odd is not None:
            values |= {
                f"{side}_wheels_since_ns": str(odd.since),
                f"{side}_wheels_samples": str(odd.samples),
            }
            texts.append(_odd_wheel(side, odd, names))
    if slip.forward is not None:
        values["forward_since_ns"] = str(slip.forward.since)
        values["forward_m_s"] = f"{slip.forward.speed:.3f}"
        than = "slower" if slip.forward.speed < 0.0 else "faster"
        texts.append(f"the robot is {abs(slip.forward.speed):.2f} m/s {than} than its tracks")
    if slip.factor > LARGE_FACTOR:
        texts.append(
            f"position fixes show {slip.factor:.1f} times the slip expected, or they wander"
        )
    if slip.carried is not None:
        values["carried_since_ns"] = str(slip.carried)
        texts.append("the robot is shaken with its tracks at rest: it may be carried")
    if not texts:
        return DiagnosticStatus(OK, name, "no track spins", values)
    return DiagnosticStatus(WARN, name, "; ".join(texts), values)


def _odd_wheel(side: str, odd: OddWheel, names: Sequence[str]) -> str:
    if odd.wheel is None:
        return f"the {side} wheels are {2.0 * odd.apart:.2f} m/s apart, which is right is not clear"
    name = names[odd.wheel] if odd.wheel < len(names) else f"wheel {odd.wheel + 1}"
    return f"{name} of the {side} side is {odd.apart:.2f} m/s off and is not used"


def gyro_status(gyro: GyroHealth, *, is_silent: bool = False) -> DiagnosticStatus:
    """Fault of the gyro.

    Args:
        gyro: its faults.
        is_silent: whether nothing of it was used since the last report.
    """
    name, values = "icreckon: gyro faults", {"times": str(gyro.times)}
    if gyro.fault is None and is_silent:
        text = "nothing of it was used since the last report"
        return DiagnosticStatus(STALE, name, text, values)
    if gyro.fault is None:
        return DiagnosticStatus(OK, name, "it works", values)
    values["since_ns"] = str(gyro.since)
    what = f"is {gyro.fault}" if gyro.fault.startswith("beyond") else gyro.fault
    return DiagnosticStatus(
        WARN, name, f"the gyro {what}: only the tracks show the turning", values
    )


def tilt_status(tilt: TiltHealth) -> DiagnosticStatus:
    """Tilt of the IMU beyond that of the robot file."""
    name, values = "icreckon: IMU mounting", {"tilt": tilt.text}
    if not tilt.is_wrong:
        return DiagnosticStatus(OK, name, "as in the robot file", values)
    text = f"tilted by {tilt.text} beyond rotation_rpy_deg of [imu]"
    return DiagnosticStatus(WARN, name, text, values)


def scatter_status(scatter: ScatterHealth) -> DiagnosticStatus:
    """Scatter of the position fixes beyond the stated sigma."""
    name, values = "icreckon: scatter of fixes", {"used_with_more": str(scatter.used)}
    if scatter.correlation is not None:
        values["correlation"] = f"{scatter.correlation:.2f}"
    if not scatter.sigma and scatter.is_correlated:
        text = f"their errors wander: innovations have a correlation of {scatter.correlation:.2f}"
        return DiagnosticStatus(WARN, name, text, values)
    if not scatter.sigma:
        return DiagnosticStatus(OK, name, "as stated", values)
    values["sigma_m"] = f"{scatter.sigma:.3g}"
    text = f"more than stated: used with a sigma of {scatter.sigma:.2g} m"
    if scatter.wanders:
        text += ", as their errors wander"
    return DiagnosticStatus(WARN, name, text, values)


def _parameters(estimator: PoseEstimator) -> DiagnosticStatus:
    values = {}
    for name, value in estimator.parameters.items():
        one = estimator.parameter_health[name]
        values[name] = f"{value:.6g} +- {one.sigma:.2g}"
        if one.sigma_at_start:
            values[f"{name} share"] = f"{one.share:.3f}"
    values |= {name: f"{value:.6g}" for name, value in estimator.biases.items()}
    estimated = [one for one in estimator.parameter_health.values() if one.sigma_at_start]
    shown = sum(one.excited for one in estimated)
    text = f"{shown} of {len(estimated)} shown by the present motion" if estimated else "kept fixed"
    return DiagnosticStatus(OK, "icreckon: parameters", text, values)
