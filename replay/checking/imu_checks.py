"""Checks of the IMU in a robot file: unit, mounting, bias and noise."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import matrix_to_rpy, rpy_to_matrix
from icreckon.estimator.log.failed_sensors import working_imu
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import LEAST_UPRIGHT, Robot
from icreckon.replay.checking.check import (
    FORWARD,
    MOUNTING,
    Check,
    Measured,
    comparable_yaw_rates,
    force_in_base,
    imu_yaw_rates,
    with_imu,
)
from icreckon.replay.estimates import imu_mounting
from icreckon.replay.estimates.gyro_bias import gyro_bias
from icreckon.replay.estimates.wheels import GRAVITY, WRONG_GRAVITY, unit_of_gravity
from icreckon.replay.inspection.robot_file import STANDING_BIAS_SIGMA

# Smallest tilt of a mounting that is reported, and that from which a mounting is another one [deg].
LEAST_TILT, ANOTHER_MOUNTING = 5.0, 45.0
# Mean speed of the robot as a share of that of its tracks, from which accelerations show its axes [-].
LEAST_DRIVING = 0.3
FEWEST_SPEEDS = 20  # fewest track speeds that show anything
USUAL_LEVER = 0.3  # distance of the centre of turning from the robot's centre that is usual [m]
# Relative error of the mean specific force up to which no unit, but scale or offset explains it [-].
OFFSET_OF_GRAVITY = 0.3
BIAS_SIGMAS = 2.5  # offset of gravity that the file's accelerometer_bias_sigma explains, in these
LEAST_IN_MG = 500.0  # mean specific force from which its unit is mg rather than g [m/s²]
OTHER_NOISE = 3.0  # measured noise density over the file's that is reported [-]
SOON = 30.0  # a bias that a standstill shows later than this costs drift until then [s]
FEWEST_STILL = 20  # fewest pairs of neighbouring samples at standstill that show the noise


def check_samples(log: Log, robot: Robot) -> Iterator[Check]:
    """Report too few track speeds, and an IMU that is missing or fails."""
    count = len(log.tracks.stamps)
    if count < FEWEST_SPEEDS:
        problem = f"the log has {count} track speeds: too few to check anything"
        remedy = "the topic in [log.tracks]; icreckon inspect lists those of the log"
        if count:
            remedy = "a log of half a minute or more, with bends"
        yield Check("track speeds", "a log", f"{count} samples", problem, remedy)
    elif log.imu is None:
        columns = "its columns" if "imu" in robot.log.get("columns", {}) else None
        if source := robot.log.get("imu", {}).get("topic", columns):
            problem = f"the log has no IMU sample on {source}: the tracks alone give the heading"
            remedy = "the right topic in [log.imu]; icreckon inspect lists those of the log"
            yield Check("IMU", str(source), "no sample", problem, remedy)
    elif (largest := np.abs(log.imu.angular_velocity).max(initial=0.0)) > imu_mounting.ABSURD:
        yield Check("gyro", "rad/s", f"up to {largest:.3g} rad/s").contradicted(
            f"the gyro reads {largest:.3g} rad/s",
            'rate_unit in [log.imu] ("deg/s", "mdps"), or its driver',
            lambda log, robot: (replace(log, imu=None), robot),
        )
    elif failure := working_imu(log, robot.imu_rotation[2])[1]:
        yield Check("IMU's span", "whole log", failure).contradicted(
            f"the IMU {failure}",
            "look at its driver and cable, or cut the log",
            lambda log, robot: (working_imu(log, robot.imu_rotation[2])[0], robot),
        )


def check_gravity(log: Log, robot: Robot) -> Iterator[Check]:
    """Unit of the accelerometer, by the mean specific force."""
    imu = log.imu
    if imu is None or imu.linear_acceleration is None:
        return
    size = float(np.linalg.norm(np.nanmean(imu.linear_acceleration, axis=0)))
    measured = Measured(size, "m/s²", GRAVITY)
    check = Check("mean specific force", f"{GRAVITY} m/s²", f"{size:.4g} m/s²", measured=measured)
    usual = BIAS_SIGMAS * robot.imu.accelerometer_bias_sigma
    if abs(size - GRAVITY) <= max(WRONG_GRAVITY * GRAVITY, usual):
        yield check
        return
    has_gravity = size > imu_mounting.NO_GRAVITY
    unit = "mg" if size > LEAST_IN_MG else "g"
    remedy = f'acceleration_unit = "{unit}" in [log.imu], where the driver publishes {unit}'
    if abs(size - GRAVITY) <= OFFSET_OF_GRAVITY * GRAVITY:
        remedy = "the accelerometer's scale or offset: calibrate it, or scale it in the driver"
    if not has_gravity:
        remedy = "the driver, or the columns: accelerations without gravity show no attitude"

    def scaled(log: Log, robot: Robot) -> tuple[Log, Robot]:
        """Correct the size of the specific force, or remove it if it has no gravity."""
        if log.imu is None or log.imu.linear_acceleration is None:
            return log, robot
        force = log.imu.linear_acceleration * (GRAVITY / size) if has_gravity else None
        return replace(log, imu=replace(log.imu, linear_acceleration=force)), robot

    yield check.contradicted(
        f"the accelerometer reads {size:.4g} m/s² on average, not {GRAVITY}{unit_of_gravity(size)}",
        remedy,
        scaled,
    )


def check_mounting(log: Log, robot: Robot) -> Iterator[Check]:
    """Roll and pitch of the IMU, by gravity.

    A small tilt turns the mounting of the file. A large one replaces it, yaw and all. No tilt is
    corrected if a gyro of the z axis alone would then lie down.
    """
    if log.imu is None:
        return
    rate, force = imu_yaw_rates(log.imu, robot).rates, force_in_base(log.imu, robot)
    if force is None:
        return
    up = np.nanmean(force, axis=0)
    if not np.linalg.norm(up) > 0.0:  # zero or NaN
        return
    up = up / np.linalg.norm(up)
    tilt = math.degrees(math.acos(min(1.0, max(-1.0, float(up[2])))))
    in_file = _angles_text(robot.imu.rotation_rpy_deg)
    in_log = f"{tilt:.1f} deg off the file, by gravity"
    check = Check(MOUNTING, in_file, in_log, measured=Measured(tilt, "deg", 0.0))
    # The mean force also holds the centripetal force, of the IMU's lever arm and of driving bends.
    forward, left, _ = robot.imu.position
    centripetal = float(np.mean(rate**2)) * (math.hypot(forward, left) + USUAL_LEVER)
    if imu_mounting.are_usable(log.tracks):
        speed = np.interp(log.imu.stamps, log.tracks.stamps, log.tracks.speeds.mean(axis=1))
        centripetal += abs(float(np.mean(speed * rate)))
    if tilt <= LEAST_TILT + math.degrees(math.atan(centripetal / GRAVITY)):
        yield check
        return
    mounting = imu_mounting.estimate_mounting(log) if tilt > ANOTHER_MOUNTING else None
    rotation = _turn_upright(up) @ robot.imu_rotation
    if mounting is not None:
        rotation = rpy_to_matrix(*np.radians(mounting.rotation_rpy_deg))
    angles = _rounded_angles(rotation)
    roll, pitch, _ = np.radians(angles)
    is_upright = abs(np.cos(roll) * np.cos(pitch)) >= LEAST_UPRIGHT
    can_correct = robot.imu.gyro_axes == "xyz" or is_upright
    upside_down = " (upside down)" if tilt > 180.0 - ANOTHER_MOUNTING else ""
    yield check.contradicted(
        f"gravity shows the IMU {tilt:.1f} deg off its mounting in the file{upside_down}",
        f"rotation_rpy_deg = {list(angles)} in [imu]",
        with_imu(rotation_rpy_deg=angles) if can_correct else None,
        {"imu.rotation_rpy_deg": list(angles)},
    )


def _rounded_angles(rotation: Floats) -> tuple[float, ...]:
    """Roll, pitch and yaw of a rotation (3, 3), to the tenth [deg], without -0.0."""
    return tuple(round(math.degrees(angle), 1) + 0.0 for angle in matrix_to_rpy(rotation))


def _angles_text(values: tuple[float, float, float]) -> str:
    """Text of three angles [deg]."""
    return f"{', '.join(f'{value:g}' for value in values)} deg"


def _turn_upright(up: Floats) -> Floats:
    """Smallest rotation (3, 3) of a unit vector onto the z axis (Rodrigues)."""
    x, y, z = up
    if z < -1.0 + 1e-9:  # opposite: any horizontal axis does
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))


def check_forward(log: Log, robot: Robot) -> Iterator[Check]:
    """Yaw of the IMU's mounting, to the next 90 degrees, by accelerations."""
    if log.imu is None or len(log.imu.stamps) < 2 or not imu_mounting.are_usable(log.tracks):
        return
    force, speeds = force_in_base(log.imu, robot), log.tracks.speeds
    is_driving = np.abs(speeds.mean(axis=1)).mean() > LEAST_DRIVING * np.abs(speeds).mean()
    if force is None or not is_driving:
        return
    horizontal = np.nan_to_num(force[:, :2])
    yaw = imu_mounting.forward_yaw(log.tracks, imu_yaw_rates(log.imu, robot), horizontal)
    in_file = _angles_text(robot.imu.rotation_rpy_deg)
    if yaw is None:
        yield Check(FORWARD, in_file, "not seen: accelerations fit no multiple of 90 deg clearly")
        return
    in_log = f"{yaw:+.0f} deg about the vertical" if yaw else "as the tracks accelerate"
    check = Check(FORWARD, in_file, in_log, measured=Measured(yaw, "deg", 0.0))
    if yaw != 0.0:
        about_z = rpy_to_matrix(0.0, 0.0, math.radians(yaw))
        angles = _rounded_angles(about_z @ robot.imu_rotation)
        check = check.contradicted(
            f"the IMU is mounted {yaw:+.0f} deg about the vertical from what the file says, by its "
            "accelerations",
            f"rotation_rpy_deg = {list(angles)} in [imu]",
            with_imu(rotation_rpy_deg=angles),
            {"imu.rotation_rpy_deg": list(angles)},
        )
    yield check


