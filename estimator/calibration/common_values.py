"""Values of the robot file that every model has: radius, tracks, IMU, latency."""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import matrix_to_rpy, rpy_to_matrix
from icreckon.estimator.calibration.fit import Fit
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import Robot, Tracks, changed_robot

CERTAIN = 1.96  # number of standard errors beyond which a difference is significant (95 %)
KEPT = "not significantly different: the file's is kept"  # note on a value that is not written
FRICTION_KEPT = "not significantly different from Coulomb friction's, which is written"
"""Note on a gain that the file does not have."""
LARGEST_OFF = 0.1  # larger differences of a log's scale from the scale of all logs are clipped [-]
LEAST_LATENCY = 2e-3  # a smaller latency of the track speeds is not written to the robot file [s]


def _sigma_of_other_logs(
    chosen: Fit, supported: Sequence[Fit], name: str, file_sigma: float
) -> float:
    """Standard deviation of a parameter: by its error, logs, possible models."""
    over_models = np.mean([(fit.value(name) - chosen.value(name)) ** 2 for fit in supported])
    deviation = np.hypot(_sigma_over_logs(chosen, name, file_sigma), np.sqrt(over_models))
    return float(np.hypot(finite(chosen.sigma(name)), deviation))


def written_difference(robot: Robot, radii: Fit) -> tuple[float, str]:
    """Difference of the radii for the robot file [-], and a note on its reason.

    The file's value is kept unless the logs contradict it. A new value within its error of zero is zero.
    """
    before = robot.tracks.difference
    value, sigma = radii.value("difference"), radii.sigma("difference")
    if not radii.is_free("difference"):
        return before, ""
    is_kept = abs(value - before) <= CERTAIN * sigma
    if abs(value) > CERTAIN * sigma:
        return (before, KEPT) if is_kept else (float(value), "")
    written = before if is_kept else 0.0
    return written, f"within its error of zero: the file has {written:.4g}"


class CommonBias(NamedTuple):
    """Gyro bias of all logs, of the rate after its scale is corrected [rad/s]."""

    mean: float  # mean over the logs
    error: float | None  # standard error of that mean; None if no log shows the bias
    written: float  # initial bias for the robot file
    sigma: float  # its standard deviation, for another log


def common_bias(robot: Robot, chosen: Fit) -> CommonBias:
    """Initial gyro bias for the robot file, and its standard deviation.

    The mean over the logs is written if the robot file's bias is not within its error. The standard
    deviation is for the bias of another log, about the written one. The robot file counts as one more
    log, since few logs do not show the spread of others.
    """
    imu, scale = robot.imu, chosen.value("gyro_scale")
    values, sigmas = _values_of_logs(chosen, "gyro_bias")
    count = len(values)
    if not count:
        return CommonBias(imu.gyro_bias, None, imu.gyro_bias, imu.gyro_bias_sigma)
    biases, errors = values / scale, sigmas / scale
    mean = float(biases.mean())
    spread = float(biases.var(ddof=1)) if count > 1 else 0.0
    # The spread of the estimates contains their errors, so the larger of both counts.
    error = float(np.sqrt(max(spread / count, np.sum(errors**2) / count**2)))
    if abs(mean - imu.gyro_bias) > CERTAIN * error:
        over_logs = (np.sum((biases - mean) ** 2) + imu.gyro_bias_sigma**2) / count
        return CommonBias(mean, error, mean, float(np.sqrt(over_logs + error**2)))
    from_file = biases - imu.gyro_bias
    variance = (np.sum(from_file**2 + errors**2) + imu.gyro_bias_sigma**2) / (count + 1.0)
    sigma = float(np.sqrt(variance))
    # One log does not show how much logs differ; one that agrees with the file confirms it.
    sigma = min(sigma, imu.gyro_bias_sigma) if count == 1 else sigma
    return CommonBias(mean, error, imu.gyro_bias, sigma)


