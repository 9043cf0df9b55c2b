"""Statuses of a live run for /diagnostics: estimate, sensors, parameters, clocks."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.lag_search import BEYOND
from icreckon.estimator.filter.fault_table import Finding
from icreckon.estimator.filter.health import SensorHealth, TiltHealth
from icreckon.estimator.robot.variants import state_names
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.live.diagnostic_status import ERROR, OK, STALE, WARN, DiagnosticStatus
from icreckon.replay.live.manoeuvres import missing_manoeuvres
from icreckon.replay.live.map_frame import MapFrame
from icreckon.replay.live.odometry import LiveOdometry, loss_of

CHANGED_LATENCY = 0.05  # difference of latencies from which a latency is reported as changed [s]
LARGE_NIS = 4.0  # mean NIS per degree of freedom from which a sensor is reported as `WARN`
MANY_REJECTED = 0.1  # share of rejections since the last report that makes a sensor WARN [-]
GYRO, IMU = "gyro", "imu"
"""Sensor whose use shows that the IMU works, and the stream that counts rejected samples."""


class Counts(NamedTuple):
    """Measurements of a sensor, used, and rejected by reason."""

    used: int
    rejected: Counter[str]


class LiveStatuses:
    """Statuses of a live run, with changes since the last report."""

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
            statuses.append(self._map(live.map))
        newest = live.newest
        health = newest.health
        new = {name: self._new(name, sensor) for name, sensor in health.sensors.items()}
        gyro_now = new[GYRO].used if GYRO in new else 0
        for name, sensor in sorted(health.sensors.items()):
            # The IMU has used as many samples as its gyro.
            used = gyro_now if name == IMU else new[name].used
            statuses.append(sensor_status(name, sensor, new[name]._replace(used=used)))
        if newest.stamp is not None:
            statuses.append(_parameters(newest, fixes=live.inputs.mapping.fixes is not None))
            statuses += self._never_heard()
        tracks = live.inputs.mapping.tracks
        joints = (tracks.left, tracks.right) if tracks else ((), ())
        findings = [named_wheels(finding, *joints) for finding in health.findings]
        statuses.append(findings_status(findings, health.times, health.slip_factor))
        if health.tilt is not None:
            statuses.append(tilt_status(health.tilt))
        statuses += [self._messages(), self._clocks(), self._latency(newest)]
        return statuses

    def _estimate(self, frame: str, estimator: PoseEstimator) -> DiagnosticStatus:
        name = f"icreckon: pose in {frame}"
        if estimator.stamp is None:
            subscriptions = self._live.inputs.subscriptions()
            topics = ", ".join(subscription.topic for subscription in subscriptions)
            return DiagnosticStatus(ERROR, name, f"no estimate yet; listening to {topics}", {})
        if loss := loss_of(estimator):
            text = f"{loss}; call the service ~/reset, or restart the node. Until then nothing is saved"
            return DiagnosticStatus(ERROR, name, text, {})
        health, covariance = estimator.health, estimator.pose_covariance
        position = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]), 0.0))
        yaw = math.degrees(math.sqrt(max(float(covariance[2, 2]), 0.0)))
        v_x, v_y, w = estimator.twist.tolist()
        details = {
            "position_sigma_m": f"{position:.4f}",
            "yaw_sigma_deg": f"{yaw:.4f}",
            "v_x_m_s": f"{v_x:.4f}",
            "v_y_m_s": f"{v_y:.4f}",
            "w_rad_s": f"{w:.4f}",
            "standing": str(estimator.stands).lower(),
            "standstill_updates": str(health.standstill_updates),
            "gaps_in_track_speeds": str(health.track_gaps),
            "warm_start": str(self._live.warm).lower(),
        }
        if frame == "map" and health.wander is not None:
            details["wander_of_fixes_m"] = health.wander.text
        level, text = OK, f"sigma {position:.2f} m, {yaw:.2f} deg"
        # Faults of the tracks since the last report.
        now = estimator.stamp, health.track_gaps, health.times.get("stuck", 0)
        before = self._estimates.get(frame, (-1, 0, 0))
        self._estimates[frame] = now
        (_, gaps, stuck), (_, gaps_before, stuck_before) = now, before
        if now == before:
            level, text = STALE, f"no estimate since the last report; {text}"
        if gaps > gaps_before:
            level, text = WARN, f"{text}; a gap in the track speeds was bridged"
        if stuck > stuck_before:
            level = WARN
            text += "; the sensor of a track repeats its reading and is not trusted"
        return DiagnosticStatus(level, name, text, details)

    def _never_heard(self) -> list[DiagnosticStatus]:
        """Status of an IMU without messages, although there is an estimate; else empty."""
        inputs = self._live.inputs
        topics = {topic for purpose, topic, *_ in inputs.subscriptions() if purpose == IMU}
        if not topics or any(topic in inputs.heard for topic in topics):
            return []
        text = f"nothing has come on {', '.join(sorted(topics))}: the heading is that of the tracks"
        return [DiagnosticStatus(ERROR, "icreckon: imu", text, {})]

    def _map(self, in_map: MapFrame) -> DiagnosticStatus:
        """Status of the pose in map, also before there is one."""
        if in_map.waiting:
            text = f"{in_map.waiting} fixes do not show the heading yet: drive on"
            return DiagnosticStatus(WARN, "icreckon: pose in map", text, {})
        if in_map.estimator is None or in_map.estimator.stamp is None:
            return DiagnosticStatus(STALE, "icreckon: pose in map", "no fix yet", {})
        return self._estimate("map", in_map.estimator)

    def _new(self, name: str, sensor: SensorHealth) -> Counts:
        """Counts of a sensor since the last report, or since the estimator started again."""
        now = Counts(sensor.used, Counter(sensor.rejected))
        before = self._before.get(name, Counts(0, Counter()))
        self._before[name] = now
        if now.used < before.used or not now.rejected >= before.rejected:
            return now
        return Counts(now.used - before.used, now.rejected - before.rejected)

    def _messages(self) -> DiagnosticStatus:
        """Messages that could not be used since the last report."""
        lost, name = self._live.inputs.lost, "icreckon: messages"
        new = Counter(lost) - Counter(self._lost)
        self._lost = dict(lost)
        values = {reason: str(count) for reason, count in lost.items()}
        if not new:
            return DiagnosticStatus(OK, name, "all since the last report can be used", values)
        counts = "; ".join(f"{reason} ({count})" for reason, count in new.items())
        text = f"not usable since the last report, with counts: {counts}"
        return DiagnosticStatus(WARN, name, text, values)

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
        purposes = [subscription.purpose for subscription in inputs.subscriptions()]
        stated = {purpose: getattr(inputs.mapping, purpose).latency for purpose in purposes}
        values = {f"{purpose}_s": f"{latency:g}" for purpose, latency in stated.items()}
        used = stated["tracks"] + health.used
        values["tracks_s"] = f"{used:.3f}"
        name = "icreckon: latency"
        if health.estimated is None or health.sigma is None:
            return DiagnosticStatus(OK, name, "tracks: not enough turning yet to see it", values)
        estimated = stated["tracks"] + health.estimated
        values["tracks_estimated_s"] = f"{estimated:.3f} +- {health.sigma:.3f}"
        shown = f"turning shows {estimated:.2f} +- {health.sigma:.2f} s"
        text = f"tracks: {used:.2f} s taken off, {shown}"
        has_changed = abs(estimated - used) > max(CHANGED_LATENCY, BEYOND * health.sigma)
        return DiagnosticStatus(WARN if has_changed else OK, name, text, values)


def sensor_status(name: str, sensor: SensorHealth, new: Counts) -> DiagnosticStatus:
    """Status of a sensor, from its counts since the last report."""
    values = {"used": str(sensor.used), "late": str(sensor.late)}
    rejected = sorted(sensor.rejected.items())
    values |= {f"rejected: {reason}": str(count) for reason, count in rejected}
    nis = sensor.recent_nis
    if nis is not None:
        values["nis_recent"] = f"{nis:.3f}"
    title = f"icreckon: {name}"
    total = new.used + new.rejected.total()
    if not total:
        return DiagnosticStatus(STALE, title, "nothing since the last report", values)
    share = new.rejected.total() / total
    if share > MANY_REJECTED:
        reasons = ", ".join(sorted(new.rejected))
        return DiagnosticStatus(WARN, title, f"{share:.0%} rejected: {reasons}", values)
    if nis is not None and nis > LARGE_NIS:
        text = "noisier than the robot file says, or wrong, or the robot slipped"
        return DiagnosticStatus(WARN, title, f"NIS {nis:.1f} (ideal 1): {text}", values)
    return DiagnosticStatus(OK, title, f"{new.used} used since the last report", values)


def findings_status(
    findings: Sequence[Finding], times: Mapping[str, int], slip_factor: float
) -> DiagnosticStatus:
    """Status of the present faults, with counts of all so far."""
    values = {f"{fault}: times": str(count) for fault, count in times.items()}
    values["slip_factor"] = f"{slip_factor:.2f}"
    for finding in findings:
        title = f"{finding.part or finding.sensor}: {finding.fault}"
        values[f"{title}: effect"] = finding.effect
        if finding.since is not None:
            values[f"{title}: since_ns"] = str(finding.since)
        if finding.size is not None:
            values[f"{title}: size"] = f"{finding.size:.3f}"
    text = "; ".join(finding.text for finding in findings)
    return DiagnosticStatus(WARN if text else OK, "icreckon: faults", text or "none", values)


def named_wheels(finding: Finding, left: Sequence[str], right: Sequence[str]) -> Finding:
    """Finding with the joint's name in its text; unchanged if its part is no wheel."""
    for side, names in (("left", left), ("right", right)):
        for number, name in enumerate(names, start=1):
            if finding.part == f"{side} wheel {number}":
                text = finding.text.replace(finding.part, f"{finding.part} ({name})")
                return finding._replace(text=text)
    return finding