def check_bias(log: Log, robot: Robot) -> Iterator[Check]:
    """Bias of the gyro at standstill, or else by truth or tracks."""
    if log.imu is None:
        return
    bias = gyro_bias(log, imu_yaw_rates(log.imu, robot), robot.imu.gyro_noise_density)
    if bias is None:
        return
    stated, sigma = robot.imu.gyro_bias, robot.imu.gyro_bias_sigma
    in_file = f"{stated:+.5f} ± {sigma:g} rad/s"
    in_log = f"{bias.value:+.5f} ± {bias.sigma:.4f} rad/s by the {bias.source}"
    if bias.source == "standstill":
        in_log = f"{bias.value:+.5f} rad/s at standstill"
    first = log.imu.stamps <= log.tracks.stamps[0] + round(SOON / NANOSECOND)
    imu = log.imu.stamps[first], log.imu.angular_velocity[first]
    if not imu_mounting.standstill(log.tracks, *imu).any():
        # Without a standstill no filter learns a bias soon.
        sigma = min(sigma, STANDING_BIAS_SIGMA)
    measured = Measured(bias.value, "rad/s", stated, bias.sigma)
    check = Check("gyro bias", in_file, in_log, measured=measured)
    if bias.differs(stated, sigma):
        check = check.contradicted(
            f"the gyro has a bias of {in_log}, the file has {in_file}",
            f"gyro_bias = {bias.value:.5f} in [imu], or a larger gyro_bias_sigma",
            with_imu(gyro_bias=min(1.0, max(-1.0, bias.value))),
            {"imu.gyro_bias": round(bias.value, 5)},
        )
    yield check


