"""Headings of a truth of positions alone, from the path by tracks and gyro."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.lag_search import beside_lowest
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault, headings_by_path
from icreckon.estimator.log.scores import even_grid, interpolate_poses
from icreckon.estimator.log.series import ImuSeries, PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors.sensor_models import SensorModels

LAGS = np.arange(-0.5, 1.2001, 0.02)
"""Candidate lags of the positions [s]."""
WINDOW, SPACING = 1.0, 0.25
"""Length and spacing of the windows over which distances are compared [s]."""


def with_headings(log: Log, robot: Robot) -> tuple[Log, tuple[str, ...]]:
    """Log with headings in its truth, and remarks if these are from the path.

    Args:
        log: the log; one without truth, IMU or tracks stays as it is.
        robot: the robot, for its gyro and the size of its sprockets.

    Raises:
        EstimatorError: the truth has no headings, and the robot moves too little to find them.
    """
    truth, imu = log.truth, log.imu
    if truth is None or imu is None or len(imu.stamps) < 2 or len(log.tracks.stamps) < 2:
        return log, ()
    fault = heading_fault(truth) if truth.headings else "are missing"
    if fault is None:
        return log, ()
    path = _path(log, imu, robot)
    late = round(_lag(truth.poses, path) / NANOSECOND)
    found = headings_by_path(truth.poses, PoseSeries(path.stamps + late, path.poses))
    if found is None:
        raise EstimatorError(
            f"log {log.name!r}: the headings of the truth {fault}, and the robot moves too little to "
            "find them from its path; drive a longer way, or give a truth with headings"
        )
    remark = (
        f"{log.name}: the headings of the truth {fault}; they were found from the path of tracks and "
        f"gyro, ± {math.degrees(found.sigma):.1f}°. Sideslip looks like a heading then: zeta0, zeta1, "
        "y_ICR and the gyro's scale are less certain than they say"
    )
    # Twists of such a truth are not used.
    truth = replace(truth, poses=found.poses, twists=None, headings=True)
    return replace(log, truth=truth), (remark,)


def _path(log: Log, imu: ImuSeries, robot: Robot) -> PoseSeries:
    """Path at the stamps of the IMU: heading by the gyro, speed by the tracks."""
    from scipy.integrate import cumulative_trapezoid

    seconds = (imu.stamps - imu.stamps[0]) * NANOSECOND
    rate = SensorModels(robot).yaw_rates(imu.angular_velocity)
    yaw = cumulative_trapezoid(rate, seconds, initial=0.0)
    speed = np.interp(imu.stamps, log.tracks.stamps, log.tracks.speeds.mean(axis=1))
    velocity = speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    places = cumulative_trapezoid(velocity, seconds, axis=0, initial=0.0)
    return PoseSeries(imu.stamps, np.column_stack([places, yaw]))


def _lag(places: PoseSeries, path: PoseSeries) -> float:
    """Lag [s] at which distances of positions and path agree best."""
    margin = float(np.abs(LAGS).max())
    low = max(places.stamps[0], path.stamps[0]) + round(margin / NANOSECOND)
    high = min(places.stamps[-1], path.stamps[-1]) - round((margin + WINDOW) / NANOSECOND)
    starts = even_grid(low, high, round(SPACING / NANOSECOND), path.stamps)
    if len(starts) < 8:
        return 0.0

    def moved(series: PoseSeries, lag: float) -> Floats:
        at = starts - round(lag / NANOSECOND)
        step = interpolate_poses(series, at + round(WINDOW / NANOSECOND)) - interpolate_poses(
            series, at
        )
        return np.asarray(np.hypot(step[:, 0], step[:, 1]))

    true = moved(places, 0.0)
    costs = np.array([np.mean(np.abs(moved(path, float(lag)) - true)) for lag in LAGS])
    best = int(np.clip(np.argmin(costs), 1, len(LAGS) - 2))
    beside = float(np.clip(beside_lowest(costs, best), -1.0, 1.0))
    return float(LAGS[best]) + beside * float(LAGS[1] - LAGS[0])
