"""Settings for ROS from a robot file and a log, as YAML with comments.

Parameters of `diff_drive_controller` (ros2_controllers), covariances for `robot_localization`, and the
mounting of the IMU as a static transform.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.lag import Lag
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.check import in_base, in_rates_of, tracks_usable
from icreckon.replay.checking.measured import (
    effective_track,
    measured_scale,
    measured_track,
    true_motion,
)
from icreckon.replay.checking.track_checks import is_other_track
from icreckon.replay.inspection.latency import truth_lag, without_lag

ROS_FIRST_WORDS = "# Settings for ROS"
# Variance of motion that the wheels do not measure [m²/s², rad²/s²].
UNMEASURED = 1e3
# Windows in which odometry is compared with a truth [s].
WINDOW = 1.0
# Error of v_x and w without anything to compare with, as a share of their usual size [-].
SHARE_FORWARD, SHARE_TURNING = 0.03, 0.2

NOT_SEEN = "of the robot file; this log does not show it"


class TwistErrors(NamedTuple):
    """Root mean square errors of wheel odometry while it drives.

    Attributes:
        forward: of v_x [m/s].
        forward_by: what it was compared with, empty for nothing.
        turning: of w [rad/s].
        turning_by: what it was compared with, empty for nothing.
    """

    forward: float
    forward_by: str
    turning: float
    turning_by: str


def ros_settings(log: Log, robot: Robot) -> str:
    """Format settings for ROS as YAML.

    Args:
        log: a log that was read with this robot.
        robot: the robot; its effective track is that of constant ICRs.
    """
    vehicle, tracks = robot.vehicle, robot.tracks
    errors = twist_errors(log, robot)
    multiplier, multiplier_by = _multiplier(log, robot)
    twist = [errors.forward**2, *[UNMEASURED] * 4, errors.turning**2]
    lines = [
        f"{ROS_FIRST_WORDS}, of {_word(robot.name)} on {_word(log.name)}. Every line is in SI units.",
        "# ros2_controllers, diff_drive_controller: merge into its parameters.",
        "diff_drive_controller:",
        "  ros__parameters:",
        f"    wheel_separation: {_number(vehicle.track_gauge)}  # m, between the centrelines",
        f"    wheel_separation_multiplier: {_number(multiplier)}  # {multiplier_by}",
        f"    # Effective wheel separation: {multiplier * vehicle.track_gauge:.3g} m.",
        *_radius_lines(log, robot),
        f"    left_wheel_radius_multiplier: {1.0 - 0.5 * tracks.difference:.4f}",
        f"    right_wheel_radius_multiplier: {1.0 + 0.5 * tracks.difference:.4f}",
        f"    # v_x: {errors.forward:.2g} m/s {_by(errors.forward_by)}; "
        f"w: {errors.turning:.2g} rad/s {_by(errors.turning_by)}",
        f"    twist_covariance_diagonal: {_numbers(twist)}",
        "# robot_localization: fuse v_x and v_yaw of this odometry (not its pose) and v_yaw of the IMU.",
    ]
    latency = robot.log.get("tracks", {}).get("latency", 0.0)
    if latency:
        lines.append(
            f"# Track speeds are stamped {latency:.3g} s late: take that off their stamps."
        )
    return "\n".join([*lines, *_imu_lines(log, robot)]) + "\n"


def twist_errors(log: Log, robot: Robot) -> TwistErrors:
    """Estimate errors of wheel odometry with the effective track of a robot file.

    Args:
        log: a log that was read with this robot.
        robot: the robot.
    """
    track = effective_track(robot)
    speeds = log.tracks.speeds if len(log.tracks.speeds) else np.zeros((1, 2))
    usual = np.sqrt(np.mean(speeds**2, axis=0))
    forward, forward_by = SHARE_FORWARD * float(usual.mean()), ""
    turned = (speeds[:, 1] - speeds[:, 0]) / track
    turning, turning_by = SHARE_TURNING * float(np.sqrt(np.mean(turned**2))), ""
    if log.imu is not None and tracks_usable(log):
        rate = in_base(log.imu, robot)[0]
        own = np.interp(log.imu.stamps, log.tracks.stamps, turned)
        size = np.abs(speeds).max(axis=1)
        moving = np.interp(log.imu.stamps, log.tracks.stamps, size) > 0.0
        if moving.any():
            off = (own - rate)[moving]
            turning, turning_by = float(np.std(off)), "against the gyro"
    found = _forward_errors(log, robot)
    if len(found):
        forward, forward_by = float(np.sqrt(np.mean(found**2))), "against the truth"
    return TwistErrors(forward, forward_by, turning, turning_by)


def _forward_errors(log: Log, robot: Robot) -> Floats:
    """Errors (n,) of the mean forward speed in windows, against a truth [m/s]."""
    truth = log.truth
    if truth is None or not truth.headings or log.imu is None or not tracks_usable(log):
        return np.zeros(0)
    late = truth_lag(truth, log.tracks, log.imu, in_base(log.imu, robot)[0])
    if isinstance(late, Lag) and truth.twists is None:
        truth = replace(truth, poses=without_lag(truth.poses, late))
    motion = true_motion(log, truth, WINDOW)
    if motion is None:
        return np.zeros(0)
    edges, moved = motion.edges, motion.moved
    seconds = np.diff(edges) * NANOSECOND
    true_speed = np.hypot(moved[:, 0], moved[:, 1]) * np.sign(moved[:, 0]) / seconds
    true_speed /= np.sinc(moved[:, 2] / (2.0 * math.pi))
    stamps = (log.tracks.stamps - log.tracks.stamps[0]) * NANOSECOND
    mean = log.tracks.speeds.mean(axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.diff(stamps) * mean[:-1])])
    at = np.interp((edges - log.tracks.stamps[0]) * NANOSECOND, stamps, way)
    speed = np.diff(at) / seconds
    driving = np.abs(speed) > 0.1 * np.abs(speed).max()
    return np.asarray((speed - true_speed)[driving])


def _imu_lines(log: Log, robot: Robot) -> list[str]:
    if log.imu is None or len(log.imu.stamps) < 2:
        return []
    imu = robot.imu
    step = float(np.median(np.diff(log.imu.stamps))) * NANOSECOND
    rate = imu.gyro_noise_density**2 / step
    force = imu.accelerometer_noise_density**2 / step
    x, y, z = imu.position
    roll, pitch, yaw = np.radians(imu.rotation_rpy_deg)
    return [
        f"# The IMU's driver, at {1.0 / step:.0f} Hz; its bias about the vertical is "
        f"{imu.gyro_bias:.2g} ± {imu.gyro_bias_sigma:.2g} rad/s, and no covariance.",
        "imu_driver:",
        "  ros__parameters:",
        f"    angular_velocity_covariance_diagonal: {_numbers([rate] * 3)}",
        f"    linear_acceleration_covariance_diagonal: {_numbers([force] * 3)}",
        "# ros2 run tf2_ros static_transform_publisher --frame-id base_link --child-frame-id imu_link "
        f"--x {x:g} --y {y:g} --z {z:g} --roll {roll:.5f} --pitch {pitch:.5f} --yaw {yaw:.5f}",
    ]


def _multiplier(log: Log, robot: Robot) -> tuple[float, str]:
    """Effective track over the gauge, and a comment.

    It is the log's where that contradicts the file.
    """
    in_file, found = robot.constant_indices.eta0, measured_track(log, robot)
    if found is None:
        return in_file, NOT_SEEN
    seen = found / robot.vehicle.track_gauge
    if is_other_track(seen / in_file):
        return seen, f"by the gyro of this log, which contradicts the robot file's {in_file:.4g}"
    return in_file, f"of the robot file; by the gyro of this log {seen:.4g}"


def _radius_lines(log: Log, robot: Robot) -> list[str]:
    """Effective radius, unless the track speeds of the file are no rates."""
    if not in_rates_of(robot):
        return []
    radius = robot.vehicle.sprocket_radius
    return [f"    wheel_radius: {_number(radius)}  # m, effective: {_seen_radius(log, robot)}"]


def _seen_radius(log: Log, robot: Robot) -> str:
    found = measured_scale(log, robot, bends=True)
    if found is None:
        return NOT_SEEN
    radius = robot.vehicle.sprocket_radius
    error = "" if found.sigma is None else f" ± {found.sigma * radius:.2g}"
    return f"by the {found.source} of this log {found.ratio * radius:.4g}{error}"


def _by(source: str) -> str:
    return source or "by default, with nothing to compare with"


def _numbers(values: list[float]) -> str:
    return f"[{', '.join(_number(value, 3) for value in values)}]"


def _number(value: float, digits: int = 4) -> str:
    """Float of YAML: always with a point.

    YAML 1.1 takes 1e3 for a text.
    """
    text = np.format_float_positional(value, digits, fractional=False, trim="0", unique=False)
    return str(text)


def _word(name: str) -> str:
    return " ".join(name.split())