def with_common(
    robot: Robot,
    chosen: Fit,
    radii: Fit,
    supported: Sequence[Fit],
    speeds_by_radius: bool,
    kept: frozenset[str] = frozenset(),
) -> Robot:
    """Robot with radius, tracks, gyro and mounting of a fit, each with its sigma.

    Args:
        robot: the robot as described by its file.
        chosen: fit of the supported model.
        radii: fit of the likeliest model, for the difference of the radii.
        supported: fits of all models that may be right.
        speeds_by_radius: True if the scale of the track speeds corrects the sprocket radius; otherwise it
            goes into the scale of the robot's logs, or else into `tracks.scale_sigma`.
        kept: parameters whose value in the file is kept, since the logs do not contradict it. Their
            standard deviations do not increase.
    """
    fit = chosen.with_start_of(kept)  # with the values to write
    vehicle, imu, scale = robot.vehicle, robot.imu, fit.value("scale")
    if speeds_by_radius:
        radius = float(vehicle.sprocket_radius * scale)
        vehicle = msgspec.structs.replace(vehicle, sprocket_radius=radius)
    scale_sigma = _sigma_of_other_logs(fit, supported, "scale", robot.tracks.scale_sigma)
    if not speeds_by_radius and not robot.log:
        scale_sigma = float(np.hypot(scale_sigma, scale - 1.0))
    if "scale" in kept:
        scale_sigma = min(scale_sigma, robot.tracks.scale_sigma)
    bias = common_bias(robot, fit)
    rotation_rpy_deg, rotation = _mounting(robot, fit)
    over_logs = _sigma_over_logs(fit, "gyro_scale", imu.gyro_scale_sigma)
    gyro_scale_sigma = float(np.hypot(finite(fit.sigma("gyro_scale")), over_logs))
    if "gyro_scale" in kept:
        gyro_scale_sigma = min(gyro_scale_sigma, imu.gyro_scale_sigma)
    x, y, z = imu.position
    if "imu_forward" in fit.problem.names and fit.is_free("imu_forward"):
        x = x + fit.value("imu_forward")
        y = y + fit.value("imu_left") if fit.is_free("imu_left") else y
    imu = msgspec.structs.replace(
        imu,
        rotation_rpy_deg=rotation_rpy_deg,
        position=(float(x), float(y), z),
        gyro_scale=float(vertical_gyro_scale(robot, fit, rotation)),
        gyro_scale_sigma=gyro_scale_sigma,
        gyro_bias=bias.written,
        gyro_bias_sigma=bias.sigma,
    )
    tracks = _with_radii(robot, radii, supported, scale_sigma)
    new = msgspec.structs.replace(robot, vehicle=vehicle, imu=imu, tracks=tracks)
    return _with_log(new, fit, 1.0 if speeds_by_radius else scale)


def _with_radii(robot: Robot, radii: Fit, supported: Sequence[Fit], scale_sigma: float) -> Tracks:
    """Tracks with the difference of the radii, its sigma, and a sigma of their scale."""
    tracks, (difference, _) = robot.tracks, written_difference(robot, radii)
    sigma = tracks.difference_sigma
    if radii.is_free("difference"):
        new_sigma = _sigma_of_other_logs(radii, supported, "difference", sigma)
        sigma = min(new_sigma, sigma) if difference == tracks.difference else new_sigma
    return msgspec.structs.replace(
        tracks, scale_sigma=scale_sigma, difference=difference, difference_sigma=sigma
    )


def vertical_gyro_scale(robot: Robot, chosen: Fit, rotation: Floats) -> float:
    """Scale of the gyro about the vertical by the calibrated mounting (3, 3)."""
    # The scale of the fit is about the vertical by the robot file.
    if robot.imu.gyro_axes == "z":
        return chosen.value("gyro_scale") * float(robot.imu_rotation[2, 2] / rotation[2, 2])
    # Regression of the robot's rotation about the new vertical on that about the old one.
    cross = square = 0.0
    for motion in chosen.problem.recording.motions:
        if motion.log.imu is None:
            continue
        rates = motion.log.imu.angular_velocity
        centred = rates - rates.mean(axis=0)
        old, new = centred @ robot.imu_rotation[2], centred @ rotation[2]
        cross, square = cross + float(new @ old), square + float(old @ old)
    return chosen.value("gyro_scale") * cross / square


