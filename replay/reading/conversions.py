"""Conversion of message rows to measured values, shared by logs and live messages.

Rows are those of `message_rows`, one or many of one topic; nothing here depends on other messages.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.frames import wrap_angle, yaw_to_quaternion
from icreckon.estimator.log.body_velocities import body_velocities, of_twists
from icreckon.estimator.log.measurements import BodyVelocity, HeightFix
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Vehicle
from icreckon.replay.bags.message_types import IMU
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.mapping.columns import (
    AngleUnit,
    HeadingColumns,
    ImuColumns,
    PoseColumns,
    TrackColumns,
)
from icreckon.replay.mapping.field_paths import field_reader
from icreckon.replay.mapping.topics import (
    FixTopic,
    HeadingTopic,
    ImuTopic,
    TrackTopic,
    VelocityTopic,
)
from icreckon.replay.mapping.track_units import metres
from icreckon.replay.reading.message_rows import BODY_READERS, TWIST, imu_row, planar_poses
from icreckon.replay.reading.stream import Readers, Row, RowReader

STANDARD_GRAVITY = 9.80665  # acceleration of a unit g [m/s²]
RATES = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "mdps": math.pi / 180e3}
ACCELERATIONS = {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}
WORSE = 3.0  # stated sigma over the median from which a position is no truth, as of a float fix [-]
WHOLE_DEGREES = 1e4  # beyond this whole numbers are 1e-7 deg, heights in mm (u-blox, MAVLink, PX4)
LEAST_WHOLE_SIGMA = 10.0  # whole sigmas from here on, with such degrees, are in mm (u-blox)
LEAST_JUMP = 340.0  # least jump of a yaw that is in degrees, and at most 360
NO_PLACE = 0.02  # places nearer to latitude and longitude 0 may be simulated ones [deg]
NO_HEADING_VARIANCE = 1e3  # yaw variance [rad²] from which a fix is assumed to have no heading


def imu_rows(spec: ImuTopic | ImuColumns, values: Floats) -> Floats:
    """Rows as of `message_rows.imu_row` from the values of named fields or columns.

    `values` (n, k) are in the order of angular_velocity, linear_acceleration.
    """
    axes = len(spec.angular_velocity) or 3
    rates, forces = values[:, :axes], values[:, axes:]
    if axes == 1:
        none = np.where(np.isnan(rates), rates, 0.0)
        rates = np.column_stack([none, none, rates])
    if not forces.shape[1]:
        forces = np.full((len(values), 3), np.nan)
    rate, force = spec.rate_unit, spec.acceleration_unit
    of_rates = RATES[rate] if isinstance(rate, str) else rate
    of_forces = ACCELERATIONS[force] if isinstance(force, str) else force
    return np.column_stack([rates * of_rates, forces * of_forces])


def imu_readers(spec: ImuTopic) -> tuple[Readers, Readers]:
    """Build the readers of an IMU's topic, and of accelerations apart.

    Each is a pair: readers by message type, and that of named fields or None. Rows are those of
    `imu_rows`, with NaN for what the other topic has.
    """
    rates, forces = spec.angular_velocity, spec.linear_acceleration
    is_apart = spec.acceleration_topic is not None
    if not spec.names:
        parts = slice(0, 3) if is_apart else slice(0, 6), slice(3, 6)
        first, other = (({IMU: _imu_reader(spec, part)}, None) for part in parts)
        return first, other

    def of_forces(values: Floats) -> Floats:
        return imu_rows(spec, np.column_stack([np.full((1, len(rates)), np.nan), values]))

    of_rates = field_reader(rates if is_apart else spec.names, partial(imu_rows, spec))
    return ({}, of_rates), ({}, field_reader(forces, of_forces))


def _imu_reader(spec: ImuTopic, only: slice) -> RowReader:
    """Reader of these columns of Imu in the units of the mapping, NaN for others."""
    if spec.rate_unit == "rad/s" and spec.acceleration_unit == "m/s2" and only == slice(0, 6):
        return imu_row

    def read(message: Any) -> Row:
        row = np.full((1, 6), np.nan)
        row[0, only] = imu_row(message)[only]
        return tuple(imu_rows(spec, row)[0].tolist())

    return read


def pose_rows(spec: FixTopic | PoseColumns, rows: Floats) -> Floats:
    """Rows as of `message_rows.POSE_READERS`, or `GEODETIC_READERS`.

    The result is made of rows (n, k) with the fields or columns `spec.names`.
    """
    values = dict(zip(spec.names, rows.T, strict=True))
    unknown = np.full(len(rows), np.nan)
    variance = values[spec.sigma] ** 2 if spec.sigma else unknown
    if spec.latitude and spec.longitude:
        altitude = values[spec.altitude] if spec.altitude else unknown
        places = np.column_stack([values[spec.latitude], values[spec.longitude], altitude])
        of_place, of_sigma = _units_of_places(places, np.sqrt(variance))
        return np.column_stack([places * of_place, variance * of_sigma**2])
    yaw = in_radians(spec.yaw, values[spec.yaw], spec.yaw_unit) if spec.yaw else unknown
    x, y = values[spec.x or ""], values[spec.y or ""]
    return np.column_stack([x, y, yaw_to_quaternion(yaw), variance, *([unknown] * 5)])


def in_radians(name: str, yaw: Floats, unit: AngleUnit) -> Floats:
    """Convert headings (n,) to rad; a ReplayError if they are not in `unit`."""
    if unit == "rad" and jumps_by_360(yaw):
        raise ReplayError(f'{name!r} jumps by 360, so it is in degrees: set its unit to "deg"')
    return np.radians(yaw) if unit == "deg" else yaw


def jumps_by_360(yaw: Floats) -> bool:
    """Return True if headings (n,) jump as degrees do at the end of a turn."""
    steps = np.abs(np.diff(yaw))
    return bool(((steps > LEAST_JUMP) & (steps <= 360.0)).any())


def _units_of_places(places: Floats, sigmas: Floats) -> tuple[tuple[float, float, float], float]:
    """Choose the units of places (n, 3) and of sigmas (n,), by their size.

    Returns the factors of latitude, longitude and altitude to degrees and metres, and of sigma to metres.
    """
    known = np.isfinite(places[:, :2]).all(axis=1)
    latitudes, longitudes = np.abs(places[known, :2]).T
    coarse = sigmas[np.isfinite(sigmas)]
    is_whole = len(coarse) > 0 and not (coarse % 1.0).any()
    if latitudes.max(initial=0.0) > WHOLE_DEGREES and not (places[known, :2] % 1.0).any():
        in_mm = is_whole and bool(coarse.min() >= LEAST_WHOLE_SIGMA)
        return (1e-7, 1e-7, 1e-3), 1e-3 if in_mm else 1.0
    # Degrees of this size are in the Gulf of Guinea, but for the origin of simulated worlds.
    is_far = latitudes.max(initial=0.0) > NO_PLACE or longitudes.max(initial=0.0) > NO_PLACE
    if is_far and (latitudes <= 0.5 * math.pi).all() and (longitudes <= math.pi).all():
        # Septentrio's receivers state radians, and sigmas in whole centimetres.
        return (180.0 / math.pi, 180.0 / math.pi, 1.0), 1e-2 if is_whole else 1.0
    return (1.0, 1.0, 1.0), 1.0


def fix_heights(
    stamps: Stamps, heights: Floats, spec: FixTopic | PoseColumns
) -> tuple[HeightFix, ...]:
    """Fixes of the height; none without `height_sigma`.

    `heights` (n,) are z of the fixes, or the altitude above the origin [m]; NaN for unknown.
    """
    if spec.height_sigma is None:
        return ()
    known, variance = np.isfinite(heights), spec.height_sigma**2
    rows = zip(stamps[known].tolist(), heights[known].tolist(), strict=True)
    return tuple(HeightFix(stamp, z, variance) for stamp, z in rows)


class WheelValues(NamedTuple):
    """Speeds of wheels or tracks, or readings of their cumulative counters."""

    values: Floats  # (n, k) of the wheels, left ones first: speeds [m/s] or counters [m]
    left_count: int = 1  # number of left wheels
    are_counters: bool = False  # whether the values are counters, whose differences are the motion
    wrap: float | None = None  # range of the counters [m], or None


def is_twist(msgtype: str, mapped: TrackTopic | TrackColumns) -> bool:
    """Test for rows with speed and yaw rate of the robot, not a value of each wheel."""
    # Wheels are always named, so a type without names is a twist, too.
    return msgtype in BODY_READERS or not mapped.left


def wheel_values(
    rows: Floats, msgtype: str, mapped: TrackTopic | TrackColumns, vehicle: Vehicle
) -> WheelValues:
    """Convert the rows of `message_rows.track_readers`, or of a table."""
    if is_twist(msgtype, mapped):
        # Forward speed [m/s] and yaw rate [rad/s] of a controller, by its own gauge.
        forward, w = (rows * mapped.scale).T
        half_difference = 0.5 * (mapped.gauge or vehicle.track_gauge) * w
        return WheelValues(np.column_stack([forward - half_difference, forward + half_difference]))
    factor = mapped.scale * metres(mapped.unit, vehicle.sprocket_radius, mapped.counts_per_turn)
    wrap = None if mapped.wrap is None else mapped.wrap * factor
    values = rows * mapped.signs * factor
    return WheelValues(values, len(mapped.left), mapped.are_counters, wrap)


def fill_variances(variances: Floats, mapped: FixTopic | PoseColumns) -> NDArray[np.bool_]:
    """Fill in missing variances of fixes in place, and raise too small ones.

    `variances` (n, 2) are of each coordinate [m²] and of yaw [rad²]; NaN for unknown. Messages state the
    whole error; if a part of it wanders, `position_sigma` is the rest. Returns the (n,) mask of the fixes
    whose position variance is still unknown.
    """
    position_variances, yaw_variances = variances[:, 0], variances[:, 1]
    unknown = np.isnan(position_variances)
    if mapped.position_sigma is not None:
        if mapped.wander_sigma:
            position_variances[position_variances > 0.0] = mapped.position_sigma**2
        position_variances[unknown] = mapped.position_sigma**2
        unknown = np.zeros(len(variances), dtype=bool)
    if mapped.heading_sigma is not None:
        yaw_variances[np.isnan(yaw_variances)] = mapped.heading_sigma**2
    if mapped.least_sigma is not None:
        least = mapped.least_sigma**2
        position_variances[(position_variances > 0.0) & (position_variances < least)] = least
    return unknown


def without_unknown_headings(poses: Floats, variances: Floats) -> Floats:
    """Poses (n, 3) x, y, yaw with a yaw of NaN where it has no usable variance."""
    _, yaw_variances = variances.T
    unknown = np.isnan(yaw_variances) | (yaw_variances >= NO_HEADING_VARIANCE)
    return np.column_stack([poses[:, :2], np.where(unknown, np.nan, poses[:, 2])])


def headings(rows: Floats, mapped: HeadingTopic | HeadingColumns) -> tuple[Floats, Floats]:
    """Convert the rows of `message_rows.HEADING_READERS`.

    `rows` (n, 2) are yaw [rad] and variance [rad²] or NaN. Returns the yaw of the robot (n,) [rad] and
    its variances (n,); NaN for unknown.
    """
    yaw = wrap_angle(rows[:, 0] + math.radians(mapped.offset_deg))
    variances = rows[:, 1].copy()
    if mapped.sigma is not None:
        variances[np.isnan(variances)] = mapped.sigma**2
    return yaw, variances


def velocities(stamps: Stamps, rows: Floats, mapped: VelocityTopic) -> list[BodyVelocity]:
    """Convert rows of `message_rows.VELOCITY_READERS`, all poses or all twists.

    Poses need two rows for a velocity.
    """
    sensor = mapped.sigma, mapped.position, math.radians(mapped.yaw_deg)
    if np.isnan(rows[:, 0]).all():  # no x: twists
        return of_twists(stamps, rows[:, TWIST], *sensor)
    return body_velocities(PoseSeries(stamps, planar_poses(rows)), *sensor)


def fit_for_truth(variances: Floats) -> NDArray[np.bool_]:
    """Mask (n,) of positions whose stated variance (n,) is not far above the median."""
    known = np.isfinite(variances)
    if 2 * known.sum() < len(variances) or not len(variances):
        return np.ones(len(variances), dtype=bool)
    return ~known | (variances <= WORSE**2 * np.median(variances[known]))
