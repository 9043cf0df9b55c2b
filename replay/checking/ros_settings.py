"""Settings for ROS from a robot and its logs, as YAML with comments.

Parameters of `diff_drive_controller` (ros2_controllers), covariances for `robot_localization`, and the
mounting of the IMU as a static transform.
"""

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries
from icreckon.estimator.robot.robot_file import Robot, make_robot
from icreckon.estimator.streaming.latencies import Latencies
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.checking import check
from icreckon.replay.checking.track_checks import is_other_track
from icreckon.replay.estimates.latency import truth_lag, with_truth_in_time
from icreckon.replay.estimates.wheels import Estimate
from icreckon.replay.inspection.filled_in import has_stand_in_gauge
from icreckon.replay.mapping.topics import topic_map
from icreckon.replay.reading.read_log import read_log

ROS_FIRST_WORDS = "# Settings for ROS"
UNMEASURED = 1e3  # variance of motion that the wheels do not measure [m²/s², rad²/s²]
WINDOW = 1.0  # windows in which odometry is compared with a truth [s]
# Error of v_x and w without anything to compare with, as a share of their usual size [-].
SHARE_FORWARD, SHARE_TURNING = 0.03, 0.2
BY_DEFAULT = "by default, with nothing to compare with"
ANY_MASS = 1.0  # mass that a robot file must have, and these settings do not use [kg]


def ros_settings(
    logs: Sequence[Log],
    robot: Robot,
    *,
    source: str = "of the robot file",
    proposed: bool = False,
    corrected: Sequence[str] = (),
) -> str:
    """Format settings for ROS as YAML, for logs that were read with this robot.

    `source` is the origin of the effective track, for a comment. If `proposed`, the effective track is
    measured from the logs, and the robot's gauge stands in for one that nobody has measured. `corrected`
    names the quantities in which the logs contradicted the robot file.
    """
    # Without line breaks, which would end the comment.
    names = [" ".join(name.split()) for name in (robot.name, *(log.name for log in logs))]
    robot_name, log_names = names[0], ", ".join(names[1:])
    lines = [f"{ROS_FIRST_WORDS}, of {robot_name} on {log_names}. Every line is in SI units."]
    if corrected:
        lines.append(
            f"# The robot file contradicts the log in: {', '.join(corrected)}. These are by the log."
        )
    if any(len(log.tracks.stamps) for log in logs):
        lines += _controller_lines(logs, robot, source, proposed)
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
    has_no_gauge = math.isnan(vehicle["track_gauge"])
    if has_no_gauge:
        # A stand-in: the gauge by which the controller computed its twist, or 1 m.
        vehicle["track_gauge"] = tables.get("log", {}).get("tracks", {}).get("gauge", 1.0)
    if math.isnan(vehicle["mass"]):
        vehicle["mass"] = ANY_MASS
    robot = make_robot(name, **tables)
    log = read_log(list(paths), robot, definitions=definitions)
    return ros_settings([log], robot, proposed=has_no_gauge or has_stand_in_gauge(proposed))


def twist_errors(logs: Sequence[Log], robot: Robot) -> tuple[Estimate, Estimate]:
    """Root mean square errors of v_x [m/s] and w [rad/s] of odometry while it drives.

    Without a truth (v_x) or a gyro (w) they are shares of the usual speeds, as their sources report.
    """
    speeds = np.concatenate([log.tracks.speeds for log in logs] + [np.zeros((1, 2))])
    rates = (speeds[:, 1] - speeds[:, 0]) / robot.effective_track
    usual_speed, usual_rate = np.sqrt(np.mean(speeds**2, axis=0)).mean(), np.sqrt(np.mean(rates**2))
    forward = Estimate(SHARE_FORWARD * float(usual_speed), None, BY_DEFAULT)
    turning = Estimate(SHARE_TURNING * float(usual_rate), None, BY_DEFAULT)
    forward_errors = np.concatenate([_forward_errors(log, robot) for log in logs])
    if len(forward_errors):
        forward = Estimate(float(np.sqrt(np.mean(forward_errors**2))), None, "against the truth")
    turning_errors = np.concatenate([_turning_errors(log, robot) for log in logs])
    if len(turning_errors):
        turning = Estimate(float(np.sqrt(np.mean(turning_errors**2))), None, "against the gyro")
    return forward, turning


