"""Settings for ROS from a robot and its logs, as YAML with comments.

Parameters of `diff_drive_controller` (ros2_controllers), covariances for `robot_localization`, and the
mounting of the IMU as a static transform.
"""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.lag import Lag
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries
from icreckon.estimator.robot.robot_file import Robot, make_robot
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.checking import check
from icreckon.replay.checking.track_checks import is_other_track
from icreckon.replay.inspection.filled_in import has_stand_in_gauge
from icreckon.replay.inspection.imu_mounting import are_usable
from icreckon.replay.inspection.latency import truth_lag, without_lag
from icreckon.replay.reading.read_log import read_log

ROS_FIRST_WORDS = "# Settings for ROS"
UNMEASURED = 1e3  # variance of motion that the wheels do not measure [m²/s², rad²/s²]
WINDOW = 1.0  # windows in which odometry is compared with a truth [s]
# Error of v_x and w without anything to compare with, as a share of their usual size [-].
SHARE_FORWARD, SHARE_TURNING = 0.03, 0.2
ANY_MASS = 50.0  # mass that a robot file must have, and these settings do not use [kg]

Estimate = tuple[float, float | None]
"""Estimate and its standard error, None if unknown."""


class TwistErrors(NamedTuple):
    """Root mean square errors of wheel odometry while it drives."""

    forward: float  # of v_x [m/s]
    forward_by: str  # reference of v_x, empty for none
    turning: float  # of w [rad/s]
    turning_by: str  # reference of w, empty for none


def ros_settings(
    logs: Sequence[Log],
    robot: Robot,
    *,
    source: str = "of the robot file",
    proposed: bool = False,
    corrected: Sequence[str] = (),
) -> str:
    """Format settings for ROS as YAML.

    Args:
        logs: logs that were read with this robot.
        robot: the robot; its effective track is that of constant ICRs.
        source: origin of the effective track, for a comment.
        proposed: True if the effective track is that of the logs, and the gauge a stand-in for one that
            nobody has measured.
        corrected: corrected quantities, in which the logs contradicted the robot file.
    """
    names = ", ".join(_word(log.name) for log in logs)
    lines = [f"{ROS_FIRST_WORDS}, of {_word(robot.name)} on {names}. Every line is in SI units."]
    if corrected:
        lines.append(
            f"# The robot file contradicts the log in: {', '.join(corrected)}. These are by the log."
        )
    if any(len(log.tracks.stamps) for log in logs):
        lines += _controller_lines(logs, robot, source=source, proposed=proposed)
    imu = next((log.imu for log in logs if log.imu is not None and len(log.imu.stamps) > 1), None)
    if imu is not None:
        lines += _imu_lines(imu, robot)
    return "\n".join(lines) + "\n"


def proposed_ros_settings(
    proposed: str, paths: Sequence[Path], definitions: Definitions = ()
) -> str:
    """Format settings for ROS by a log and the robot file proposed for it.

    Raises:
        ReplayError: no track speeds in metres, since the effective radius is not known.
    """
    tables = tomllib.loads(proposed)
    vehicle, name = tables["vehicle"], tables.pop("name")
    tables.pop("format", None)
    if math.isnan(vehicle["sprocket_radius"]):
        raise ReplayError(
            "settings for ROS need the effective radius, which this log does not show: fill in "
            "sprocket_radius in the proposed robot file, then icreckon check --ros"
        )
    without_gauge = math.isnan(vehicle["track_gauge"])
    of_controller = tables.get("log", {}).get("tracks", {}).get("gauge", 1.0)
    for key, value in (("mass", ANY_MASS), ("track_gauge", of_controller)):
        if math.isnan(vehicle[key]):
            vehicle[key] = value
    robot = make_robot(name, **tables)
    log = read_log(list(paths), robot, definitions=definitions)
    return ros_settings([log], robot, proposed=without_gauge or has_stand_in_gauge(proposed))


