"""Body velocities by another odometry: from its poses or its twists."""

import math
from itertools import repeat

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.checks import Bound
from icreckon.estimator.base.errors import SettingError
from icreckon.estimator.base.frames import relative, rotate
from icreckon.estimator.log.measurements import BodyVelocity
from icreckon.estimator.log.series import PoseSeries

A_SIGMA = Bound("a positive number [m/s]", 0.0, above=True)
# Least and longest time between two poses for a velocity [ns]: errors of poses and stamps matter less
# over a longer time, changes of the velocity more.
LEAST, LONGEST = round(0.08 / NANOSECOND), round(0.5 / NANOSECOND)


def body_velocities(
    odometry: PoseSeries, sigma: float, position: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0
) -> list[BodyVelocity]:
    """Velocities of `base_link` by the motion between successive poses of an odometry.

    Args:
        odometry: poses of its sensor, in any fixed frame, stamps rising.
        sigma: standard deviation of v_x and of v_y [m/s].
        position: place of the sensor in `base_link`: forward, left [m].
        yaw: direction of the sensor's x axis in `base_link` [rad].

    Returns:
        A velocity for each two poses 0.08 to 0.5 s apart, at the middle of their stamps, without those in
        between.

    Raises:
        SettingError: a sigma that is not positive.
    """
    A_SIGMA.require("sigma", sigma, SettingError)
    series = odometry.rows(_apart(odometry.stamps))
    stamps, times = series.stamps, np.diff(series.stamps)
    twists = _twists(series.poses, times * NANOSECOND)
    is_used = times <= LONGEST
    middles = stamps[:-1] + times // 2
    return of_twists(middles[is_used], twists[is_used], sigma, position, yaw)


def _apart(stamps: Stamps) -> list[int]:
    """Rows of stamps (n,) [ns] at least `LEAST` after the one before."""
    rows: list[int] = []
    next_stamp: float = -math.inf
    for row, stamp in enumerate(stamps.tolist()):
        if stamp >= next_stamp:
            rows.append(row)
            next_stamp = stamp + LEAST
    return rows


def _twists(poses: Floats, times: Floats) -> Floats:
    """Mean twists (n - 1, 3) between successive poses (n, 3), in times (n - 1,) [s]."""
    moved = relative(poses[:-1], poses[1:])
    turn = moved[:, 2]
    # Logarithm of SE(2) (Sola et al., A micro Lie theory, eq. 158): the chord of an arc to its length,
    # in the axes half-way.
    along = rotate(moved[:, :2], -0.5 * turn) / np.sinc(0.5 * turn / np.pi)[:, None]
    return np.column_stack([along, turn]) / times[:, None]


def of_twists(
    stamps: Stamps, twists: Floats, sigma: float, position: tuple[float, float], yaw: float
) -> list[BodyVelocity]:
    """Velocities of `base_link` from the twists of a sensor.

    `twists` (n, 3) are v_x, v_y [m/s], w [rad/s] in its axes; other arguments as of `body_velocities`.
    """
    forward, left = position
    carried = twists[:, 2:] * (left, -forward)  # from the sensor's place to that of base_link
    v_x, v_y = (rotate(twists[:, :2], yaw) + carried).T.tolist()
    return list(map(BodyVelocity, stamps.tolist(), v_x, v_y, repeat(sigma**2)))