def _turning_errors(log: Log, robot: Robot) -> Floats:
    """Errors (n,) of the yaw rate while tracks move, by the gyro [rad/s]."""
    yaw_rates = check.comparable_yaw_rates(log, robot)
    if yaw_rates is None:
        return np.zeros(0)
    stamps, rates = yaw_rates
    tracks = log.tracks
    left, right = (np.interp(stamps, tracks.stamps, side) for side in tracks.speeds.T)
    is_moving = np.interp(stamps, tracks.stamps, np.abs(tracks.speeds).max(axis=1)) > 0.0
    errors = ((right - left) / robot.effective_track - rates)[is_moving]
    # The mean is mostly the gyro's bias.
    return np.asarray(errors - errors.mean() if len(errors) else errors)


def _forward_errors(log: Log, robot: Robot) -> Floats:
    """Errors (n,) of mean forward speeds in windows, by a truth [m/s]."""
    truth, yaw_rates = log.truth, check.comparable_yaw_rates(log, robot)
    if truth is None or not truth.headings or log.imu is None or yaw_rates is None:
        return np.zeros(0)
    in_time = with_truth_in_time(log, truth_lag(truth, log.tracks, log.imu, yaw_rates))
    motion = check.true_motion(log, in_time.truth or truth, WINDOW)
    if motion is None:
        return np.zeros(0)
    edges, moved = motion
    forward, left, turned = moved.T
    seconds = np.diff(edges) * NANOSECOND
    # The truth shows chords: an arc is longer by 1 / sinc of half its angle.
    true_speed = np.hypot(forward, left) * np.sign(forward) / seconds
    true_speed /= np.sinc(turned / (2.0 * math.pi))
    times = (log.tracks.stamps - log.tracks.stamps[0]) * NANOSECOND
    mean = log.tracks.speeds.mean(axis=1)
    distance = np.concatenate([[0.0], np.cumsum(np.diff(times) * mean[:-1])])
    edge_times = (edges - log.tracks.stamps[0]) * NANOSECOND
    speed = np.diff(np.interp(edge_times, times, distance)) / seconds
    is_driving = np.abs(speed) > 0.1 * np.abs(speed).max()
    return np.asarray((speed - true_speed)[is_driving])


def _controller_lines(logs: Sequence[Log], robot: Robot, source: str, proposed: bool) -> list[str]:
    """Lines of the controller's parameters, and the latency of its speeds."""
    (forward, turning), radius_difference = twist_errors(logs, robot), robot.tracks.difference
    tracks = topic_map(robot).track_keys
    scale = 1.0 if tracks is None or check.has_track_rates(robot) else tracks.scale
    # Variances of v_x, v_y, v_z and the rates about x, y, z.
    variances = [forward.value**2, *[UNMEASURED] * 4, turning.value**2]
    lines = [
        "# ros2_controllers, diff_drive_controller: merge into its parameters.",
        "diff_drive_controller:",
        "  ros__parameters:",
        *(_proposed_separation(logs, robot) if proposed else _separation(logs, robot, source)),
        *_radius_lines(logs, robot),
        f"    left_wheel_radius_multiplier: {scale * (1.0 - 0.5 * radius_difference):.4f}",
        f"    right_wheel_radius_multiplier: {scale * (1.0 + 0.5 * radius_difference):.4f}",
        f"    # v_x: {forward.value:.2g} m/s {forward.source}; "
        f"w: {turning.value:.2g} rad/s {turning.source}",
        f"    twist_covariance_diagonal: {_numbers(variances)}",
        "# robot_localization: fuse v_x and v_yaw of this odometry (not its pose) and v_yaw of the IMU.",
    ]
    if latency := Latencies.of(robot).tracks:
        lines.append(
            f"# Track speeds are stamped {latency:.3g} s late. No parameter here takes that off: let "
            "their driver restamp them."
        )
    return lines


def _imu_lines(samples: ImuSeries, robot: Robot) -> list[str]:
    """Lines of covariances for the IMU's driver, and of the transform of its mounting."""
    imu = robot.imu
    step = float(np.median(np.diff(samples.stamps))) * NANOSECOND
    rate_variance = imu.gyro_noise_density**2 / step
    force_variance = imu.accelerometer_noise_density**2 / step
    # To the millimetre, without -0.0.
    x, y, z = (round(length, 3) + 0.0 for length in imu.position)
    roll, pitch, yaw = np.radians(imu.rotation_rpy_deg)
    return [
        f"# The IMU's driver, at {1.0 / step:.0f} Hz; its bias about the vertical is "
        f"{imu.gyro_bias:.2g} ± {imu.gyro_bias_sigma:.2g} rad/s, and no covariance.",
        "imu_driver:  # the name of your IMU's driver, which may name these otherwise",
        "  ros__parameters:",
        f"    angular_velocity_covariance_diagonal: {_numbers([rate_variance] * 3)}",
        f"    linear_acceleration_covariance_diagonal: {_numbers([force_variance] * 3)}",
        "# ros2 run tf2_ros static_transform_publisher --frame-id base_link --child-frame-id imu_link "
        f"--x {x:g} --y {y:g} --z {z:g} --roll {roll:.5f} --pitch {pitch:.5f} --yaw {yaw:.5f}",
    ]


