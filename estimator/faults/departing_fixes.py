"""Position fixes that depart from the path: a robot that slips, slides or turns.

Both tracks may spin on one spot, or slide: all of their speed is slip. The bias of the gyro may jump: the
path turns. Precise fixes then depart from it to one side, by more and more, but by no more than the robot
drives meanwhile. After a time of such rejected fixes the states are made uncertain by what these show:
position and slip together, position and yaw, and position, yaw and bias. Fixes that jump, or scatter, are
rejected as any others.

Functions of plain numbers are written for plain Python and, traced, for lanes.
"""

import math
from typing import Any, NamedTuple

from icreckon.estimator.base import state as s
from icreckon.estimator.base.choices import select

# Time of rejected fixes that depart from the path after which they are followed [s], and least number of
# them before.
DEPARTURE_TIME, DEPARTED_FIXES = 0.5, 2.0
# Largest departure as a share of the distance driven, and standard deviations of noise beyond that.
DEPARTURE_SHARE, DEPARTURE_SIGMAS = 1.2, 3.0
# Largest errors of the yaw [rad] and of the gyro's bias [rad/s] that a departure shows. A slide sideways
# departs as they do.
LARGEST_YAW, LARGEST_BIAS = 0.3, 0.1
SAME_SIDE = 0.8  # least cosine between successive departures, and least ratio of them
# Least size of a departure over that of the first rejected fix: a jump stays, slip and a turn grow.
GROWTH = 1.5
# Share of the distance driven by which a departure is behind where the robot stands, and share of the
# noise by which it may then be smaller than the one before.
STANDS, NOISE_SHARE = 0.5, 0.67
REACH = 1.25  # noise within which a departure is in reach, over the above: few fixes are to miss it
# Least distance that has a direction [m], and least time that has a speed [s].
LEAST_DISTANCE, LEAST_TIME = 1e-3, 1e-6


class Departure(NamedTuple):
    """Departure of position fixes from the path."""

    time: Any = 0.0  # time for which rejected fixes have departed; 0 after one that does not [s]
    from_x: Any = 0.0  # place on the path of the newest fix that does not depart [m]
    from_y: Any = 0.0
    by_x: Any = 0.0  # innovation of the newest fix [m]
    by_y: Any = 0.0
    first: Any = 0.0  # size of the first rejected fix's innovation; 0 after a used one [m]


# States of the errors that a departure shows, by cause: both tracks slip, or the robot slides; the yaw is
# wrong; the gyro's bias is.
STATES = (s.X, s.Y, s.SLIP_X), (s.X, s.Y, s.YAW), (s.X, s.Y, s.YAW, s.GYRO_BIAS)


