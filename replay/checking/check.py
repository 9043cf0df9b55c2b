"""Record of a check, mending of a log or a robot, and the IMU in base_link."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import matrix_to_rpy
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Imu, Robot
from icreckon.replay.inspection.imu_mounting import ENOUGH_STILL, are_usable, rate_about, standstill
from icreckon.replay.inspection.robot_file import in_rates
from icreckon.replay.mapping.columns import TrackKeys
from icreckon.replay.mapping.topics import topic_map

# Standard errors from which a difference is one.
SIGMAS = 3.0
MOUNTING, FORWARD = "tilt of the IMU", "forward axis of the IMU"
SCALE, TRACK, LATENCY = "scale of the tracks", "effective track", "latency of the tracks"

Mend = Callable[[Log, Robot], tuple[Log, Robot]]


class Measured(NamedTuple):
    """Quantity that a log shows."""

    value: float  # the estimate
    unit: str  # "m", "s", ...; "-" for none
    expected: float | None = None  # value by the robot file, None if the file has none
    sigma: float | None = None  # standard error of the estimate, None if unknown


@dataclass(frozen=True)
class Check:
    """One quantity of a robot file, compared with a log.

    Attributes:
        name: the quantity.
        in_file: value of the file, with its unit.
        in_log: value that the log shows, with its unit and error; empty if it shows none.
        problem: what contradicts, in a sentence; empty if nothing does.
        remedy: what to set in the file.
        mend: log and robot with this mended, None if it cannot be.
        measured: the numbers behind `in_file` and `in_log`, None if the log shows none.
        settings: values to set in the robot file by dotted key, such as "log.tracks.latency"; empty if
            no single key mends it.
    """

    name: str
    in_file: str
    in_log: str
    problem: str = ""
    remedy: str = ""
    mend: Mend | None = None
    measured: Measured | None = None
    settings: dict[str, float | list[float]] = field(default_factory=dict)

    def contradicted(
        self,
        problem: str,
        remedy: str,
        mend: Mend | None = None,
        settings: dict[str, float | list[float]] | None = None,
    ) -> Check:
        """Copy that contradicts the file; arguments as the attributes."""
        return replace(self, problem=problem, remedy=remedy, mend=mend, settings=settings or {})


def mended(log: Log, robot: Robot, checks: Iterable[Check]) -> tuple[Log, Robot]:
    """Mend log and robot by the checks that can, one after the other."""
    for one in checks:
        if one.mend is not None:
            log, robot = one.mend(log, robot)
    return log, robot


def in_base(imu: ImuSeries, robot: Robot) -> tuple[Floats, Floats | None]:
    """Yaw rate (n,) and specific force (n, 3) in base_link, by the robot file."""
    rotation = robot.imu_rotation
    vertical = rate_about(rotation[2], imu.angular_velocity, robot.imu.gyro_axes)
    force = imu.linear_acceleration
    return vertical, None if force is None else np.asarray(force @ rotation.T)


def in_rates_of(robot: Robot) -> bool:
    """True if the track speeds of a robot's logs are rates, multiplied by its radius."""
    return in_rates(topic_map(robot, robot.name)) if robot.log else True


def from_twist(robot: Robot) -> bool:
    """True if the track speeds of a robot's logs are computed from speed and yaw rate."""
    tracks = mapped_tracks(robot)
    return tracks is not None and not tracks.left


def mapped_tracks(robot: Robot) -> TrackKeys | None:
    """Map of the track speeds of a robot's logs; None if there is none."""
    mapping = topic_map(robot, robot.name)
    return mapping.columns.tracks if mapping.columns and not mapping.tracks else mapping.tracks


def tracks_table(robot: Robot) -> str:
    """Table of a robot file that maps the track speeds."""
    return (
        "log.columns.tracks"
        if "columns" in robot.log and "tracks" not in robot.log
        else "log.tracks"
    )


def still_samples(log: Log) -> NDArray[np.bool_] | None:
    """IMU samples (n,) at standstill, None if there are too few."""
    if log.imu is None or len(log.imu.stamps) < 2 or not are_usable(log.tracks):
        return None
    still = standstill(log.tracks, log.imu.stamps)
    step = float(np.median(np.diff(log.imu.stamps))) * NANOSECOND
    return still if float(still.sum()) * step >= ENOUGH_STILL else None


def with_imu(**values: object) -> Mend:
    """Mending of the robot's IMU."""

    def mended(log: Log, robot: Robot) -> tuple[Log, Robot]:
        imu: Imu = structs.replace(robot.imu, **values)
        return log, structs.replace(robot, imu=imu)

    return mended


def with_speeds(change: Callable[[Floats], Floats]) -> Mend:
    """Mending of the track speeds (n, 2)."""

    def mended(log: Log, robot: Robot) -> tuple[Log, Robot]:
        tracks = TrackSpeedSeries(log.tracks.stamps, change(log.tracks.speeds))
        return replace(log, tracks=tracks), robot

    return mended


def rounded_angles(rotation: Floats) -> tuple[float, ...]:
    """Roll, pitch and yaw of a rotation (3, 3), to the tenth [deg]."""
    return tuple(round(math.degrees(angle), 1) + 0.0 for angle in matrix_to_rpy(rotation))


def angles_text(values: tuple[float, float, float]) -> str:
    """Text of three angles [deg]."""
    return f"{', '.join(f'{value:g}' for value in values)} deg"
