"""Forces of the ground on the tracks at given loads, for many motions."""

from typing import Any

import numpy as np

from icreckon.estimator.motion.icr import PaperTwist
from icreckon.simulation.contact.contact import Contact, Loads, Wrench, ground
from icreckon.simulation.contact.contact_forces import COLUMNS, PointLoads, add_track_forces


def track_forces(
    twist: PaperTwist, V_l: Any, V_r: Any, contact: Contact, loads: Loads
) -> tuple[Wrench, Any, Any]:
    """Force and moment of the ground on both tracks at given loads."""
    motion = np.stack(np.broadcast_arrays(*map(np.atleast_1d, (*twist, V_l, V_r))), axis=-1)
    motion = motion if np.iscomplexobj(motion) else motion.astype(float)
    values = np.zeros((len(motion), 3), dtype=motion.dtype)
    jacobian = np.zeros((len(motion), 3, COLUMNS), dtype=motion.dtype)
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
