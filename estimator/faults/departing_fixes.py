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

# Time of rejected fixes that depart from the path after which they are followed, and least number of
# them before [s].
DEPARTURE_TIME, DEPARTED_FIXES = 0.5, 2.0
# Farthest departure over the distance, and standard deviations to a side of it.
DEPARTURE_SHARE, DEPARTURE_SIGMAS = 1.2, 3.0
# Fastest turn of the path that a wrong gyro explains [rad/s].
FASTEST_TURN = 0.2
# Least cosine between successive departures, and least ratio of them.
SAME_SIDE = 0.8
# Least way that has a direction [m], and least time that has a speed [s].
LEAST_WAY, LEAST_TIME = 1e-3, 1e-6


class Departure(NamedTuple):
    """Departure of position fixes from the path.

    Attributes:
        time: time of rejected fixes that depart [s]; 0 at another one.
        from_x: place on the path of the newest fix that does not [m].
        from_y: see above.
        by_x: innovation of the newest fix [m].
        by_y: see above.
    """

    time: Any = 0.0
    from_x: Any = 0.0
    from_y: Any = 0.0
    by_x: Any = 0.0
    by_y: Any = 0.0


class Shown(NamedTuple):
    """Standard deviations of the errors that a departure indicates, with signs.

    Attributes:
        along: error of the position along the path, in x and y [m].
        slip: with it, that of the slip of v_x [m/s].
        beside: error of the position to a side, in x and y [m].
        yaw: with it, that of a yaw that was off from the begin on [rad].
        bias: or that of the gyro's bias, which has turned the yaw by twice as much until now [rad/s].
    """

    along: tuple[Any, Any]
    slip: Any
    beside: tuple[Any, Any]
    yaw: Any
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
) -> tuple[Departure, Any, Shown]:
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
        The departure; True if it is clear; what it shows.
    """
    time = max(LEAST_TIME, before.time + interval)
    at = fix[0] - z[0], fix[1] - z[1]
    cos, sin = at[0] - before.from_x, at[1] - before.from_y
    way = max(LEAST_WAY, math.sqrt(cos * cos + sin * sin))
    cos, sin = cos / way, sin / way
    way = min(way, max(LEAST_WAY, fastest * time))
    ahead, left = cos * z[0] + sin * z[1], cos * z[1] - sin * z[0]
    shared = 2.0 * cos * sin * S[1]
    of_ahead = max(0.0, cos * cos * S[0] + shared + sin * sin * S[2])
    of_left = max(0.0, sin * sin * S[0] - shared + cos * cos * S[2])
    size = math.sqrt(z[0] * z[0] + z[1] * z[1])
    noise = DEPARTURE_SIGMAS * math.sqrt(max(of_ahead, of_left))
    departs = size < DEPARTURE_SHARE * way + noise
    # It goes on, to the side of the fix before.
    least = SAME_SIDE * math.sqrt(before.by_x * before.by_x + before.by_y * before.by_y)
    goes_on = (z[0] * before.by_x + z[1] * before.by_y >= least * size) & (size >= least)
    departs = departs & ((before.time <= 0.0) | goes_on)
    is_clear = departs & (before.time >= max(DEPARTURE_TIME, DEPARTED_FIXES * interval))
    after = Departure(
        select(departs, time, 0.0),
        select(departs, before.from_x, at[0]),
        select(departs, before.from_y, at[1]),
        *z,
    )
    ahead, left = beyond(ahead, of_ahead), beyond(left, of_left)
    # A yaw that grows with time moves the path by half of what it would from the begin on. A robot that
    # has slipped and turns on the spot departs by as much: a short way shows only what a gyro explains.
    yaw = left / way
    is_slow = yaw * yaw < (FASTEST_TURN * time) * (FASTEST_TURN * time)
    yaw = select(is_slow | (way > gauge), yaw, 0.0)
    slip = select(cos * heading[0] + sin * heading[1] < 0.0, -ahead, ahead) / time
    along, beside = (cos * ahead, sin * ahead), (-sin * left, cos * left)
    return after, is_clear, Shown(along, slip, beside, yaw, -2.0 * yaw / time)


def beyond(innovation: Any, variance: Any) -> Any:
    """Part of an innovation that its noise does not explain, with its sign."""
    more = innovation * innovation - DEPARTURE_SIGMAS * DEPARTURE_SIGMAS * variance
    return select(innovation < 0.0, -1.0, 1.0) * math.sqrt(max(0.0, more))


def errors_of(shown: Shown) -> tuple[tuple[tuple[int, ...], tuple[Any, ...]], ...]:
    """States and errors that a departure indicates, by cause."""
    return (
        ((s.X, s.Y, s.SLIP_X), (*shown.along, shown.slip)),
        ((s.X, s.Y, s.YAW), (*shown.beside, shown.yaw)),
        ((s.X, s.Y, s.YAW, s.GYRO_BIAS), (*shown.beside, 2.0 * shown.yaw, shown.bias)),
    )