def tilt_status(tilt: TiltHealth) -> DiagnosticStatus:
    """Tilt of the IMU beyond that of the robot file."""
    name, values = "icreckon: IMU mounting", {"tilt": tilt.text}
    if not tilt.is_wrong:
        return DiagnosticStatus(OK, name, "as in the robot file", values)
    text = f"tilted by {tilt.text} beyond rotation_rpy_deg of [imu]"
    return DiagnosticStatus(WARN, name, text, values)


def parameter_statuses(estimator: PoseEstimator) -> list[DiagnosticStatus]:
    """Value and standard deviation of each parameter, bias and scale, by its name.

    Estimated parameters also have their share and their excitation, see `ParameterHealth`.
    """
    sigmas = dict(zip(*_sigmas_by_state(estimator), strict=True))
    parameter_health, statuses = estimator.parameter_health, []
    for name, value in (estimator.parameters | estimator.biases).items():
        values = {"value": f"{value:.9g}", "sigma": f"{sigmas[name]:.9g}"}
        health = parameter_health.get(name)  # None for a bias or scale
        if health is not None and health.sigma_at_start:
            values |= {"share": f"{health.share:.3f}", "excitation": f"{health.excitation:.3f}"}
        text = f"{value:.6g} +- {sigmas[name]:.2g}"
        statuses.append(DiagnosticStatus(OK, name, text, values))
    return statuses


def _sigmas_by_state(estimator: PoseEstimator) -> tuple[tuple[str, ...], Floats]:
    """Names and standard deviations of the variant's states."""
    return state_names(estimator.variant), np.sqrt(estimator.covariance.diagonal())


def _parameters(estimator: PoseEstimator, *, fixes: bool) -> DiagnosticStatus:
    """Parameters in short, and the manoeuvres that are missing."""
    values = {status.name: status.message for status in parameter_statuses(estimator)}
    all_health = estimator.parameter_health.values()
    estimated = [health for health in all_health if health.sigma_at_start]
    shown = sum(health.excited for health in estimated)
    text = f"{shown} of {len(estimated)} shown by the present motion" if estimated else "kept fixed"
    if missing := missing_manoeuvres(*_sigmas_by_state(estimator), fixes=fixes):
        text += f"; to learn more: {'; '.join(missing)}"
    return DiagnosticStatus(OK, "icreckon: parameters", text, values)
