"""Forces of the ground on both tracks and their derivatives, in traced numbers.

The forces are those of `icreckon.estimator.motion.contact_forces`: Coulomb friction against the slip of
each contact point, which fades at small slip and may build up with the shear displacement, and rolling
resistance. Symbols and axes are the paper's. Jacobians are tuples of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from icreckon.estimator.friction.layout import (
    FRICTION,
    LENGTH,
    PARAMETERS,
    ROLLING,
    X_CM,
    Y_CM,
    Z_CM,
)
from icreckon.estimator.friction.loads import ContactArea, PointLoad, Pressing, point_load
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.elementary import exponential
from icreckon.estimator.tracing.trace import Table, Traced, reciprocal_root, select

# Three numbers, and three rows of three.
Three = tuple[Any, ...]
Matrix = tuple[Three, ...]


class Body(NamedTuple):
    """Vehicle and contact at the present parameters; constants as in `BODY_CONSTANTS`.

    Attributes:
        constants: constants by name.
        parameters: (PARAMETERS,) present parameters.
        area: nominal contact points.
        stretch: length of the contact, as a share of the nominal one.
        centre: x_CM, y_CM, z_CM [m].
        friction: coefficients across and along the left track, across and along the right one [-].
        mass: mass matrix A.
        sheared: friction builds up with the shear displacement.
    """

    constants: Mapping[str, Traced]
    parameters: Sequence[Any]
    area: ContactArea
    stretch: Any
    centre: Three
    friction: tuple[Any, Any, Any, Any]
    mass: Matrix
    sheared: bool


def body_at(
    constants: Mapping[str, Traced], pairs: Table, parameters: Sequence[Any], *, sheared: bool
) -> Body:
    """Vehicle and contact at given parameters (PARAMETERS,)."""
    c = constants
    M, x, y, z = c["mass"], parameters[X_CM], parameters[Y_CM], parameters[Z_CM]
    even: Any = tuple(c[f"even{k}"] for k in range(6))
    area = ContactArea(pairs, even, c["half_width"], c["rear"], c["front"])
    more = parameters[FRICTION] / c[f"nominal{FRICTION}"]
    inertia = c["yaw_inertia"] + M * (x * x + y * y)
    return Body(
        c,
        parameters,
        area,
        parameters[LENGTH] / c[f"nominal{LENGTH}"],
        (x, y, z),
        tuple(more * c[f"friction{k}"] for k in range(4)),
        ((M, 0.0, -M * y), (0.0, M, M * x), (-M * y, M * x, inertia)),
        sheared,
    )


class Grip(NamedTuple):
    """Friction at a contact point per unit load, along its slip, and derivatives.

    Attributes:
        across: friction across the track [-].
        along: friction along it [-].
        turning: its moment about the origin [m].
        by_motion: derivatives of the three by v_x, v_y, w and the track's speed, in rows.
        by_stretch: derivatives by the length of the contact, as a share of the nominal one.
    """

    across: Any
    along: Any
    turning: Any
    by_motion: tuple[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]
    by_stretch: Three


def grip(body: Body, twist: Three, V: Any, friction: tuple[Any, Any], point: Three) -> Grip:
    """Friction at a point.

    Args:
        body: vehicle and contact.
        twist: v_x, v_y [m/s], w [rad/s].
        V: speed of the point's track [m/s].
        friction: coefficients across and along the track.
        point: right of the origin, forward of it at the present length, and at the nominal one [m].
    """
    v_x, v_y, w = twist
    mu_x, mu_y = friction
    x, y, Y = point
    small = body.constants["small"]
    u_x, u_y = mu_x * (v_x - y * w), mu_y * (v_y + x * w - V)
    scale = reciprocal_root(u_x * u_x + u_y * u_y + mu_x * mu_y * small * small)
    e_x, e_y = u_x * scale, u_y * scale
    t_x, t_y = mu_x * e_x, mu_y * e_y
    k_xx = mu_x * mu_x * scale * (1.0 - e_x * e_x)
    k_xy = -mu_x * mu_y * scale * e_x * e_y
    k_yy = mu_y * mu_y * scale * (1.0 - e_y * e_y)
    along_w = Y * w
    if not body.sheared:
        by_x = (k_xx, k_xy, x * k_xy - y * k_xx, -k_xy)
        by_y = (k_xy, k_yy, x * k_yy - y * k_xy, -k_yy)
        stretch_x, stretch_y = -along_w * k_xx, -along_w * k_xy
    else:
        h, by_h, h_stretch = built_up(body, twist, V, point)
        k_xx, k_xy, k_yy = h * k_xx, h * k_xy, h * k_yy
        plain_x = (k_xx, k_xy, x * k_xy - y * k_xx, -k_xy)
        plain_y = (k_xy, k_yy, x * k_yy - y * k_xy, -k_yy)
        # The product rule's other half: the effect of the shear displacement.
        by_x = tuple(k + t_x * more for k, more in zip(plain_x, by_h, strict=True))
        by_y = tuple(k + t_y * more for k, more in zip(plain_y, by_h, strict=True))
        stretch_x = t_x * h_stretch - along_w * k_xx
        stretch_y = t_y * h_stretch - along_w * k_xy
        t_x, t_y = h * t_x, h * t_y
    turning = x * t_y - y * t_x
    by_turning = tuple(x * of_y - y * of_x for of_x, of_y in zip(by_x, by_y, strict=True))
    stretch_turning = x * stretch_y - y * stretch_x - Y * t_x
    rows = (by_x, by_y, by_turning)
    return Grip(t_x, t_y, turning, rows, (stretch_x, stretch_y, stretch_turning))


def built_up(
    body: Body, twist: Three, V: Any, point: Three
) -> tuple[Any, tuple[Any, Any, Any, Any], Any]:
    """Wong and Chiang's share h of the friction, see `motion.contact_forces`.

    Returns:
        h; h by v_x, v_y, w, V; and by the length of the contact as a share of the nominal one.
    """
    v_x, v_y, w = twist
    x, y, Y = point
    c, s = body.constants, body.stretch
    rear, front = c["rear"], c["front"]
    small, K = c["small"], c["shear_modulus"]
    forward, backward = V > 0.0, V < 0.0
    entry = select(forward, s * front, select(backward, s * rear, y))
    nearest = select(forward, abs(Y - front), abs(Y - rear))
    passage = s * select(forward | backward, nearest, front - rear)
    square = V * V + small * small
    time = passage / square**0.5
    middle = 0.5 * (y + entry)
    m_x, m_y = v_x - middle * w, v_y + x * w - V
    speed = (m_x * m_x + m_y * m_y + small * small) ** 0.5
    missing = exponential(-time * speed / K)
    slope = missing * time / (K * speed)
    by_V = -slope * m_y - missing / K * speed * time * V / square
    by_motion = (slope * m_x, slope * m_y, slope * (x * m_y - middle * m_x), by_V)
    by_stretch = (missing * time * speed / K - slope * m_x * middle * w) / s
    return 1.0 - missing, by_motion, by_stretch


class RollingLoads(NamedTuple):
    """Loads of both tracks [N], left first.

    Attributes:
        loads: the loads.
        by_right: derivatives by the force at the centre of mass to the right [-].
        by_forward: derivatives by that force forward [-].
        by_stretch: derivatives by the length of the contact, as a share of the nominal one [N].
    """

    loads: tuple[Any, Any]
    by_right: tuple[Any, Any]
    by_forward: tuple[Any, Any]
    by_stretch: tuple[Any, Any]


class Substep(NamedTuple):
    """Inputs of a substep.

    Attributes:
        body: vehicle and contact.
        V: speeds of the left and the right track [m/s].
        start: v_x, v_y [m/s], w [rad/s] at the start.
        inertia: force of inertia I at the start.
        pressing: loads of the points.
        on_tracks: loads of the tracks.
    """

    body: Body
    V: tuple[Any, Any]
    start: Three
    inertia: Three
    pressing: Pressing
    on_tracks: RollingLoads


def rolling_loads(body: Body, on_points: Pressing) -> RollingLoads:
    """Sum the loads of each track's points."""
    weight = body.constants["weight"]

    def terms(x_left: Any, x_right: Any, y: Any, share: Any) -> list[Any]:
        left, right = (point_load(on_points, x, y, share) for x in (x_left, x_right))
        pairs = zip(left, right, (weight, 1.0, 1.0, weight), strict=True)
        return [factor * one for *both, factor in pairs for one in both]

    found = trace.total(body.area.pairs, terms)
    return RollingLoads(*zip(found[::2], found[1::2], strict=True))


