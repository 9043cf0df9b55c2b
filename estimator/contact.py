"""The contact of two tracks with hard ground: vertical loads and horizontal forces at contact points.

Symbols and axes are the paper's: X right, Y forward, Z up, origin at the centre of the tracks' contact
area; the twist is (v_x, v_y, w) of the origin, moments are about the origin, counter-clockwise positive.

A contact point at (x, y) on a track of speed V slips over the ground with

    s = (v_x - w y,  v_y + w x - V).

Its friction is, with u = (mu_x s_x, mu_y s_y), the load p of the point and a small regularising speed d,

    f = -p h (mu_x u_x, mu_y u_y) / q,     q^2 = u_x^2 + u_y^2 + mu_x mu_y d^2,

which for mu_x = mu_y = mu is Coulomb's -p mu s / |s|, and otherwise the friction of greatest dissipation
within the ellipse (f_x / mu_x)^2 + (f_y / mu_y)^2 = p^2 (Goyal, Ruina and Papadopoulos, Planar sliding
with dry friction, Wear 143, 1991). h = 1 - exp(-j / K) is the share of the friction that the shear
displacement j has built up (Wong and Chiang, A general theory for skid steering of tracked vehicles on
firm ground, Proc. IMechE D 215, 2001); without a shear modulus h = 1.

Each track also carries its rolling resistance along its centreline, -f_r N v / sqrt(v^2 + d^2), where N
is the track's load and v the speed of that centreline over the ground.

Vertical loads are planar: p = weight (a + b x + c y), with a, b, c from the sum of the loads and the two
moments about the ground of the vehicle's weight and of a horizontal force at the centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from estimator.kinematics import GRAVITY, PaperTwist, inertial_force

Floats = NDArray[np.float64]

# How far inside the contact's edge the centre of pressure of a tipping vehicle is kept, as a share of
# half the contact's extent; on the edge itself the planar loads are not unique.
TIPPING_MARGIN = 1e-6
ACTIVE_SET_ITERATIONS = 100
ARMIJO = 1e-4
# Below this share of the mean load, a load is zero to rounding.
NO_LOAD = 1e-13


class Soil(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the ground does to a track.

    Attributes:
        friction: coefficient of friction mu, across the track, and along it unless
            `longitudinal_friction` says otherwise [-].
        longitudinal_friction: coefficient along the track; None for isotropic friction [-].
        rolling_resistance: resistance of a track as a share of its load [-].
        shear_modulus: shear deformation modulus K; 0 for full friction at any slip [m].
        regularising_speed: slip and travel below which friction and rolling resistance fade to
            zero instead of jumping [m/s].
        resistance_opposes: "travel", the motion of the track's centreline over the ground, or
            "track", the motion of the track around its rollers.
    """

    friction: float = 0.9
    longitudinal_friction: float | None = None
    rolling_resistance: float = 0.0
    shear_modulus: float = 0.0
    regularising_speed: float = 1e-4
    resistance_opposes: Literal["travel", "track"] = "travel"

    def __post_init__(self) -> None:
        _require_positive("friction", self.friction)
        if self.longitudinal_friction is not None:
            _require_positive("longitudinal_friction", self.longitudinal_friction)
        _require_positive("regularising_speed", self.regularising_speed)
        for name in ("rolling_resistance", "shear_modulus"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be zero or a positive number, found {value!r}")

    @property
    def coefficients(self) -> tuple[float, float]:
        """Coefficients of friction (right, forward) [-]."""
        along = self.longitudinal_friction
        return self.friction, self.friction if along is None else along


class ContactGeometry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where the tracks touch the ground; both tracks alike.

    Attributes:
        gauge: distance L between the track centrelines [m].
        positions: forward coordinates of the contact points of a track, rising [m].
        weights: share of the load that each of them takes where the ground presses evenly, any
            common scale; () for equal shares.
        across: outward offsets from the centreline at which each position touches [m]; more than one
            spreads it evenly over the tread's width.
    """

    gauge: float
    positions: tuple[float, ...]
    weights: tuple[float, ...] = ()
    across: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        _require_positive("gauge", self.gauge)
        if len(self.positions) < 2 or not np.all(np.diff(self.positions) > 0.0):
            raise ValueError(f"positions must be two or more, rising, found {self.positions!r}")
        if self.weights and len(self.weights) != len(self.positions):
            raise ValueError(
                f"weights must be as many as positions ({len(self.positions)}), "
                f"found {len(self.weights)}"
            )
        for weight in self.weights:
            _require_positive("weights", weight)
        if not self.across or not np.all(np.abs(self.across) < 0.5 * self.gauge):
            raise ValueError(
                f"across must be one or more offsets of less than half the gauge, "
                f"found {self.across!r}"
            )


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rigid vehicle on its tracks.

    Attributes:
        mass: M [kg].
        x_CM: centre of mass, right of the origin [m].
        y_CM: forward of it [m].
        z_CM: above the ground [m].
    """

    mass: float
    x_CM: float = 0.0
    y_CM: float = 0.0
    z_CM: float = 0.0

    def __post_init__(self) -> None:
        _require_positive("mass", self.mass)
        if not np.all(np.isfinite([self.x_CM, self.y_CM, self.z_CM])) or self.z_CM < 0.0:
            raise ValueError(
                "the centre of mass must be finite and not below the ground, found "
                f"{(self.x_CM, self.y_CM, self.z_CM)!r}"
            )

    @property
    def weight(self) -> float:
        """Weight M g [N]."""
        return self.mass * GRAVITY


@dataclass(frozen=True)
class Contact:
    """Everything that the forces of the tracks depend on, besides the motion.

    Attributes:
        soil: friction, rolling resistance, shear.
        geometry: the contact points.
        body: mass and centre of mass, which must lie over the contact.

    Raises:
        ValueError: the centre of mass lies outside the contact's outline.
    """

    soil: Soil
    geometry: ContactGeometry
    body: Body

    def __post_init__(self) -> None:
        half, rear, front = _outline(self.geometry)
        if not (abs(self.body.x_CM) < half and rear < self.body.y_CM < front):
            raise ValueError(
                f"the centre of mass ({self.body.x_CM!r}, {self.body.y_CM!r}) m lies outside the "
                f"contact, {-half!r} to {half!r} m right and {rear!r} to {front!r} m forward"
            )


class Loads(NamedTuple):
    """Vertical loads of m contact points (left track first) for n motions.

    Attributes:
        values: (m, n) [N], never negative.
        by_right: (m, n) or (m, 1) derivative by the force at the centre of mass to the right [N/N].
        by_forward: the same by the force forward.
        tipping: (n,) whether the weight and the force point outside the contact: no loads balance
            their moment, and `values` are those with the centre of pressure held at the edge.
    """

    values: Any
    by_right: Any
    by_forward: Any
    tipping: NDArray[np.bool_]


class Wrench(NamedTuple):
    """Planar force and moment, with derivatives.

    Attributes:
        values: (3, n) force right, forward [N], moment about the origin [N m].
        jacobian: (3, 3, n), row the component, column v_x, v_y [N s/m], w [N s/rad].
    """

    values: Any
    jacobian: Any


class ContactPoints(NamedTuple):
    """Coordinates (right, forward) [m] and weights [-] of the m contact points, left track first."""

    x: Floats
    y: Floats
    weight: Floats


def equally_spaced(gauge: float, half_length: float, count: int) -> ContactGeometry:
    """Contact points at even distances from end to end of each track.

    Args:
        gauge: distance L between the track centrelines [m].
        half_length: half the length of a track's contact with the ground [m].
        count: contact points per track, at least 2.
    """
    positions = np.linspace(-half_length, half_length, count)
    return ContactGeometry(gauge, tuple(float(position) for position in positions))


@lru_cache(maxsize=64)
def contact_points(geometry: ContactGeometry) -> ContactPoints:
    """The contact points of both tracks; weights sum to 1 over both."""
    across = np.tile(geometry.across, len(geometry.positions))
    along = np.repeat(geometry.positions, len(geometry.across))
    weights = np.array(geometry.weights or (1.0,) * len(geometry.positions))
    weights = np.repeat(weights, len(geometry.across))
    right = 0.5 * geometry.gauge + across
    points = ContactPoints(
        np.concatenate([-right, right]),
        np.concatenate([along, along]),
        np.concatenate([weights, weights]) / (2.0 * weights.sum()),
    )
    for values in points:
        values.setflags(write=False)
    return points


def vertical_loads(
    contact: Contact, right: Any = 0.0, forward: Any = 0.0, *, weight: Any = None
) -> Loads:
    """Loads of the contact points under the weight and a horizontal force at the centre of mass.

    Loads are planar over the points that touch and zero at those that lift off:
    p = weight max(0, a + b x + c y). They solve a convex problem, the least of
    sum(p^2 / weight) under the balance of force and moments and p >= 0, which is unique while the
    weight and the force together point inside the contact. It is solved by Newton's iteration over
    the set of touching points, with a line search on the dual function, which ends at the exact set.

    Args:
        contact: geometry and centre of mass.
        right: (n,) force at the centre of mass [N]: inertia, and gravity's part along a slope.
        forward: (n,) the same, forward [N].
        weight: force that presses on the ground [N]; the vehicle's weight where left out.
    """
    points, body = contact_points(contact.geometry), contact.body
    right, forward = np.atleast_1d(right), np.atleast_1d(forward)
    weight = body.weight if weight is None else weight
    arm = body.z_CM / weight
    half, rear, front = _outline(contact.geometry)
    inside = 1.0 - TIPPING_MARGIN
    x, x_free = _held(body.x_CM + arm * right, -half, half, inside)
    y, y_free = _held(body.y_CM + arm * forward, rear, front, inside)
    basis, even = _planar(contact.geometry)
    plane = weight * (even[:, :1] + even[:, 1:2] * x + even[:, 2:] * y)
    values = points.weight[:, None] * (basis.T @ plane)
    share = points.weight[:, None] * (basis.T @ even) * body.z_CM
    by_right, by_forward = share[:, 1:2], share[:, 2:3]
    tipping = ~(x_free & y_free)
    lifted = (values.real < 0.0).any(axis=0) | tipping
    if lifted.any():
        by_right = np.repeat(by_right, values.shape[1], axis=1)
        by_forward = np.repeat(by_forward, values.shape[1], axis=1)
        moments = np.stack(np.broadcast_arrays(weight, weight * x, weight * y))[:, lifted]
        start = np.broadcast_to(plane, (3, values.shape[1]))[:, lifted]
        solved, active, inverse = _touching(basis, points.weight, moments.real, start.real)
        touching = points.weight[:, None] * active
        values[:, lifted] = touching * np.maximum(basis.T @ solved, 0.0)
        slopes = touching * np.einsum("im,ijn->jmn", basis, inverse) * body.z_CM
        by_right[:, lifted] = slopes[1] * x_free[lifted]
        by_forward[:, lifted] = slopes[2] * y_free[lifted]
    return Loads(values, by_right, by_forward, tipping)


def track_forces(
    twist: PaperTwist, V_l: Any, V_r: Any, contact: Contact, loads: Loads
) -> tuple[Wrench, Any, Any]:
    """Force and moment of the ground on both tracks at given loads.

    Args:
        twist: velocity of the origin, (n,) each.
        V_l: (n,) speed of the left track [m/s].
        V_r: (n,) speed of the right track [m/s].
        contact: soil, geometry, body.
        loads: from `vertical_loads`.

    Returns:
        The wrench with its Jacobian by the twist at these loads, and the derivatives (3, n) of its
        values by the force at the centre of mass to the right and forward, through the loads.
    """
    points = contact_points(contact.geometry)
    per_track = len(points.x) // 2
    x, y = points.x[:, None], points.y[:, None]
    soil = contact.soil
    mu_x, mu_y = soil.coefficients
    V = np.stack(np.broadcast_arrays(V_l, V_r))
    track = np.repeat([0, 1], per_track)
    s_x = twist.v_x - y * twist.w
    s_y = twist.v_y + x * twist.w - V[track]
    u_x, u_y = mu_x * s_x, mu_y * s_y
    inverse = 1.0 / np.sqrt(u_x * u_x + u_y * u_y + mu_x * mu_y * soil.regularising_speed**2)
    e_x, e_y = u_x * inverse, u_y * inverse
    t_x, t_y = mu_x * e_x, mu_y * e_y
    pressed = loads.values * inverse
    shear = None
    if soil.shear_modulus > 0.0:
        shear = _shear(twist, V, contact)
        pressed = pressed * shear.built_up
    k_xx = mu_x * mu_x * pressed * (1.0 - e_x * e_x)
    k_xy = -mu_x * mu_y * pressed * e_x * e_y
    k_yy = mu_y * mu_y * pressed * (1.0 - e_y * e_y)
    jacobian = -_symmetric(contact.geometry, k_xx, k_xy, k_yy)
    if shear is not None:
        # The product rule's other half: what a change of the shear displacement does.
        p_x, p_y = loads.values * t_x, loads.values * t_y
        for column, change in enumerate(shear.by_twist):
            jacobian[:, column] -= _resultant(contact.geometry, p_x * change, p_y * change)
        t_x, t_y = t_x * shear.built_up, t_y * shear.built_up
    values = -_resultant(contact.geometry, loads.values * t_x, loads.values * t_y)
    by_right = -_resultant_of(contact.geometry, loads.by_right, t_x, t_y)
    by_forward = -_resultant_of(contact.geometry, loads.by_forward, t_x, t_y)
    if soil.rolling_resistance > 0.0:
        for side, X in enumerate((-0.5 * contact.geometry.gauge, 0.5 * contact.geometry.gauge)):
            of_track = slice(side * per_track, (side + 1) * per_track)
            speed, free = V[side], 0.0
            if soil.resistance_opposes == "travel":
                speed, free = twist.v_y + X * twist.w, 1.0
            scale = 1.0 / np.sqrt(speed * speed + soil.regularising_speed**2)
            unit = -soil.rolling_resistance * speed * scale
            load = loads.values[of_track].sum(axis=0)
            slope = -free * soil.rolling_resistance * load * scale**3 * soil.regularising_speed**2
            for row, lever in ((1, 1.0), (2, X)):
                values[row] += lever * load * unit
                by_right[row] += lever * loads.by_right[of_track].sum(axis=0) * unit
                by_forward[row] += lever * loads.by_forward[of_track].sum(axis=0) * unit
                jacobian[row, 1] += lever * slope
                jacobian[row, 2] += lever * X * slope
    return Wrench(values, jacobian), by_right, by_forward


def steady_inertia(twist: PaperTwist, body: Body) -> Wrench:
    """Force of inertia in steady motion, (4) and (10), acting at the centre of mass."""
    right, forward = inertial_force(twist, body.mass, body.x_CM, body.y_CM)
    v_x, v_y, w = np.broadcast_arrays(*twist)
    zero = np.zeros_like(w)
    M, x, y = body.mass, body.x_CM, body.y_CM
    of_right = np.stack([zero, M * w, M * (v_y + 2.0 * x * w)])
    of_forward = np.stack([-M * w, zero, M * (2.0 * y * w - v_x)])
    return Wrench(
        np.stack([right, forward, x * forward - y * right]),
        np.stack([of_right, of_forward, x * of_forward - y * of_right]),
    )


def steady_balance(twist: PaperTwist, V_l: Any, V_r: Any, contact: Contact) -> Wrench:
    """What is left of all forces and moments in steady motion; zero at a stationary twist.

    Friction and rolling resistance at the loads that the force of inertia gives, plus that force.

    Args:
        twist: velocity of the origin, (n,) each.
        V_l: (n,) speed of the left track [m/s].
        V_r: (n,) speed of the right track [m/s].
        contact: soil, geometry, body.
    """
    inertia = steady_inertia(twist, contact.body)
    loads = vertical_loads(contact, inertia.values[0], inertia.values[1])
    tracks, by_right, by_forward = track_forces(twist, V_l, V_r, contact, loads)
    jacobian = tracks.jacobian + inertia.jacobian
    jacobian += by_right[:, None] * inertia.jacobian[0]
    jacobian += by_forward[:, None] * inertia.jacobian[1]
    return Wrench(tracks.values + inertia.values, jacobian)


class _Shear(NamedTuple):
    """Share h of the friction that is built up, and its derivatives by v_x, v_y, w; (m, n) each."""

    built_up: Any
    by_twist: tuple[Any, Any, Any]


def _shear(twist: PaperTwist, V: Any, contact: Contact) -> _Shear:
    """Wong and Chiang's share of the friction at each contact point.

    A point of the track enters the contact at the end toward which the track drives, and reaches y
    after the time |y - y_entry| / |V|; its shear displacement is the slip summed over that time in
    the vehicle's axes (the vehicle's turn meanwhile is neglected). A track at rest has been dragged
    for ever: no end counts as the entry, and all its points are built up.
    """
    points, soil = contact_points(contact.geometry), contact.soil
    per_track = len(points.x) // 2
    x, y = points.x[:, None], points.y[:, None]
    front, rear = contact.geometry.positions[-1], contact.geometry.positions[0]
    direction = np.sign(V.real)[np.repeat([0, 1], per_track)]
    entry = np.where(direction > 0.0, front, np.where(direction < 0.0, rear, y))
    passage = np.where(direction == 0.0, front - rear, np.abs(y - entry))
    small = soil.regularising_speed
    time = passage / np.sqrt(V * V + small * small)[np.repeat([0, 1], per_track)]
    middle = 0.5 * (y + entry)
    m_x = twist.v_x - middle * twist.w
    m_y = twist.v_y + x * twist.w - V[np.repeat([0, 1], per_track)]
    speed = np.sqrt(m_x * m_x + m_y * m_y + small * small)
    missing = np.exp(-time * speed / soil.shear_modulus)
    slope = missing * time / (soil.shear_modulus * speed)
    return _Shear(1.0 - missing, (slope * m_x, slope * m_y, slope * (x * m_y - middle * m_x)))


def _touching(
    basis: Floats, weight: Floats, moments: Floats, start: Floats
) -> tuple[Floats, NDArray[np.bool_], Floats]:
    """Planes (3, n) with sum(weight max(0, plane) basis) = moments, for the vehicles that lift points.

    Returns:
        The planes, which points touch (m, n), and the inverses (3, 3, n) of the touching points'
        moment matrices.
    """
    products = weight * basis[:, None] * basis
    scale = np.abs(moments[0])

    def dual(plane: Floats) -> Floats:
        pressed = np.maximum(basis.T @ plane, 0.0)
        return np.asarray(0.5 * weight @ pressed**2 - (moments * plane).sum(axis=0))

    plane = np.array(start)
    done = np.zeros(plane.shape[1], dtype=bool)
    for _ in range(ACTIVE_SET_ITERATIONS):
        active = basis.T @ plane > 0.0
        matrix = np.moveaxis(products @ active.astype(float), -1, 0)
        gradient = np.einsum("nij,jn->in", matrix, plane) - moments
        done = np.abs(gradient).max(axis=0) <= NO_LOAD * scale * len(weight)
        if done.all():
            break
        step = -np.einsum("nij,jn->in", np.linalg.pinv(matrix, rcond=1e-14), gradient)
        descent = (gradient * step).sum(axis=0)
        size, before = np.where(done, 0.0, 1.0), dual(plane)
        for _ in range(40):
            worse = dual(plane + size * step) > before + ARMIJO * size * descent + 1e-15 * scale
            if not worse.any():
                break
            size = np.where(worse, 0.5 * size, size)
        plane = plane + size * step
    inverse = np.moveaxis(np.linalg.pinv(matrix, rcond=1e-14, hermitian=True), 0, -1)
    return plane, active, inverse


@lru_cache(maxsize=64)
def _planar(geometry: ContactGeometry) -> tuple[Floats, Floats]:
    """The functions 1, x, y at the contact points (3, m), and the inverse of their moment matrix."""
    points = contact_points(geometry)
    basis = np.stack([np.ones_like(points.x), points.x, points.y])
    even = np.linalg.inv((points.weight * basis) @ basis.T)
    return basis, np.asarray(even, dtype=float)


def _outline(geometry: ContactGeometry) -> tuple[float, float, float]:
    """Half width, rear and front end [m] of the rectangle around all contact points."""
    half = 0.5 * geometry.gauge + max(geometry.across)
    return half, geometry.positions[0], geometry.positions[-1]


def _held(value: Any, low: float, high: float, inside: float) -> tuple[Any, NDArray[np.bool_]]:
    """The value kept within [low, high], shrunk about its middle, and where it needed no keeping."""
    middle, reach = 0.5 * (low + high), 0.5 * (high - low) * inside
    offset = value - middle
    free = np.abs(offset.real) < reach
    return middle + np.where(free, offset, np.sign(offset.real) * reach), free


@lru_cache(maxsize=64)
def _levers(geometry: ContactGeometry) -> tuple[Floats, ...]:
    """Sums over the points as matrix products: [1, y], [1, x], [1, y, y²], [1, x, y, xy], [1, x, x²]."""
    x, y, _ = contact_points(geometry)
    one = np.ones_like(x)
    return (
        np.stack([one, y]),
        np.stack([one, x]),
        np.stack([one, y, y * y]),
        np.stack([one, x, y, x * y]),
        np.stack([one, x, x * x]),
    )


def _resultant(geometry: ContactGeometry, f_x: Any, f_y: Any) -> Any:
    """Force and moment (3, n) of forces (m, n) at the contact points."""
    by_x, by_y, *_ = _levers(geometry)
    right, turning = by_x @ f_x
    forward, lifting = by_y @ f_y
    return np.stack([right, forward, lifting - turning])


def _resultant_of(geometry: ContactGeometry, slope: Any, t_x: Any, t_y: Any) -> Any:
    """The same of forces slope * t, where the slope may be one column for all motions."""
    if slope.shape[1] > 1 or t_x.shape[1] == 1:
        return _resultant(geometry, slope * t_x, slope * t_y)
    by_x, by_y, *_ = _levers(geometry)
    right, turning = (by_x * slope[:, 0]) @ t_x
    forward, lifting = (by_y * slope[:, 0]) @ t_y
    return np.stack([right, forward, lifting - turning])


def _symmetric(geometry: ContactGeometry, k_xx: Any, k_xy: Any, k_yy: Any) -> Any:
    """Derivative (3, 3, n) of force and moment by the twist from those of the points' forces."""
    _, _, for_xx, for_xy, for_yy = _levers(geometry)
    xx, xx_y, xx_yy = for_xx @ k_xx
    xy, xy_x, xy_y, xy_xy = for_xy @ k_xy
    yy, yy_x, yy_xx = for_yy @ k_yy
    x_w, y_w = xy_x - xx_y, yy_x - xy_y
    return np.array([[xx, xy, x_w], [xy, yy, y_w], [x_w, y_w, xx_yy - 2.0 * xy_xy + yy_xx]])


def _require_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be a positive number, found {value!r}")
