"""Column map: columns of a table (CSV, Parquet) for each stream.

The map is the `[log.columns]` table of a robot file.
"""

import math
from typing import Annotated, Literal

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.checks import (
    Bound,
    Bounded,
    Latency,
    OnRobot,
    Positive,
    WanderSigma,
    WanderTime,
    check_bounds,
    require_wander,
)
from icreckon.replay.mapping.geodesy import check_origin
from icreckon.replay.mapping.track_units import COUNTER_UNITS, TrackUnit

ClockOffset = Annotated[float, Bound("a time in seconds", -1e11, 1e11)]
Wrap = Annotated[float, Bound("a positive number, 2**64 at most", 0.0, 2.0**64, above=True)]
TimeUnit = Literal["s", "ms", "us", "ns"]
AngleUnit = Literal["rad", "deg"]
RateUnit = Literal["rad/s", "deg/s", "mdps"]
AccelerationUnit = Literal["m/s2", "g", "mg"]
NANOSECONDS_OF: dict[TimeUnit, int] = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}


class TrackKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of track speeds in messages and tables.

    Attributes:
        left: joints, fields or columns of the left side, which are averaged; with a minus before the
            name, as "-motor_2", one that counts backward.
        right: those of the right side.
        speed: in place of both the forward speed by the controller [m/s].
        yaw_rate: its yaw rate [rad/s].
        gauge: track gauge by which the controller computes both from track speeds [m], also of Odometry
            and twists; the vehicle's if left out.
        unit: of left and right; of JointState a cumulative one ("counts", "rad", ...) is that of the
            positions.
        counts_per_turn: encoder counts per turn of the sprocket, for unit "counts".
        wrap: range of the counter, in `unit`; None if it does not wrap.
        scale: true speed over that of the log, also of speeds in m/s; 0.025 for motors with a gear of
            40 to 1 [-].
        latency: latency of the stamps, subtracted from them [s].
    """

    left: tuple[str, ...] = ()
    right: tuple[str, ...] = ()
    speed: str | None = None
    yaw_rate: str | None = None
    gauge: Positive | None = None
    unit: TrackUnit = "rad/s"
    counts_per_turn: Positive | None = None
    wrap: Wrap | None = None
    scale: Positive = 1.0
    latency: Latency = 0.0

    def __post_init__(self) -> None:
        check_bounds(self)
        if bool(self.left) != bool(self.right) or bool(self.speed) != bool(self.yaw_rate):
            raise ValueError("left and right, or speed and yaw_rate, go together")
        if self.left and self.speed:
            raise ValueError("left and right, or speed and yaw_rate, not both")
        names, unit = self.names, self.unit
        sides = {"left": names[: len(self.left)], "right": names[len(self.left) :]}
        sides = {} if self.speed else sides
        for side, of_side in sides.items():
            if twice := [name for name in of_side if of_side.count(name) > 1]:
                raise ValueError(f"{side} names {twice[0]!r} twice")
        shared = {*sides.get("left", ())} & {*sides.get("right", ())}
        # Only topics, not columns, have a `right_topic`.
        if shared and getattr(self, "right_topic", None) is None:
            raise ValueError(
                f"left and right must not share {min(shared)!r}; sides with a topic each need "
                "right_topic"
            )
        if (unit == "counts") != (self.counts_per_turn is not None):
            raise ValueError('unit = "counts" and counts_per_turn need each other')
        if self.wrap is not None and not self.are_counters:
            sums = ", ".join(sorted(COUNTER_UNITS))
            raise ValueError(f"wrap is for what adds up ({sums}), not for {unit}")
        if self.wrap is not None and max(map(len, sides.values()), default=0) > 1:
            raise ValueError("wrap is for one counter a side: the mean of several does not wrap")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the left side, then of the right one, without a minus; or of the twist."""
        if self.speed and self.yaw_rate:
            return self.speed, self.yaw_rate
        return tuple(name.removeprefix("-") for name in (*self.left, *self.right))

    @property
    def are_counters(self) -> bool:
        """True for left and right that add up, so that their differences are the motion."""
        return self.unit in COUNTER_UNITS

    @property
    def signs(self) -> Floats:
        """Factors (k,) of these: -1 of those with a minus, otherwise 1."""
        return np.array([-1.0 if name[:1] == "-" else 1.0 for name in (*self.left, *self.right)])