class Rolling(NamedTuple):
    """Rolling resistance of a track per unit of its coefficient and load.

    Attributes:
        force: force forward [-].
        by_travel: derivative by the speed of its centreline over the ground [s/m].
        by_track: derivative by the speed of the track [s/m].
        lever: the track's centreline, right of the origin [m].
    """

    force: Any
    by_travel: Any
    by_track: Any
    lever: Any


def rolling(body: Body, twist: Three, V: Any, side: float) -> Rolling:
    """Rolling resistance of one track; `side` is 1 of the right one, -1 of the left."""
    c, (_, v_y, w) = body.constants, twist
    lever, small = side * c["half_gauge"], c["small"]
    of_travel = c["opposes_travel"] > 0.5
    speed = select(of_travel, v_y + lever * w, V)
    scale = reciprocal_root(speed * speed + small * small)
    slope = -scale * scale * scale * small * small
    by_travel, by_track = select(of_travel, slope, 0.0), select(of_travel, 0.0, slope)
    return Rolling(-speed * scale, by_travel, by_track, lever)


def _over_points(step: Substep, v: Three, terms: Callable[..., Sequence[Any]]) -> list[Any]:
    """Sum `terms` of the grips and loads of both points over all pairs of points."""
    body = step.body

    def of_pair(x_left: Any, x_right: Any, Y: Any, share: Any) -> list[Any]:
        y = Y * body.stretch
        both = []
        for track, x in enumerate((x_left, x_right)):
            friction = body.friction[2 * track], body.friction[2 * track + 1]
            at_point = grip(body, v, step.V[track], friction, (x, y, Y))
            both.append((at_point, point_load(step.pressing, x, Y, share)))
        return list(terms(*both))

    return trace.total(body.area.pairs, of_pair)