def _with_log(robot: Robot, chosen: Fit, scale: float) -> Robot:
    """Robot whose mapping, if it has tracks, corrects their latency and scale."""
    latency = chosen.value("track_latency") if chosen.is_free("track_latency") else 0.0
    for name, mapping in (("log", robot.log), ("log.columns", robot.log.get("columns", {}))):
        if "tracks" in mapping:
            tracks, changes = mapping["tracks"], {}
            if abs(latency) >= LEAST_LATENCY:
                changes["latency"] = round(float(tracks.get("latency", 0.0)) + latency, 4)
            if scale != 1.0:
                changes["scale"] = round(float(tracks.get("scale", 1.0)) * scale, 4)
            return changed_robot(robot, {f"{name}.tracks.{k}": new for k, new in changes.items()})
    return robot


def finite(sigma: float) -> float:
    """Standard error; zero for a held parameter, whose standard error is infinite."""
    return sigma if np.isfinite(sigma) else 0.0


def _sigma_over_logs(chosen: Fit, name: str, file_sigma: float) -> float:
    """Standard deviation of a parameter [-] over logs; the file counts as one more."""
    recording = chosen.problem.recording
    count, place = len(recording.motions), chosen.problem.place(name)
    if count < 2 or not chosen.free[place]:
        return file_sigma
    log_of_block = np.zeros(int(recording.block.max()) + 1, dtype=np.int64)
    log_of_block[recording.block] = recording.log
    by_log_alone = np.array([chosen.without(log_of_block != log)[place] for log in range(count)])
    # Limited: a short log alone may hardly determine the parameter.
    differences = np.minimum(np.abs(by_log_alone - chosen.values[place]), LARGEST_OFF)
    return float(np.sqrt((np.sum(differences**2) + file_sigma**2) / count))


def _mounting(robot: Robot, chosen: Fit) -> tuple[tuple[float, float, float], Floats]:
    """Roll, pitch, yaw of the IMU [deg], corrected where significant, and as a matrix."""
    turns = mounting_turns(chosen)
    roll, pitch, yaw = (turn if abs(turn) > CERTAIN * error else 0.0 for turn, error in turns)
    turned = rpy_to_matrix(roll, pitch, yaw) @ robot.imu_rotation
    roll, pitch, yaw = np.degrees(matrix_to_rpy(turned)).tolist()
    return (roll, pitch, yaw), turned


def mounting_turns(chosen: Fit) -> list[tuple[float, float]]:
    """Rotations about forward, left, up that level the IMU, and standard errors [rad]."""
    has_force = chosen.problem.force

    def tilt(name: str) -> tuple[float, float]:
        """Tilt by the mean of an accelerometer offset, and its standard error [rad]."""
        values, sigmas = _values_of_logs(chosen, name)
        count = len(values)
        if not has_force or not count:
            return 0.0, np.inf
        deviation = values.std(ddof=1) if count > 1 else 0.0
        error = max(float(np.sqrt((sigmas**2).sum())) / count, deviation / np.sqrt(count))
        return float(values.mean()) / GRAVITY, error / GRAVITY

    # A positive roll levels a force offset to the left, a positive pitch one backward.
    roll, (minus_pitch, pitch_error) = tilt("offset_left"), tilt("offset_forward")
    yaw = (0.0, np.inf)
    if has_force and chosen.is_free("mounting_yaw"):
        yaw = (chosen.value("mounting_yaw"), chosen.sigma("mounting_yaw"))
    return [roll, (-minus_pitch, pitch_error), yaw]


def _values_of_logs(chosen: Fit, name: str) -> tuple[Floats, Floats]:
    """Values (l,) of a parameter of each log that shows it, and their standard errors."""
    names = [f"{name}[{log}]" for log in range(len(chosen.problem.recording.motions))]
    free = [name for name in names if chosen.is_free(name)]
    values = [chosen.value(name) for name in free]
    return np.array(values), np.array([chosen.sigma(name) for name in free])
