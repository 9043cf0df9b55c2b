"""Forces of the ground on the tracks, for many motions."""

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.motion.icr import PaperTwist, inertial_force
from icreckon.simulation.contact.contact import Body, Contact, ground
from icreckon.simulation.contact.contact_forces import (
    COLUMNS,
    PointLoads,
    add_steady_balance,
    add_track_forces,
    point_loads,
)


class Loads(NamedTuple):
    """Loads of m contact points (m, n) for n motions, and which of them tip (n,)."""

    values: Any  # [N]
    by_right: Any  # derivative by the force at the centre of mass to the right [N/N]
    by_forward: Any  # derivative by that force forward [N/N]
    tipping: Any


class Wrench(NamedTuple):
    """Planar force and moment (3, n), and derivatives (3, 3, n) by v_x, v_y, w."""

    values: Any
    jacobian: Any


def vertical_loads(contact: Contact, right: Any = 0.0, forward: Any = 0.0) -> Loads:
    """Loads of the contact points under the weight and a force at the centre of mass (n,) [N]."""
    under = ground(contact)
    forces = np.stack(np.broadcast_arrays(np.atleast_1d(right), forward), axis=-1).astype(float)
    loads, by_right, by_forward = np.empty((3, len(forces), len(under.x)))
    tipping = [
        point_loads(under, under.weight, *force, PointLoads(*of_one))
        for force, *of_one in zip(forces, loads, by_right, by_forward, strict=True)
    ]
    return Loads(loads.T, by_right.T, by_forward.T, np.array(tipping))


def steady_inertia(twist: PaperTwist, body: Body) -> Any:
    """Force of inertia in steady motion (3, n), (4) and (10), and moment about the origin."""
    right, forward = inertial_force(twist, body.mass, body.x_CM, body.y_CM)
    return np.stack([right, forward, body.x_CM * forward - body.y_CM * right])


def _room(*parts: Any) -> tuple[Any, Any, Any]:
    """Parts as the columns of a matrix, and zeros for forces and derivatives."""
    motion = np.stack(np.broadcast_arrays(*map(np.atleast_1d, parts)), axis=-1)
    motion = motion if np.iscomplexobj(motion) else motion.astype(float)
    values = np.zeros((len(motion), 3), dtype=motion.dtype)
    return motion, values, np.zeros((len(motion), 3, COLUMNS), dtype=motion.dtype)


def track_forces(
    twist: PaperTwist, V_l: Any, V_r: Any, contact: Contact, loads: Loads
) -> tuple[Wrench, Any, Any]:
    """Force and moment of the ground on both tracks at given loads."""
    motion, values, jacobian = _room(*twist, V_l, V_r)
    of_points = (len(motion), len(loads.values))
    pressing = PointLoads(
        *(np.ascontiguousarray(np.broadcast_to(part.T, of_points)) for part in loads[:3])
    )
    for k, (v_x, v_y, w, left, right) in enumerate(motion):
        of_one = PointLoads(*(part[k] for part in pressing))
        add_track_forces(
            ground(contact), (v_x, v_y, w), (left, right), of_one, values[k], jacobian[k]
        )
    slopes = np.moveaxis(jacobian, 0, -1)
    return Wrench(values.T, slopes[:, :3]), slopes[:, 5], slopes[:, 6]


def steady_balance(twist: PaperTwist, V_l: Any, V_r: Any, contact: Contact) -> Wrench:
    """Residual of all forces and moments in steady motion."""
    motion, values, jacobian = _room(*twist, V_l, V_r)
    under = ground(contact)
    pressing = PointLoads(
        np.empty(len(under.x), motion.dtype), np.empty(len(under.x)), np.empty(len(under.x))
    )
    for k, (v_x, v_y, w, left, right) in enumerate(motion):
        add_steady_balance(under, (v_x, v_y, w), (left, right), pressing, values[k], jacobian[k])
    return Wrench(values.T, np.moveaxis(jacobian, 0, -1)[:, :3])
