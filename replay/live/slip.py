"""Slip of the tracks: statuses of the topic `slip`."""

from __future__ import annotations

import math

from icreckon.estimator.log.measurements import TrackSpeeds
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.base.diagnostic_status import OK, WARN, DiagnosticStatus

LEAST_SPEED = 0.1
"""Track speed from which a ratio is computed [m/s]."""
STUCK_BELOW = 0.2
"""Ratio of ground speed to track speed below which a robot is stuck, on both sides [-]."""


def slip_statuses(
    estimator: PoseEstimator, tracks: TrackSpeeds, gauge: float
) -> list[DiagnosticStatus]:
    """Statuses slip, stuck, spinning and sliding, WARN while it lasts.

    Args:
        estimator: the estimator of the pose.
        tracks: newest track speeds.
        gauge: track gauge [m].
    """
    findings = estimator.health.findings
    forward, sideways, w = estimator.twist.tolist()
    # During a slide the filter keeps the speed of the tracks, and makes it uncertain.
    forward += sum(one.size or 0.0 for one in findings if one.fault == "sliding")
    ratios = {}
    for side, speed, place in (("left", tracks.left, -0.5), ("right", tracks.right, 0.5)):
        ground = forward + place * gauge * w
        ratios[side] = ground / speed if abs(speed) >= LEAST_SPEED else math.nan
    known = [abs(ratio) for ratio in ratios.values() if not math.isnan(ratio)]
    is_stuck = bool(known) and max(known) < STUCK_BELOW
    flags = {"stuck": "the tracks drive and the robot does not" if is_stuck else ""}
    for fault in ("spinning", "sliding"):
        flags[fault] = "; ".join(one.text for one in findings if one.fault == fault)
    values = {f"{side}_ratio": f"{ratio:.4f}" for side, ratio in ratios.items()}
    values["sideways_m_s"] = f"{sideways:.4f}"
    text = ", ".join(f"{side} {ratio:.2f}" for side, ratio in ratios.items())
    return [
        DiagnosticStatus(OK, "slip", f"ground speed over track speed: {text}", values),
        *(DiagnosticStatus(WARN if on else OK, name, on or "no", {}) for name, on in flags.items()),
    ]
