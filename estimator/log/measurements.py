"""Measurements: the input of an estimator, one at a time.

Stamps are int64 nanoseconds since any epoch, the same for all sensors. Units are SI. Vectors of a
planar kind are in REP-103 axes (x forward, y left, yaw counter-clockwise); the IMU's are in the
IMU's own axes, as a driver publishes them.
"""

from dataclasses import dataclass
from typing import Protocol

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
Speeds = tuple[float, ...]

# Standard deviation of a standing robot's velocity about zero [m/s, m/s, rad/s].
STANDSTILL_SIGMA: Vector3 = (1e-3, 1e-3, 1e-4)


class Measurement(Protocol):
    """Measurement of any sensor, those included that a program registers itself."""

    @property
    def stamp(self) -> int:
        """Time [ns]."""
        ...


@dataclass(frozen=True, slots=True)
class TrackSpeeds:
    """Speeds of the two tracks over the ground side, without slip.

    If each wheel of a side has a motor and a sensor of its own, give the speeds of the wheels in every
    sample, too: a wheel that spins or is blocked is left out then.

    Attributes:
        stamp: end of the interval since the sample before, over which the speeds are means [ns].
        left: speed of the left track, or mean of the left wheels [m/s], forward positive.
        right: speed of the right track, or mean of the right wheels [m/s], forward positive.
        left_wheels: speeds of the left wheels [m/s], always in the same order; empty if there is one.
        right_wheels: speeds of the right wheels [m/s].
    """

    stamp: int
    left: float
    right: float
    left_wheels: Speeds = ()
    right_wheels: Speeds = ()


@dataclass(frozen=True, slots=True)
class ImuSample:
    """Gyroscope and accelerometer sample in the IMU's own axes (sensor_msgs/Imu).

    Attributes:
        stamp: end of the interval that the values are means of [ns]; for values of one moment it is half
            an interval after that.
        angular_velocity: angular velocity [rad/s]; x and y may be NaN with `imu.gyro_axes` "z".
        linear_acceleration: specific force [m/s²] (about +9.8 along "up" at rest); None or NaN: none.
    """

    stamp: int
    angular_velocity: Vector3
    linear_acceleration: Vector3 | None = None


@dataclass(frozen=True, slots=True)
class PositionFix:
    """Position in `odom` of an antenna on the robot, by default of `base_link`.

    Attributes:
        stamp: time [ns].
        x: [m].
        y: [m].
        variance: variance of each coordinate [m²].
        forward: distance of the antenna ahead of `base_link` [m].
        left: distance of the antenna to the left of `base_link` [m].
        up: height of the antenna above `base_link` [m]; on a slope it leans over by gravity's estimate.
    """

    stamp: int
    x: float
    y: float
    variance: float
    forward: float = 0.0
    left: float = 0.0
    up: float = 0.0


@dataclass(frozen=True, slots=True)
class HeadingFix:
    """Yaw of `base_link` in `odom`.

    Attributes:
        stamp: time [ns].
        yaw: [rad], full turns may be included.
        variance: [rad²].
    """

    stamp: int
    yaw: float
    variance: float


@dataclass(frozen=True, slots=True)
class HeightFix:
    """Height of `base_link` in `odom`, as by GNSS or a barometer.

    The first one sets the height; the others correct it, the slope, and the biases that slopes depend on.

    Attributes:
        stamp: time [ns].
        z: [m].
        variance: [m²].
    """

    stamp: int
    z: float
    variance: float


@dataclass(frozen=True, slots=True)
class BodyVelocity:
    """Velocity of `base_link` in its own axes, as from visual odometry or radar.

    Attributes:
        stamp: time [ns].
        v_x: forward [m/s].
        v_y: to the left [m/s].
        variance: variance of each component [m²/s²].
    """

    stamp: int
    v_x: float
    v_y: float
    variance: float


@dataclass(frozen=True, slots=True)
class PoseFix:
    """Pose of `base_link` in `odom`, as from localisation in a map or scan matching.

    Attributes:
        stamp: time [ns].
        x: [m].
        y: [m].
        yaw: [rad], full turns may be included.
        covariance: (3, 3) of x, y, yaw [m², m rad, rad²], symmetric and positive definite.
    """

    stamp: int
    x: float
    y: float
    yaw: float
    covariance: Matrix3


@dataclass(frozen=True, slots=True)
class ZeroVelocity:
    """Zero-velocity measurement: the robot stands, for example braked or docked.

    Attributes:
        stamp: time [ns].
        sigma: standard deviations of v_x, v_y and w about zero [m/s, m/s, rad/s].
    """

    stamp: int
    sigma: Vector3 = STANDSTILL_SIGMA


@dataclass(frozen=True, slots=True)
class Mark:
    """Stochastic clone of the pose at a stamp, from which later motion is reported."""

    stamp: int  # time [ns]
