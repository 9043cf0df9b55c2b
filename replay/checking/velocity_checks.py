"""Check of another odometry: scale, direction, place and scatter."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.lag_search import jackknife_sigma, without_blocks
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import BodyVelocity
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.check import SIGMAS, Check, Measured, Settings, imu_yaw_rates
from icreckon.replay.mapping.topics import topic_map

FEWEST = 100  # velocities of a driving robot that show scale, direction and place
DRIVING = 0.1  # least speed by the tracks while it drives [m/s]
# Least contradictions: of the scale [-], of the direction [deg], of the place [m]. Tracks slip, and turn
# about a point ahead of or behind the middle of the robot.
LEAST = np.array([0.1, 5.0, 0.3])
WORSE = 1.5  # least scatter that contradicts the file, over its sigma [-]
NO_SCALE = "a single camera has no scale, and some odometries leave their poses or twists unset"
OPTICAL = "poses of a camera's optical frame, z ahead, need a transform first"


def check_velocity(log: Log, robot: Robot) -> Iterator[Check]:
    """Velocity of another odometry against tracks and gyro."""
    mapped = topic_map(robot).velocity
    if mapped is None or log.imu is None or not len(log.tracks.stamps):
        return
    velocities = [other for other in log.others if isinstance(other, BodyVelocity)]
    stamps = np.array([velocity.stamp for velocity in velocities], dtype=np.int64)
    seen = np.array([complex(velocity.v_x, velocity.v_y) for velocity in velocities])
    speed = np.interp(stamps, log.tracks.stamps, log.tracks.speeds.mean(axis=1))
    rate = np.interp(stamps, *imu_yaw_rates(log.imu, robot))
    driving = np.flatnonzero(np.abs(speed) > DRIVING)
    name, in_file = "velocity of the other odometry", f"sigma {mapped.sigma:g} m/s"
    if len(driving) < FEWEST:
        yield Check(name, in_file, f"not seen: {len(driving)} values while the robot drives")
        return
    # A sensor at a place p of the robot moves by v + i w p, both turned and scaled alike.
    columns = np.column_stack([speed, 1j * rate])
    fits = [_fit(columns[rows], seen[rows]) for rows in without_blocks(driving)]
    values, sigmas = _fit(columns[driving], seen[driving]), jackknife_sigma(np.array(fits))
    scale, direction, forward, left, scatter = values.tolist()
    distance = math.hypot(forward, left)
    check = Check(
        name,
        in_file,
        f"{scale:.3f} ± {sigmas[0]:.2g} times the tracks, turned by {direction:+.1f} deg, place off by "
        f"{distance:.2f} m, scatter {scatter:.2g} m/s",
        measured=Measured(scale, "-", 1.0, float(sigmas[0])),
    )
    limits = np.maximum(LEAST, SIGMAS * np.array([*sigmas[:2], np.hypot(*sigmas[2:4])]))
    errors = np.array([abs(scale - 1.0), abs(direction), distance])
    is_scaled, is_turned, is_moved = errors > limits
    # Velocities as corrected for direction and place.
    right = seen * np.exp(-1j * np.radians(direction)) - 1j * rate * complex(forward, left)
    corrected = [
        replace(velocity, v_x=v.real, v_y=v.imag)
        for velocity, v in zip(velocities, right.tolist(), strict=True)
    ]
    settings: Settings = {}
    if is_turned:
        yaw = round(mapped.yaw_deg - direction, 1)
        problem = f"the other odometry moves {direction:+.0f} deg off the direction of driving"
        remedy, settings = f"yaw_deg = {yaw} in [log.velocity]; {OPTICAL}", {"yaw_deg": yaw}
    elif is_scaled:
        problem = f"the velocity of the other odometry is {scale:.2f} times that of the tracks"
        remedy, corrected = f"leave [log.velocity] out: {NO_SCALE}", []
    elif is_moved:
        x, y = mapped.position
        place = [round(x + forward, 2), round(y + left, 2)]
        problem = f"the sensor of the other odometry is {distance:.2f} m from the place in the file"
        remedy, settings = f"position = {place} in [log.velocity]", {"position": place}
    elif scatter > WORSE * mapped.sigma:
        problem = (
            f"the velocity of the other odometry scatters by {scatter:.2g} m/s about the tracks"
        )
        sigma = float(f"{scatter:.2g}")
        remedy, settings = f"sigma = {sigma} in [log.velocity]", {"sigma": sigma}
        corrected = [replace(velocity, variance=sigma**2) for velocity in corrected]
    else:
        yield check
        return
    rest = (other for other in log.others if not isinstance(other, BodyVelocity))
    others = tuple(sorted([*rest, *corrected], key=lambda other: other.stamp))
    yield check.contradicted(
        problem,
        remedy,
        lambda log, robot: (replace(log, others=others), robot),
        {f"log.velocity.{key}": value for key, value in settings.items()},
    )


def _fit(columns: Floats, seen: Floats) -> Floats:
    """Fit complex velocities (n,) by speeds and yaw rates (n, 2).

    Returns the scale [-], direction [deg], place forward and left [m], and scatter [m/s].
    """
    turned, moved = np.linalg.lstsq(columns, seen, rcond=None)[0]
    place = moved / turned if turned else 0j
    scatter = math.sqrt(np.mean(np.abs(seen - columns @ (turned, moved)) ** 2) / 2.0)
    return np.array([abs(turned), np.degrees(np.angle(turned)), place.real, place.imag, scatter])