def _separation(logs: Sequence[Log], robot: Robot, source: str) -> list[str]:
    """Lines of the wheel separation and its multiplier.

    The multiplier of the robot, whose origin is `source`, or the measured one if it contradicts that.
    """
    gauge, multiplier = robot.vehicle.track_gauge, robot.constant_indices.eta0
    comment = f"{source}; {_unknown(logs)}"
    if measured := _measured_multipliers(logs, robot):
        comment = f"{source}; {_evidence(logs, measured)}"
        mean = float(np.mean([estimate.value for estimate in measured]))
        if is_other_track(mean / multiplier):
            comment = f"{_evidence(logs, measured)}, which contradicts {multiplier:.4g} {source}"
            multiplier = mean
    if (tracks := topic_map(robot).track_keys) and not (tracks.left or tracks.gauge):
        comment += "; times that of the controller which made this odometry"
    return [
        f"    wheel_separation: {_number(gauge)}  # m, between the centrelines",
        f"    wheel_separation_multiplier: {_number(multiplier)}  # {comment}",
        f"    # Effective wheel separation: {multiplier * gauge:.3g} m.",
    ]


def _proposed_separation(logs: Sequence[Log], robot: Robot) -> list[str]:
    """Lines of the effective wheel separation, where nobody has measured the gauge."""
    measured = _measured_multipliers(logs, robot)
    if not measured:
        return [f"    # wheel_separation and its multiplier: {_unknown(logs)}."]
    multiplier = measured[0]
    if topic_map(robot).from_twist:
        return [
            "    # wheel_separation_multiplier: that of the controller which made this odometry, times "
            f"{multiplier.value:.4g}{multiplier.error}, by the gyro of {_which(logs)}"
        ]
    # The product does not depend on the stand-in for the gauge.
    track = multiplier.times(robot.vehicle.track_gauge)
    remark = f"m, effective{track.error}, by the gyro of {_which(logs)}"
    return [
        f"    wheel_separation: {_number(track.value)}  # {remark}",
        "    wheel_separation_multiplier: 1.0",
        "    # With the separation between the centrelines: the effective one over that.",
    ]


def _measured_multipliers(logs: Sequence[Log], robot: Robot) -> list[Estimate]:
    """Effective track over the robot's gauge, of each log that shows it."""
    tracks = [check.measured_track(log, robot) for log in logs]
    return [track.times(1.0 / robot.vehicle.track_gauge) for track in tracks if track is not None]


def _radius_lines(logs: Sequence[Log], robot: Robot) -> list[str]:
    """Line of the effective radius; none if track speeds are not wheel rates."""
    if not check.has_track_rates(robot):
        return []
    radius = robot.vehicle.sprocket_radius
    scales = [check.measured_scale(log, robot, with_bends=True) for log in logs]
    measured = [scale.times(radius) for scale in scales if scale is not None]
    comment = _evidence(logs, measured) if measured else _unknown(logs)
    return [f"    wheel_radius: {_number(radius)}  # m, effective: {comment}"]


def _which(logs: Sequence[Log]) -> str:
    return "this log" if len(logs) == 1 else "these logs"


def _evidence(logs: Sequence[Log], estimates: Sequence[Estimate]) -> str:
    """Text of estimates from one source, such as "by the gyro of this log 0.62"."""
    values = ", ".join(f"{estimate.value:.4g}{estimate.error}" for estimate in estimates)
    return f"by the {estimates[0].source} of {_which(logs)} {values}"


def _unknown(logs: Sequence[Log]) -> str:
    """Comment on a quantity that no log shows."""
    return f"{_which(logs)} {'does' if len(logs) == 1 else 'do'} not show it"


def _numbers(values: list[float]) -> str:
    """List for YAML, to three digits."""
    return f"[{', '.join(_number(value, 3) for value in values)}]"


def _number(value: float, digits: int = 4) -> str:
    """Number to significant digits, with a point: YAML 1.1 reads 1e3 as a text."""
    return str(np.format_float_positional(value, digits, fractional=False, trim="0", unique=False))