def check_noise(log: Log, robot: Robot) -> Iterator[Check]:
    """Noise density of the gyro at standstill, by differences of neighbouring samples."""
    yaw_rates = comparable_yaw_rates(log, robot)
    if yaw_rates is None or len(yaw_rates.stamps) < 2:
        return
    stamps, rates = yaw_rates
    is_still = imu_mounting.standstill(log.tracks, stamps, rates)
    step = float(np.median(np.diff(stamps))) * NANOSECOND
    still_pairs = int((is_still[1:] & is_still[:-1]).sum())
    if is_still.sum() * step < imu_mounting.ENOUGH_STILL or still_pairs < FEWEST_STILL:
        return
    noise, stated = imu_mounting.density(rates, is_still, step), robot.imu.gyro_noise_density
    in_file, in_log = f"{stated:.2g} rad/s/√Hz", f"{noise:.2g} rad/s/√Hz at standstill"
    check = Check("gyro noise", in_file, in_log, measured=Measured(noise, "rad/s/√Hz", stated))
    if noise > OTHER_NOISE * stated:
        check = check.contradicted(
            f"at standstill the gyro shakes {noise / stated:.0f} times as much as the file says",
            f"gyro_noise_density = {noise:.2g} in [imu] (the filter measures noise, too)",
            with_imu(gyro_noise_density=noise),
            {"imu.gyro_noise_density": float(f"{noise:.2g}")},
        )
    yield check