def forces(step: Substep, v: Three) -> tuple[Three, Matrix]:
    """Force and moment F of the ground on both tracks, and its derivative by v."""

    def terms(*both: tuple[Grip, PointLoad]) -> list[Any]:
        return [
            sum(of.load * part for (at, of), part in zip(both, parts, strict=True))
            for parts in zip(*(flat(at) for at, _ in both), strict=True)
        ]

    def flat(at: Grip) -> list[Any]:
        return [*at[:3], *(by for row in at.by_motion for by in row[:3])]

    c = step.body.constants
    found = [-c["weight"] * one for one in _over_points(step, v, terms)]
    values, rows = found[:3], [found[3:6], found[6:9], found[9:12]]
    for track, side in enumerate((-1.0, 1.0)):
        at = rolling(step.body, v, step.V[track], side)
        load = step.body.parameters[ROLLING] * step.on_tracks.loads[track]
        slope = load * at.by_travel
        for row, lever in ((1, 1.0), (2, at.lever)):
            values[row] = values[row] + lever * load * at.force
            rows[row][1] = rows[row][1] + lever * slope
            rows[row][2] = rows[row][2] + lever * at.lever * slope
    return tuple(values), tuple(map(tuple, rows))


class TrackForces(NamedTuple):
    """The ground's force and moment on both tracks, and all derivatives.

    Attributes:
        values: F.
        by_twist: F by v.
        by_speeds: F by the speeds of the left and the right track.
        by_right: F by the force at the centre of mass to the right.
        by_forward: F by that force forward.
        by_parameters: F by the parameters, at given twist, speeds and q.
    """

    values: Three
    by_twist: Matrix
    by_speeds: tuple[Three, Three]
    by_right: Three
    by_forward: Three
    by_parameters: tuple[Three, ...]


def all_forces(step: Substep, v: Three, q: tuple[Any, Any]) -> TrackForces:
    """Force and moment F, and all its derivatives.

    Args:
        step: inputs of the substep.
        v: twist.
        q: force at the centre of mass that transfers load.
    """
    body, c = step.body, step.body.constants
    weight = c["weight"]

    def terms(left: tuple[Grip, PointLoad], right: tuple[Grip, PointLoad]) -> list[Any]:
        found: list[Any] = []
        for row in range(3):
            grips = [
                (at[row], at.by_motion[row], at.by_stretch[row], of) for at, of in (left, right)
            ]
            found += [
                sum(weight * of.load * t for t, _, _, of in grips),
                *(sum(weight * of.load * by[k] for _, by, _, of in grips) for k in range(3)),
                *(weight * of.load * by[3] for _, by, _, of in grips),
                sum(of.by_right * t for t, _, _, of in grips),
                sum(of.by_forward * t for t, _, _, of in grips),
                sum(weight * (of.load * by + of.by_stretch * t) for t, _, by, of in grips),
            ]
        return found

    found = [-one for one in _over_points(step, v, terms)]
    rows = [found[:9], found[9:18], found[18:]]
    friction = [row[0] for row in rows]
    coefficient = body.parameters[ROLLING]
    unit_rolling = [0.0, 0.0, 0.0]
    on = step.on_tracks
    for track, side in enumerate((-1.0, 1.0)):
        at = rolling(body, v, step.V[track], side)
        load = coefficient * on.loads[track]
        for row, lever in ((1, 1.0), (2, at.lever)):
            unit, by_travel = lever * at.force, lever * load * at.by_travel
            unit_rolling[row] = unit_rolling[row] + unit * on.loads[track]
            more = [0.0] * 9
            more[2], more[3] = by_travel, at.lever * by_travel
            more[4 + track] = lever * load * at.by_track
            more[6] = coefficient * unit * on.by_right[track]
            more[7] = coefficient * unit * on.by_forward[track]
            more[8] = coefficient * unit * on.by_stretch[track]
            rows[row] = [one + other for one, other in zip(rows[row], more, strict=True)]
    values = [row[0] + coefficient * unit for row, unit in zip(rows, unit_rolling, strict=True)]
    columns: list[Three] = [tuple(row[k] for row in rows) for k in range(9)]
    by_right, by_forward, by_stretch = columns[6:]
    z_CM = body.centre[2]
    by_parameters: dict[int, Any] = {
        FRICTION: [one / body.parameters[FRICTION] for one in friction],
        ROLLING: unit_rolling,
        LENGTH: [one / c[f"nominal{LENGTH}"] for one in by_stretch],
        X_CM: [one * weight / z_CM for one in by_right],
        Y_CM: [one * weight / z_CM for one in by_forward],
        Z_CM: [
            (one * q[0] + other * q[1]) / z_CM
            for one, other in zip(by_right, by_forward, strict=True)
        ],
    }
    return TrackForces(
        tuple(values),
        tuple(tuple(row[1:4]) for row in rows),
        (columns[4], columns[5]),
        by_right,
        by_forward,
        tuple(tuple(by_parameters[k]) for k in range(PARAMETERS)),
    )
