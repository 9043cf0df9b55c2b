"""Forces of the ground on the tracks, for many motions."""

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.motion.icr import PaperTwist
from icreckon.simulation.contact.contact import Contact, Loads, ground
from icreckon.simulation.contact.contact_forces import (
    COLUMNS,
    PointLoads,
    add_steady_balance,
    add_track_forces,
)


class Wrench(NamedTuple):
    """Planar force and moment (3, n), and derivatives (3, 3, n) by v_x, v_y, w."""

    values: Any
    jacobian: Any


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