def twist_errors(logs: Sequence[Log], robot: Robot) -> TwistErrors:
    """Estimate errors of wheel odometry with the effective track of a robot."""
    track = check.effective_track(robot)
    speeds = np.concatenate([log.tracks.speeds for log in logs] + [np.zeros((1, 2))])
    usual = np.sqrt(np.mean(speeds**2, axis=0))
    forward, forward_by = SHARE_FORWARD * float(usual.mean()), ""
    turned = (speeds[:, 1] - speeds[:, 0]) / track
    turning, turning_by = SHARE_TURNING * float(np.sqrt(np.mean(turned**2))), ""
    off = np.concatenate([_turning_errors(log, robot) for log in logs])
    if len(off):
        turning, turning_by = float(np.sqrt(np.mean(off**2))), "against the gyro"
    found = np.concatenate([_forward_errors(log, robot) for log in logs])
    if len(found):
        forward, forward_by = float(np.sqrt(np.mean(found**2))), "against the truth"
    return TwistErrors(forward, forward_by, turning, turning_by)


def _turning_errors(log: Log, robot: Robot) -> Floats:
    """Errors (n,) of the yaw rate about their mean while tracks move, by the gyro."""
    if log.imu is None or not are_usable(log.tracks):
        return np.zeros(0)
    left, right = (np.interp(log.imu.stamps, log.tracks.stamps, one) for one in log.tracks.speeds.T)
    size = np.abs(log.tracks.speeds).max(axis=1)
    moving = np.interp(log.imu.stamps, log.tracks.stamps, size) > 0.0
    off = ((right - left) / check.effective_track(robot) - check.in_base(log.imu, robot)[0])[moving]
    return np.asarray(off - off.mean() if len(off) else off)


def _forward_errors(log: Log, robot: Robot) -> Floats:
    """Errors (n,) of the mean forward speed in windows, against a truth [m/s]."""
    truth = log.truth
    if truth is None or not truth.headings or log.imu is None or not are_usable(log.tracks):
        return np.zeros(0)
    late = truth_lag(truth, log.tracks, log.imu, check.in_base(log.imu, robot)[0])
    if isinstance(late, Lag) and truth.twists is None:
        truth = replace(truth, poses=without_lag(truth.poses, late))
    motion = check.true_motion(log, truth, WINDOW)
    if motion is None:
        return np.zeros(0)
    edges, moved = motion
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


def _controller_lines(
    logs: Sequence[Log], robot: Robot, *, source: str, proposed: bool
) -> list[str]:
    """Parameters of the controller, and the latency of its speeds."""
    errors, difference = twist_errors(logs, robot), robot.tracks.difference
    twist = [errors.forward**2, *[UNMEASURED] * 4, errors.turning**2]
    lines = [
        "# ros2_controllers, diff_drive_controller: merge into its parameters.",
        "diff_drive_controller:",
        "  ros__parameters:",
        *(_proposed_separation(logs, robot) if proposed else _separation(logs, robot, source)),
        *_radius_lines(logs, robot),
        f"    left_wheel_radius_multiplier: {1.0 - 0.5 * difference:.4f}",
        f"    right_wheel_radius_multiplier: {1.0 + 0.5 * difference:.4f}",
        f"    # v_x: {errors.forward:.2g} m/s {_by(errors.forward_by)}; "
        f"w: {errors.turning:.2g} rad/s {_by(errors.turning_by)}",
        f"    twist_covariance_diagonal: {_numbers(twist)}",
        "# robot_localization: fuse v_x and v_yaw of this odometry (not its pose) and v_yaw of the IMU.",
    ]
    latency = robot.log.get("tracks", {}).get("latency", 0.0)
    if latency:
        lines.append(
            f"# Track speeds are stamped {latency:.3g} s late. No parameter here takes that off: let "
            "their driver restamp them."
        )
    return lines


def _imu_lines(samples: ImuSeries, robot: Robot) -> list[str]:
    imu = robot.imu
    step = float(np.median(np.diff(samples.stamps))) * NANOSECOND
    rate = imu.gyro_noise_density**2 / step
    force = imu.accelerometer_noise_density**2 / step
    x, y, z = imu.position
    roll, pitch, yaw = np.radians(imu.rotation_rpy_deg)
    return [
        f"# The IMU's driver, at {1.0 / step:.0f} Hz; its bias about the vertical is "
        f"{imu.gyro_bias:.2g} ± {imu.gyro_bias_sigma:.2g} rad/s, and no covariance.",
        "imu_driver:  # the name of your IMU's driver, which may name these otherwise",
        "  ros__parameters:",
        f"    angular_velocity_covariance_diagonal: {_numbers([rate] * 3)}",
        f"    linear_acceleration_covariance_diagonal: {_numbers([force] * 3)}",
        "# ros2 run tf2_ros static_transform_publisher --frame-id base_link --child-frame-id imu_link "
        f"--x {_metres(x)} --y {_metres(y)} --z {_metres(z)} "
        f"--roll {roll:.5f} --pitch {pitch:.5f} --yaw {yaw:.5f}",
    ]


