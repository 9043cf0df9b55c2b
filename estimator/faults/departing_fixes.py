"""Position fixes that depart from the path: both tracks slip, or the path turns.

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
# Fastest turn of the path that a wrong gyro explains [rad/s].
FASTEST_TURN = 0.2
# Least cosine between successive departures, and least ratio of them.
SAME_SIDE = 0.8
# Least distance that has a direction [m], and least time that has a speed [s].
LEAST_DISTANCE, LEAST_TIME = 1e-3, 1e-6


class Departure(NamedTuple):
    """Departure of position fixes from the path."""

    # time for which rejected fixes have departed [s]; 0 after a fix that does not depart
    time: Any = 0.0
    from_x: Any = 0.0  # place on the path of the newest fix that does not depart [m]
    from_y: Any = 0.0  # see above
    by_x: Any = 0.0  # innovation of the newest fix [m]
    by_y: Any = 0.0  # see above


class Indicated(NamedTuple):
    """Standard deviations of the errors that a departure indicates, with signs."""

    along: tuple[Any, Any]  # error of the position along the path, in x and y [m]
    slip: Any  # with it, that of the slip of v_x [m/s]
    beside: tuple[Any, Any]  # error of the position to a side, in x and y [m]
    yaw: Any  # with it, the error of a yaw that was wrong from the start of the departure on [rad]
    # or that of the gyro's bias, which has turned the yaw by twice as much until now [rad/s]
    bias: Any


def departure_after(
    before: Departure,
    fix: tuple[Any, Any],
    z: tuple[Any, Any],
    S: tuple[Any, Any, Any],
    heading: tuple[Any, Any],
    fastest: Any,
    gauge: Any,
    interval: Any,
) -> tuple[Departure, Any, Indicated]:
    """Departure from the path, with a position fix that the gate would reject.

    Args:
        before: departure before it.
        fix: the fix, x and y [m].
        z: its innovation [m].
        S: covariance of that, xx, xy and yy [m²].
        heading: cosine and sine of the yaw.
        fastest: highest speed of a track [m/s].
        gauge: distance between the tracks [m].
        interval: time since the fix before [s].

    Returns:
        The departure with this fix; True if it has lasted long enough to be followed; the errors that it
        indicates.
    """
    time = max(LEAST_TIME, before.time + interval)
    place = fix[0] - z[0], fix[1] - z[1]
    # Distance and direction driven since the newest fix that does not depart.
    x, y = place[0] - before.from_x, place[1] - before.from_y
    distance = max(LEAST_DISTANCE, math.sqrt(x * x + y * y))
    cos, sin = x / distance, y / distance
    distance = min(distance, max(LEAST_DISTANCE, fastest * time))
    ahead, left = cos * z[0] + sin * z[1], cos * z[1] - sin * z[0]
    shared = 2.0 * cos * sin * S[1]
    variance_ahead = max(0.0, cos * cos * S[0] + shared + sin * sin * S[2])
    variance_left = max(0.0, sin * sin * S[0] - shared + cos * cos * S[2])
    size = math.sqrt(z[0] * z[0] + z[1] * z[1])
    noise = DEPARTURE_SIGMAS * math.sqrt(max(variance_ahead, variance_left))
    departs = size < DEPARTURE_SHARE * distance + noise
    # It continues to the side of the fix before.
    least = SAME_SIDE * math.sqrt(before.by_x * before.by_x + before.by_y * before.by_y)
    continues = (z[0] * before.by_x + z[1] * before.by_y >= least * size) & (size >= least)
    departs = departs & ((before.time <= 0.0) | continues)
    is_clear = departs & (before.time >= max(DEPARTURE_TIME, DEPARTED_FIXES * interval))
    after = Departure(
        select(departs, time, 0.0),
        select(departs, before.from_x, place[0]),
        select(departs, before.from_y, place[1]),
        *z,
    )
    ahead, left = beyond(ahead, variance_ahead), beyond(left, variance_left)
    # A yaw error that grows with time moves the path half as far as one from the start on. A robot that
    # has slipped and turns on the spot departs as far: over a short distance only a slow turn counts.
    yaw = left / distance
    is_slow = yaw * yaw < (FASTEST_TURN * time) * (FASTEST_TURN * time)
    yaw = select(is_slow | (distance > gauge), yaw, 0.0)
    slip = select(cos * heading[0] + sin * heading[1] < 0.0, -ahead, ahead) / time
    along, beside = (cos * ahead, sin * ahead), (-sin * left, cos * left)
    return after, is_clear, Indicated(along, slip, beside, yaw, -2.0 * yaw / time)


def beyond(innovation: Any, variance: Any) -> Any:
    """Part of an innovation that its noise does not explain, with its sign."""
    excess = innovation * innovation - DEPARTURE_SIGMAS * DEPARTURE_SIGMAS * variance
    return select(innovation < 0.0, -1.0, 1.0) * math.sqrt(max(0.0, excess))


def errors_of(indicated: Indicated) -> tuple[tuple[tuple[int, ...], tuple[Any, ...]], ...]:
    """States and their errors by cause: slip; wrong yaw; wrong yaw and gyro bias."""
    return (
        ((s.X, s.Y, s.SLIP_X), (*indicated.along, indicated.slip)),
        ((s.X, s.Y, s.YAW), (*indicated.beside, indicated.yaw)),
        ((s.X, s.Y, s.YAW, s.GYRO_BIAS), (*indicated.beside, 2.0 * indicated.yaw, indicated.bias)),
    )
