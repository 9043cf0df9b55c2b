"""Checks of fixes, headings and another odometry: place, latency, offset, scale."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.base.lag_search import jackknife_sigma, without_blocks
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import BodyVelocity, HeadingFix
from icreckon.estimator.log.series import FixSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.checking.check import (
    SIGMAS,
    Check,
    Measured,
    Settings,
    imu_yaw_rates,
    mapped_table,
)
from icreckon.replay.estimates.fix_wander import FixFit, fit_fixes
from icreckon.replay.estimates.wheels import heading_offset
from icreckon.replay.mapping.topics import topic_map

LEAST_OFFSET = 10.0  # a robot that slides in bends drives some degrees off its heading [deg]
FEWEST_VELOCITIES = 100  # velocities of a driving robot that show scale, direction and place
DRIVING = 0.1  # least speed by the tracks while it drives [m/s]
# Least contradictions: of the scale [-], of the direction [deg], of the place [m]. Tracks slip, and turn
# about a point ahead of or behind the middle of the robot.
LEAST_ERRORS = np.array([0.1, 5.0, 0.3])
OTHER_SCATTER = 1.5  # least scatter that contradicts the file, over its sigma [-]
NO_SCALE = "a single camera has no scale, and some odometries leave their poses or twists unset"
OPTICAL = "poses of a camera's optical frame, z ahead, need a transform first"


def check_antenna(log: Log, robot: Robot) -> Iterator[Check]:
    """Place of the antenna of position fixes, and their latency, by odometry in bends."""
    fixes = log.fixes
    if fixes is None or log.imu is None:
        return
    places = np.unique(fixes.lever_arms, axis=0)
    name, in_file = "place of the antenna", "; ".join(map(_metres, places))
    fit = fit_fixes(log, imu_yaw_rates(log.imu, robot)) if len(places) == 1 else None
    if fit is None:
        if places.any():
            yield Check(name, in_file, "not seen: no three spans of 30 s with fixes and turns")
        return
    if fit.is_late:
        yield _latency(fixes, robot, fit)
    shift = float(np.hypot(*(fit.place - places[0, :2])))
    measured = Measured(shift, "m", 0.0, fit.sigma)
    check = Check(name, in_file, f"{_metres(fit.place)} ± {fit.sigma:.2g}", measured=measured)
    if not fit.differs(places[0, :2]):
        yield check
        return
    place = [*fit.place.round(2).tolist(), *places[0, 2:].tolist()]
    moved = replace(fixes, antennas=np.tile(place, (len(fixes.stamps), 1)))
    yield check.contradicted(
        f"the fixes are of a point {shift:.2f} m from the file's: with fixes, poses are as far off",
        f"position = {place} in [log.fixes]",
        lambda log, robot: (replace(log, fixes=moved), robot),
        {f"{mapped_table(robot, 'fixes')}.position": place},
    )


def _latency(fixes: FixSeries, robot: Robot, fit: FixFit) -> Check:
    """Contradiction of the latency of the fixes."""
    mapped, table = topic_map(robot).keys_of("fixes"), mapped_table(robot, "fixes")
    stated = 0.0 if mapped is None else mapped.latency
    in_time = replace(fixes, stamps=fixes.stamps - round(fit.lag / NANOSECOND))
    latency = stated + fit.lag
    measured = Measured(latency, "s", stated, fit.lag_sigma)
    in_log = f"{latency:.2f} ± {fit.lag_sigma:.1g} s"
    return Check("latency of the fixes", f"{stated:g} s", in_log, measured=measured).contradicted(
        f"the fixes are {abs(fit.lag):.2f} s {'late' if fit.lag > 0.0 else 'early'}",
        f"latency = {latency:.2f} in [{table}]",
        lambda log, robot: (replace(log, fixes=in_time), robot),
        {f"{table}.latency": round(latency, 2)},
    )


def _metres(place: Floats) -> str:
    """Text of a place, forward and left [m], without -0.00."""
    return f"{place[0] + 0.0:.2f}, {place[1] + 0.0:.2f} m"


def check_heading(log: Log, robot: Robot) -> Iterator[Check]:
    """Offset of a heading from the direction of driving, by fixes or truth."""
    mapped, measured_offset = topic_map(robot).keys_of("heading"), heading_offset(log)
    if mapped is None:
        return
    name, in_file = "offset of the heading", f"{mapped.offset_deg:g} deg"
    if measured_offset is None:
        yield Check(name, in_file, "not seen: no clear courses by fixes, no truth with headings")
        return
    # `read_log` has added the offset of the file to the headings.
    remaining, sigma, change, change_sigma = measured_offset
    offset = math.degrees(wrap_angle(math.radians(mapped.offset_deg + remaining)))
    check = Check(
        name,
        in_file,
        f"{offset:.1f} ± {sigma:.1g} deg, by the {'truth' if log.fixes is None else 'fixes'}",
        measured=Measured(offset, "deg", mapped.offset_deg, sigma),
    )
    if abs(change) > max(LEAST_OFFSET, SIGMAS * change_sigma):
        others = tuple(other for other in log.others if not isinstance(other, HeadingFix))
        yield check.contradicted(
            f"the headings turn by {abs(change):.0f} ± {change_sigma:.1g} deg against the "
            "direction of driving over the log",
            "leave [log.heading] out, or look what turns it: iron, currents, a lost antenna",
            lambda log, robot: (replace(log, others=others), robot),
        )
        return
    if abs(remaining) < max(LEAST_OFFSET, SIGMAS * sigma):
        yield check
        return

    def turned(log: Log, robot: Robot) -> tuple[Log, Robot]:
        """Correction of the headings."""
        others = list(log.others)
        for k, other in enumerate(others):
            if isinstance(other, HeadingFix):
                others[k] = replace(other, yaw=wrap_angle(other.yaw + math.radians(remaining)))
        return replace(log, others=tuple(others)), robot

    side = "right" if remaining > 0.0 else "left"
    yield check.contradicted(
        f"the headings are {abs(remaining):.0f} deg {side} of the direction of driving",
        f"offset_deg = {offset:.1f} in [log.heading]",
        turned,
        {f"{mapped_table(robot, 'heading')}.offset_deg": round(offset, 1)},
    )


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
    if len(driving) < FEWEST_VELOCITIES:
        yield Check(name, in_file, f"not seen: {len(driving)} values while the robot drives")
        return
    # A sensor at a place p of the robot moves by v + i w p, both turned and scaled alike.
    columns = np.column_stack([speed, 1j * rate])
    fits = [_velocity_fit(columns[rows], seen[rows]) for rows in without_blocks(driving)]
    values, sigmas = _velocity_fit(columns[driving], seen[driving]), jackknife_sigma(np.array(fits))
    scale, direction, forward, left, scatter = values.tolist()
    distance = math.hypot(forward, left)
    check = Check(
        name,
        in_file,
        f"{scale:.3f} ± {sigmas[0]:.2g} times the tracks, turned by {direction:+.1f} deg, place off by "
        f"{distance:.2f} m, scatter {scatter:.2g} m/s",
        measured=Measured(scale, "-", 1.0, float(sigmas[0])),
    )
    limits = np.maximum(LEAST_ERRORS, SIGMAS * np.array([*sigmas[:2], np.hypot(*sigmas[2:4])]))
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
    elif scatter > OTHER_SCATTER * mapped.sigma:
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


def _velocity_fit(columns: Floats, seen: Floats) -> Floats:
    """Fit complex velocities (n,) by speeds and yaw rates (n, 2).

    Returns the scale [-], direction [deg], place forward and left [m], and scatter [m/s].
    """
    turned, moved = np.linalg.lstsq(columns, seen, rcond=None)[0]
    place = moved / turned if turned else 0j
    scatter = math.sqrt(np.mean(np.abs(seen - columns @ (turned, moved)) ** 2) / 2.0)
    return np.array([abs(turned), np.degrees(np.angle(turned)), place.real, place.imag, scatter])