def _separation(logs: Sequence[Log], robot: Robot, source: str) -> list[str]:
    """Wheel separation and its multiplier.

    The multiplier is that of the logs where they contradict the robot.
    """
    gauge, multiplier = robot.vehicle.track_gauge, robot.constant_indices.eta0
    seen = _multipliers(logs, robot)
    comment = f"{source}; {_not_seen(logs)}"
    if seen:
        shown, ratio = _shown(logs, "gyro", seen), float(np.mean([one for one, _ in seen]))
        comment = f"{source}; {shown}"
        if is_other_track(ratio / multiplier):
            comment = f"{shown}, which contradicts {multiplier:.4g} {source}"
            multiplier = ratio
    if check.from_twist(robot):
        comment += "; times that of the controller which made this odometry"
    return [
        f"    wheel_separation: {_number(gauge)}  # m, between the centrelines",
        f"    wheel_separation_multiplier: {_number(multiplier)}  # {comment}",
        f"    # Effective wheel separation: {multiplier * gauge:.3g} m.",
    ]


def _proposed_separation(logs: Sequence[Log], robot: Robot) -> list[str]:
    """Effective wheel separation of logs, where nobody has measured the gauge."""
    seen = _multipliers(logs, robot)
    if not seen:
        return [f"    # wheel_separation and its multiplier: {_not_seen(logs)}."]
    if check.from_twist(robot):
        return [
            "    # wheel_separation_multiplier: that of the controller which made this odometry, times "
            f"{seen[0][0]:.4g}{_error(seen[0][1])}, {_shown(logs, 'gyro', [])}"
        ]
    track, sigma = _times(seen[0], robot.vehicle.track_gauge)
    return [
        f"    wheel_separation: {_number(track)}  # m, effective{_error(sigma)}, by the gyro of this log",
        "    wheel_separation_multiplier: 1.0",
        "    # With the separation between the centrelines: the effective one over that.",
    ]


def _multipliers(logs: Sequence[Log], robot: Robot) -> list[Estimate]:
    """Effective track over the gauge, of each log that shows it."""
    found = [check.measured_track(log, robot) for log in logs]
    return [_times(one, 1.0 / robot.vehicle.track_gauge) for one in found if one is not None]


def _radius_lines(logs: Sequence[Log], robot: Robot) -> list[str]:
    """Effective radius, unless the track speeds are no rates."""
    if not check.in_rates_of(robot):
        return []
    radius = robot.vehicle.sprocket_radius
    scales = [check.measured_scale(log, robot, bends=True) for log in logs]
    found = [one for one in scales if one is not None]
    comment = _not_seen(logs)
    if found:
        seen = [_times((ratio, sigma), radius) for ratio, sigma, _ in found]
        comment = _shown(logs, found[0][2], seen)
    return [f"    wheel_radius: {_number(radius)}  # m, effective: {comment}"]


def _times(one: Estimate, factor: float) -> Estimate:
    return one[0] * factor, None if one[1] is None else one[1] * factor


def _shown(logs: Sequence[Log], by: str, values: Sequence[Estimate]) -> str:
    """Text of estimates of one quantity, one for each log."""
    shown = ", ".join(f"{value:.4g}{_error(sigma)}" for value, sigma in values)
    return f"by the {by} of {'this log' if len(logs) == 1 else 'these logs'} {shown}".rstrip()


def _not_seen(logs: Sequence[Log]) -> str:
    return "this log does not show it" if len(logs) == 1 else "these logs do not show it"


def _error(sigma: float | None) -> str:
    return "" if sigma is None else f" ± {sigma:.2g}"


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


def _metres(value: float) -> str:
    """Length to the millimetre."""
    return f"{round(value, 3) + 0.0:g}"


def _word(name: str) -> str:
    return " ".join(name.split())
