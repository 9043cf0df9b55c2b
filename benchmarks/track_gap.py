"""Gaps in the track speeds while the robot drives on: error, own 3 sigma, and reported speed.

    python benchmarks/track_gap.py LOGS

LOGS is the folder of the sample logs with a truth. Every 20 s of each log, while the robot drives, the
track speeds are left out for some seconds; the IMU goes on. The error is that of the motion from the
start of the gap to 0.5 s after its end, against the same filter without a gap. `fastest` is the largest
|v_x| reported in the gap, over the robot's highest track speed. `in 3 sigma` counts gaps.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _logs import WITH_TRUTH
from _study import table

from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import Measurement, TrackSpeeds
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.replay.reading.read_log import read_log

SECOND = 1_000_000_000
FIRST, EVERY, AFTER = 10.0, 20.0, 0.5
"""First gap, time between gaps, and time after a gap that counts [s]."""
DRIVES = 0.1
"""Speed of a track of a driving robot [m/s]."""
LENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Lengths of the gaps [s]."""
VARIANTS = ("gyro", "constant-online", "inertia-online", "friction-online")


class Gap(NamedTuple):
    """Motion over a gap.

    Attributes:
        error: error of the position [m].
        sigma: its own standard deviation [m].
        square: squared error by its covariance [-].
        fastest: largest |v_x| reported in the gap [m/s].
    """

    error: float
    sigma: float
    square: float
    fastest: float


def over_gap(before: PoseEstimator, ahead: Sequence[Measurement], length: float) -> Gap:
    """Feed measurements with a gap, and without.

    Args:
        before: estimator at the start of the gap; it is left as it is.
        ahead: the measurements from then on.
        length: length of the gap [s].
    """
    bridged, whole = before.copy(), before.copy()
    start = bridged.mark()
    whole.mark(start)
    back, end = start + round(length * SECOND), start + round((length + AFTER) * SECOND)
    fastest = 0.0
    for measurement in ahead:
        if measurement.stamp > end:
            break
        whole.feed(measurement)
        in_gap = measurement.stamp < back
        if not (in_gap and isinstance(measurement, TrackSpeeds)):
            bridged.feed(measurement)
        if in_gap:
            fastest = max(fastest, abs(bridged.twist.item(0)))
    found = bridged.relative_motion(start)
    off = (found.pose - whole.relative_motion(start).pose)[:2]
    covariance = found.end_covariance[:2, :2]
    return Gap(
        float(np.hypot(*off)),
        float(np.sqrt(np.trace(covariance))),
        float(off @ np.linalg.solve(covariance, off)),
        fastest,
    )


def gaps_of(log: Log, robot: Robot, variant: str, length: float) -> list[Gap]:
    """Gaps of a length [s] all along a log."""
    estimator, found = PoseEstimator(robot, variant), []
    measurements = list(log.measurements())
    last = log.end - round((length + AFTER) * SECOND)
    due, size = log.start + round(FIRST * SECOND), np.abs(log.tracks.speeds).max(axis=1)
    for place, measurement in enumerate(measurements):
        if due <= measurement.stamp < last:
            due += round(EVERY * SECOND)
            if np.interp(measurement.stamp, log.tracks.stamps, size) > DRIVES:
                found.append(over_gap(estimator, measurements[place:], length))
        estimator.feed(measurement)
    return found


def gap_row(logs: dict[str, tuple[Robot, Log]], variant: str, length: float) -> list[str]:
    """A row of the table."""
    found, shares = [], []
    for robot, log in logs.values():
        of_log = gaps_of(log, robot, variant, length)
        found += of_log
        shares += [one.fastest / robot.vehicle.max_track_speed for one in of_log]
    errors = np.array([one.error for one in found])
    inside = sum(one.square < 11.83 for one in found)
    return [
        f"{length:g}",
        f"`{variant}`",
        f"{np.sqrt(np.mean(errors**2)):.2f}",
        f"{np.median(errors):.2f}",
        f"{np.median([one.sigma for one in found]):.2f}",
        f"{np.mean([one.square for one in found]):.1f}",
        f"{inside} of {len(found)}",
        f"{max(shares):.2f}",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs", type=Path)
    given = parser.parse_args()
    logs = {
        name: (load_robot(robot), read_log(given.logs / name, load_robot(robot)))
        for name, robot in WITH_TRUTH.items()
    }
    head = ("gap, s", "variant", "error, RMS, m", "median, m", "own sigma, median, m", "NEES (2)")
    rows = (gap_row(logs, variant, length) for length in LENGTHS for variant in VARIANTS)
    table((*head, "in 3 sigma", "fastest"), rows)


if __name__ == "__main__":
    main()