def departure_after(
    before: Departure,
    fix: tuple[Any, Any],
    z: tuple[Any, Any],
    S: tuple[Any, Any, Any],
    heading: tuple[Any, Any],
    fastest: Any,
    gauge: Any,
    interval: Any,
) -> tuple[Departure, Any, tuple[tuple[Any, ...], ...]]:
    """Departure from the path, with a position fix that the gate would reject.

    Args:
        before: departure before it.
        fix: the fix, x and y [m].
        z: its innovation, x and y [m].
        S: covariance of the innovation, xx, xy and yy [m²].
        heading: cosine and sine of the robot's yaw.
        fastest: highest speed of a track [m/s].
        gauge: distance between the tracks [m].
        interval: time since the fix before [s].

    Returns:
        The departure with this fix; True if it has lasted long enough to be followed; the standard
        deviations, with signs, of the errors that it shows, as `STATES` [m, m/s, rad, rad/s].
    """
    (z_x, z_y), time = z, max(LEAST_TIME, before.time + interval)
    path_x, path_y = fix[0] - z_x, fix[1] - z_y
    # Distance and direction driven since the newest fix that does not depart.
    driven_x, driven_y = path_x - before.from_x, path_y - before.from_y
    distance = max(LEAST_DISTANCE, math.sqrt(driven_x * driven_x + driven_y * driven_y))
    cos, sin = driven_x / distance, driven_y / distance
    distance = min(distance, max(LEAST_DISTANCE, fastest * time))
    ahead, left, variance_ahead, variance_left = along_and_beside(z, S, (cos, sin))
    size = math.sqrt(z_x * z_x + z_y * z_y)
    noise = DEPARTURE_SIGMAS * math.sqrt(max(variance_ahead, variance_left))
    is_in_reach = size < DEPARTURE_SHARE * distance + REACH * noise
    # The departure continues to the side of the fix before, and is not much smaller, but by noise where
    # the robot seems to stand.
    by = math.sqrt(before.by_x * before.by_x + before.by_y * before.by_y)
    by_noise = select(ahead < -STANDS * distance, NOISE_SHARE * noise, 0.0)
    least = max(0.0, SAME_SIDE * by - by_noise)
    continues = (z_x * before.by_x + z_y * before.by_y >= least * size) & (size >= least)
    departs = is_in_reach & ((before.time <= 0.0) | continues)
    first = select(before.first > 0.0, before.first, size)
    is_long = before.time >= max(DEPARTURE_TIME, DEPARTED_FIXES * interval)
    is_followed = departs & is_long & (size >= GROWTH * first)
    from_x, from_y = select(departs, before.from_x, path_x), select(departs, before.from_y, path_y)
    after = Departure(select(departs, time, 0.0), from_x, from_y, *z, first)
    ahead, left = beyond_noise(ahead, variance_ahead), beyond_noise(left, variance_left)
    # Over a distance shorter than the gauge, slip departs as far as a wrong yaw.
    largest = LARGEST_YAW * min(1.0, distance / gauge)
    yaw = max(-largest, min(largest, left / distance))
    # A yaw error that grows with time moves the path half as far as one from the start on.
    bias = max(-LARGEST_BIAS, min(LARGEST_BIAS, -2.0 * yaw / time))
    turned = -0.5 * bias * time
    left_x, left_y = -sin * distance, cos * distance
    # Ahead is behind for a robot that drives backwards.
    slip = select(cos * heading[0] + sin * heading[1] < 0.0, -ahead, ahead) / time
    slip_error = cos * ahead - sin * left, sin * ahead + cos * left, slip
    yaw_error = left_x * yaw, left_y * yaw, yaw
    bias_error = left_x * turned, left_y * turned, 2.0 * turned, bias
    return after, is_followed, (slip_error, yaw_error, bias_error)


def are_departing(record: Any) -> bool:
    """Return True while the fixes of a filter's record depart from the path."""
    size = math.hypot(record.departed_by_x, record.departed_by_y)
    return bool(record.departed_for >= DEPARTURE_TIME and size >= GROWTH * record.departed_first)


def along_and_beside(
    z: tuple[Any, Any], S: tuple[Any, Any, Any], direction: tuple[Any, Any]
) -> tuple[Any, Any, Any, Any]:
    """Innovation along a direction and to its left [m]; their variances [m²]."""
    (z_x, z_y), (xx, xy, yy), (cos, sin) = z, S, direction
    shared = 2.0 * cos * sin * xy
    variance_along = max(0.0, cos * cos * xx + shared + sin * sin * yy)
    variance_beside = max(0.0, sin * sin * xx - shared + cos * cos * yy)
    return cos * z_x + sin * z_y, cos * z_y - sin * z_x, variance_along, variance_beside


def beyond_noise(innovation: Any, variance: Any) -> Any:
    """Part of an innovation [m] beyond noise of a variance [m²], with its sign."""
    excess = innovation * innovation - DEPARTURE_SIGMAS * DEPARTURE_SIGMAS * variance
    return select(innovation < 0.0, -1.0, 1.0) * math.sqrt(max(0.0, excess))
