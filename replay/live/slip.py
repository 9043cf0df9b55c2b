"""Slip of the tracks: statuses of the topic `slip`."""

import math

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.measurements import TrackSpeeds
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.live.diagnostic_status import OK, WARN, DiagnosticStatus

LEAST_SPEED = 0.1  # track speed from which a ratio is computed [m/s]
STUCK_BELOW, FREE_ABOVE, MOST_ETA = 0.35, 0.6, 5.0
"""Share of the expected motion below which a robot is stuck, on both sides, that above which it is free
again, and most steering efficiency that is expected [-]: where RTK shows at 5 Hz that the robot stands,
the estimate moves by 0.2 to 0.5."""


class SlipWatch:
    """Watch over the slip of the tracks; call `look` several times a second.

    A robot is stuck if two calls in a row indicate it: at a start, its tracks are briefly ahead of it.
    The gauge is that of the tracks [m].
    """

    def __init__(self, gauge: float) -> None:
        self._gauge, self._stands, self._stuck = gauge, False, False

    def look(self, estimator: PoseEstimator, tracks: TrackSpeeds) -> list[DiagnosticStatus]:
        """Statuses slip (always OK), stuck, spinning and sliding (WARN while it lasts)."""
        findings = estimator.health.findings
        forward, sideways, w = estimator.twist.tolist()
        # During a slide the filter keeps the speed of the tracks, and makes it uncertain.
        forward += sum(finding.size or 0.0 for finding in findings if finding.fault == "sliding")
        # Turning on the spot is slip by the gauge: whether it is stuck is judged by the effective track.
        width = self._gauge * min(max(1.0, estimator.indices.eta), MOST_ETA)
        # Speeds of a driver that fell silent are not those of now.
        age = ((estimator.stamp or 0) - tracks.stamp) * NANOSECOND
        is_heard = age <= estimator.settings.hold
        ratios, shares = {}, []
        for side, speed, lateral in (("left", tracks.left, -0.5), ("right", tracks.right, 0.5)):
            drives = is_heard and abs(speed) >= LEAST_SPEED
            ratios[side] = (forward + lateral * self._gauge * w) / speed if drives else math.nan
            shares += [abs((forward + lateral * width * w) / speed)] if drives else []
        before, least = self._stands, FREE_ABOVE if self._stuck else STUCK_BELOW
        self._stands = bool(shares) and max(shares) < least
        self._stuck = before and self._stands
        flags = {"stuck": "the tracks drive and the robot does not" if self._stuck else ""}
        for fault in ("spinning", "sliding"):
            flags[fault] = "; ".join(finding.text for finding in findings if finding.fault == fault)
        values = {f"{side}_ratio": f"{ratio:.4f}" for side, ratio in ratios.items()}
        values["sideways_m_s"] = f"{sideways:.4f}"
        text = ", ".join(f"{side} {ratio:.2f}" for side, ratio in ratios.items())
        statuses = [DiagnosticStatus(OK, "slip", f"ground speed over track speed: {text}", values)]
        for name, fault_text in flags.items():
            level = WARN if fault_text else OK
            statuses.append(DiagnosticStatus(level, name, fault_text or "no", {}))
        return statuses