class TrackColumns(TrackKeys, frozen=True, kw_only=True):
    """Columns of the track speeds.

    Attributes:
        unit: their unit.
        time: column of their time, if not the map's.
        time_unit: its unit.
        clock_offset: by which its clock is ahead of the others, subtracted [s].
        clock_drift: by which it gains on the others from the first row on, subtracted [s/s].
    """

    unit: TrackUnit = "m/s"
    time: str | None = None
    time_unit: TimeUnit | None = None
    clock_offset: ClockOffset = 0.0
    clock_drift: Annotated[float, Bound("a number, 0.1 at most", -0.1, 0.1)] = 0.0

    def __post_init__(self) -> None:
        if not (self.left or self.speed):
            raise ValueError("left and right must name columns, or speed and yaw_rate")
        super().__post_init__()


class ImuKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of an IMU in messages and tables, in its own axes.

    Attributes:
        angular_velocity: fields or columns of x, y and z, or of z alone, as "gyro.z" or "data[0]"; empty
            for Imu.
        linear_acceleration: those of x, y and z (specific force); empty for none, and for Imu.
        rate_unit: unit of the angular velocity; a number is the size of a count [rad/s], negative if the
            signs are wrong.
        acceleration_unit: unit of the acceleration; a number is the size of a count [m/s²], likewise.
        latency: latency of the stamps, subtracted from them [s].
    """

    angular_velocity: tuple[str, ...] = ()
    linear_acceleration: tuple[str, ...] = ()
    rate_unit: RateUnit | float = "rad/s"
    acceleration_unit: AccelerationUnit | float = "m/s2"
    latency: Latency = 0.0

    def __post_init__(self) -> None:
        check_bounds(self)
        for name in ("rate_unit", "acceleration_unit"):
            if not isinstance(size := getattr(self, name), str) and not 0.0 < abs(size) < math.inf:
                raise ValueError(f"{name} must be a unit, or a number other than 0, found {size}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes of the angular velocity, then of the acceleration."""
        return (*self.angular_velocity, *self.linear_acceleration)

    def check_axes(self, what: str) -> None:
        """Raise a ValueError unless all axes are named; `what`: fields or columns."""
        if len(self.angular_velocity) not in (1, 3):
            raise ValueError(f"angular_velocity must name three {what}, or that of z alone")
        if len(self.linear_acceleration) not in (0, 3):
            raise ValueError(f"linear_acceleration must name three {what}, or none")


class ImuColumns(ImuKeys, frozen=True, kw_only=True):
    """Columns of the IMU.

    Attributes:
        time: column of their time, if not the map's.
        time_unit: its unit.
        clock_offset: by which its clock is ahead of the others, subtracted [s].
    """

    time: str | None = None
    time_unit: TimeUnit | None = None
    clock_offset: ClockOffset = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_axes("columns")


class PoseKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of poses in messages and tables.

    Attributes:
        x: field or column of x in `odom` [m]; with `y`, or else `latitude` and `longitude`.
        y: that of y [m].
        yaw: that of the heading, counter-clockwise from x; None for none.
        yaw_unit: unit of `yaw`.
        latitude: field or column [deg].
        longitude: field or column [deg].
        altitude: field or column [m], or None.
        sigma: that of the standard deviation of each coordinate [m], or None.
        position_sigma: standard deviation of each coordinate where a message or a row has none [m]; with
            `wander_sigma` that of all fixes, since messages state their whole error.
        heading_sigma: standard deviation of yaw where a message or a row has none [rad]; without it such
            fixes have no heading.
        least_sigma: lower bound of the standard deviations of messages or rows [m]: errors of GPS are
            correlated over time, but a filter assumes independent fixes.
        height_sigma: standard deviation of the height of fixes [m]; without it their height is not used.
        wander_sigma: standard deviation of the part of the error that wanders [m], see `FixWander`; of
            fixes only.
        wander_time: its correlation time [s].
        origin: latitude, longitude [deg], altitude [m] of the origin of geodetic fixes; the first fix if
            left out.
        position: the antenna or other measured point in base_link, forward, left, up [m]; of fixes only.
        latency: latency of the stamps, subtracted from them [s].
    """

    x: str | None = None
    y: str | None = None
    yaw: str | None = None
    yaw_unit: AngleUnit = "rad"
    latitude: str | None = None
    longitude: str | None = None
    altitude: str | None = None
    sigma: str | None = None
    position_sigma: Positive | None = None
    heading_sigma: Positive | None = None
    least_sigma: Positive | None = None
    height_sigma: Positive | None = None
    wander_sigma: WanderSigma = 0.0
    wander_time: WanderTime = 0.0
    origin: tuple[float, float, float] | None = None
    position: tuple[OnRobot, ...] = (0.0, 0.0, 0.0)
    latency: Latency = 0.0

    def __post_init__(self) -> None:
        check_bounds(self)
        require_wander("wander_sigma", self.wander_sigma, "wander_time", self.wander_time)
        check_origin(self.origin)
        if len(self.position) not in (2, 3):
            raise ValueError(f"position must be forward, left and up [m], found {self.position}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names that are given, in the order of the attributes."""
        named = (self.x, self.y, self.yaw, self.latitude, self.longitude, self.altitude, self.sigma)
        return tuple(name for name in named if name)

    def check_place(self, what: str) -> None:
        """Raise a ValueError unless x and y, or latitude and longitude, are named."""
        plane, globe = (self.x, self.y), (self.latitude, self.longitude)
        if not (all(plane) and not any(globe)) and not (all(globe) and not any(plane)):
            raise ValueError(f"x and y must name {what}, or else latitude and longitude")


class PoseColumns(PoseKeys, frozen=True, kw_only=True):
    """Columns of fixes or of the truth.

    Attributes:
        source: name of the reference system of the truth, for reports.
        time: column of their time, if not the map's.
        time_unit: its unit.
        clock_offset: by which its clock is ahead of the others, subtracted [s].
    """

    source: str = ""
    time: str | None = None
    time_unit: TimeUnit | None = None
    clock_offset: ClockOffset = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_place("columns")


class HeadingColumns(Bounded, frozen=True):
    """Columns of a heading without a position.

    Attributes:
        yaw: column of the heading, counter-clockwise.
        unit: its unit.
        clockwise: whether it counts clockwise, from north (a compass), so that yaw is 90 degrees less it.
        sigma: standard deviation [rad].
        offset_deg: offset added to get the direction of driving in the frame of the fixes [deg].
        time: column of its time, if not the map's.
        time_unit: its unit.
        clock_offset: by which its clock is ahead of the others, subtracted [s].
        latency: latency of the stamps, subtracted from them [s].
    """

    yaw: str
    sigma: Positive
    unit: AngleUnit = "rad"
    clockwise: bool = False
    offset_deg: Annotated[float, Bound("a number")] = 0.0
    time: str | None = None
    time_unit: TimeUnit | None = None
    clock_offset: ClockOffset = 0.0
    latency: Latency = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """The column of the heading."""
        return (self.yaw,)


class ColumnMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Columns of each stream; None if the tables lack the stream.

    A stream is read from each file that has all of its columns. Sides of the tracks, and rates and forces
    of the IMU, may be in a file each: they are interpolated. "FILE.column", without the file's ending, is
    that of one file. A row whose cells are empty in all columns of a stream belongs to other streams.

    Attributes:
        time: column of the time.
        time_unit: its unit, if the column holds numbers and not timestamps.
        tracks: columns of the track speeds.
        imu: columns of the IMU.
        fixes: columns of the fixes.
        truth: columns of the truth; without yaw it shows positions alone.
        heading: columns of a heading without a position.
    """

    time: str
    time_unit: TimeUnit = "s"
    tracks: TrackColumns | None = None
    imu: ImuColumns | None = None
    fixes: PoseColumns | None = None
    truth: PoseColumns | None = None
    heading: HeadingColumns | None = None

    def __post_init__(self) -> None:
        if self.truth is not None and any(self.truth.position):
            raise ValueError("truth takes no position: the truth's point is estimated")
        if self.truth is not None and self.truth.wander_sigma:
            raise ValueError("truth takes no wander_sigma: fixes do")
