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
from icreckon.replay.checking.check import SIGMAS, Check, Measured, in_base
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
    found = [other for other in log.others if isinstance(other, BodyVelocity)]
    stamps = np.array([one.stamp for one in found], dtype=np.int64)
    seen = np.array([complex(one.v_x, one.v_y) for one in found])
    speed = np.interp(stamps, log.tracks.stamps, log.tracks.speeds.mean(axis=1))
    rate = np.interp(stamps, log.imu.stamps, in_base(log.imu, robot)[0])
    drives = np.abs(speed) > DRIVING
    name, in_file = "velocity of the other odometry", f"sigma {mapped.sigma:g} m/s"
    if drives.sum() < FEWEST:
        yield Check(name, in_file, f"not seen: {int(drives.sum())} values while the robot drives")
        return
    # A sensor at a place p of the robot moves by v + i w p, both turned and scaled alike.
    columns = np.column_stack([speed, 1j * rate])
    used = np.flatnonzero(drives)
    fits = [_fit(columns[rows], seen[rows]) for rows in without_blocks(used)]
    values, sigmas = _fit(columns[used], seen[used]), jackknife_sigma(np.array(fits))
    scale, direction, forward, left, scatter = values.tolist()
    place = math.hypot(forward, left)
    check = Check(
        name,
        in_file,
        f"{scale:.3f} ± {sigmas[0]:.2g} times the tracks, turned by {direction:+.1f} deg, place off by "
        f"{place:.2f} m, scatter {scatter:.2g} m/s",
        measured=Measured(scale, "-", 1.0, float(sigmas[0])),
    )
    limits = np.maximum(LEAST, SIGMAS * np.array([*sigmas[:2], np.hypot(*sigmas[2:4])]))
    is_scaled, is_turned, is_moved = np.array([abs(scale - 1.0), abs(direction), place]) > limits
    yaw = round(mapped.yaw_deg - direction, 1)
    at = [round(mapped.position[0] + forward, 2), round(mapped.position[1] + left, 2)]
    right = seen * np.exp(-1j * np.radians(direction)) - 1j * rate * complex(forward, left)
    found = [
        replace(one, v_x=v.real, v_y=v.imag) for one, v in zip(found, right.tolist(), strict=True)
    ]
    if is_turned:
        problem = f"the other odometry moves {direction:+.0f} deg off the direction of driving"
        remedy, settings = f"yaw_deg = {yaw} in [log.velocity]; {OPTICAL}", {"yaw_deg": yaw}
    elif is_scaled:
        problem = f"the velocity of the other odometry is {scale:.2f} times that of the tracks"
        remedy, settings, found = f"leave [log.velocity] out: {NO_SCALE}", {}, []
    elif is_moved:
        problem = f"the sensor of the other odometry is {place:.2f} m from the place in the file"
        remedy, settings = f"position = {at} in [log.velocity]", {"position": at}
    elif scatter > WORSE * mapped.sigma:
        problem = (
            f"the velocity of the other odometry scatters by {scatter:.2g} m/s about the tracks"
        )
        sigma = float(f"{scatter:.2g}")
        remedy, settings = f"sigma = {sigma} in [log.velocity]", {"sigma": sigma}
        found = [replace(one, variance=sigma**2) for one in found]
    else:
        yield check
        return
    rest = (other for other in log.others if not isinstance(other, BodyVelocity))
    others = tuple(sorted([*rest, *found], key=lambda one: one.stamp))
    yield check.contradicted(
        problem,
        remedy,
        lambda log, robot: (replace(log, others=others), robot),
        {f"log.velocity.{key}": value for key, value in settings.items()},
    )


def _fit(columns: Floats, seen: Floats) -> Floats:
    """Scale [-], direction [deg], place forward, left [m], scatter [m/s]."""
    turned, moved = np.linalg.lstsq(columns, seen, rcond=None)[0]
    place = moved / turned if turned else 0j
    scatter = math.sqrt(np.mean(np.abs(seen - columns @ (turned, moved)) ** 2) / 2.0)
    return np.array([abs(turned), np.degrees(np.angle(turned)), place.real, place.imag, scatter])
