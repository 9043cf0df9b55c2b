"""Dynamic mapping of the paper: ICRs, inertia, indices from stationary motions.

Sections II to IV of the paper, on stationary motions from `simulation.contact.steady_state` over a
grid of track speeds; `fits.py` derives means and fits from it. Symbols and axes are the paper's
(X right, Y forward); equations come from `icreckon.estimator.motion.icr`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import (
    Icrs,
    IndexValues,
    PaperTwist,
    direct,
    icrs_from_twist,
    indices_at_inertia,
    indices_from_icrs,
    inertial_force,
    symmetry_coordinates,
    velocity_of_centre_of_mass,
)
from icreckon.estimator.motion.index_model import solve
from icreckon.estimator.motion.motion_model import VehicleConstants
from icreckon.estimator.robot.robot_file import ConstantIcr, Indices
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.contact.steady_state import SteadyMotion

Inertia = Literal["measured", "literal", "smooth"]
MOTION_COLUMNS = (
    "V_l_m_s,V_r_m_s,v_x_m_s,v_y_m_s,w_rad_s,x_ICRl_m,x_ICRr_m,y_ICR_m,zeta_m,epsilon_m,eta,"
    "F_x_N,F_y_N,F_N"
)


@dataclass(frozen=True)
class DynamicMap:
    """Stationary motions of a vehicle, with the quantities of section II and III.

    Arrays have the shape of the grid of track speeds, V_l along the first axis.
    """

    motion: SteadyMotion  # track speeds and twists
    vehicle: VehicleConstants  # L, M and the centre of mass
    turning: NDArray[np.bool_]  # mask of V_l unlike V_r; elsewhere ICRs and indices are NaN
    icrs: Icrs  # ICRs of the tracks, (1) to (3) [m]
    indices: IndexValues  # zeta, epsilon [m], eta [-], (17) to (19)
    inertia: tuple[Floats, Floats]  # force of inertia right and forward [N], (10)
    magnitude: Floats  # magnitude of that force [N], (11)


class VelocityErrors(NamedTuple):
    """RMS errors of v_x, v_y [m/s] and w [rad/s] for both models, as in Table II."""

    inertia_based: PaperTwist
    constant: PaperTwist


def map_of(motion: SteadyMotion, vehicle: VehicleConstants) -> DynamicMap:
    """Make the map of stationary motions, on a grid of track speeds or at any."""
    turning = (motion.V_l != motion.V_r) & (motion.twist.w != 0.0)
    turning_twist = PaperTwist(
        *(np.where(turning, component, np.nan) for component in motion.twist)
    )
    icrs = icrs_from_twist(motion.V_l, motion.V_r, turning_twist)
    inertia = inertial_force(motion.twist, vehicle.mass, vehicle.x_CM, vehicle.y_CM)
    indices = indices_from_icrs(icrs, vehicle.gauge)
    return DynamicMap(motion, vehicle, turning, icrs, indices, inertia, np.hypot(*inertia))


def on_spot_line(mapped: DynamicMap) -> float:
    """H of (13): the slope of the line of least inertia V_l = -H V_r on the grid.

    On that line the centre of mass moves only laterally, so its forward velocity changes sign. For each
    V_r except zero the crossing along V_l is interpolated linearly. H is the slope of the line through
    the origin that fits the crossings best (least squares). V_l of the map rises along the first axis,
    V_r along the second.

    Raises:
        SimulationError: not a grid, or no crossing on it.
    """
    motion, vehicle = mapped.motion, mapped.vehicle
    if motion.V_l.ndim != 2 or min(motion.V_l.shape) < 2:
        raise SimulationError(
            f"the line of least inertia needs a grid of track speeds, found shape {motion.V_l.shape}"
        )
    _, forward = velocity_of_centre_of_mass(motion.twist, vehicle.x_CM, vehicle.y_CM)
    rises = (forward[:-1] < 0.0) & (forward[1:] >= 0.0) & (motion.V_r[1:] != 0.0)
    below, column = np.nonzero(rises)  # indices of the grid point just before each crossing
    if not below.size:
        raise SimulationError("no on-spot turning on this grid of track speeds; widen it")
    before, after = forward[below, column], forward[below + 1, column]
    share = before / (before - after)
    V_r, V_l_below = motion.V_r[below, column], motion.V_l[below, column]
    V_l = V_l_below + share * (motion.V_l[below + 1, column] - V_l_below)
    return float(-(V_l @ V_r) / (V_r @ V_r))


def inertia_based_twist(mapped: DynamicMap, parameters: Indices, inertia: Inertia) -> PaperTwist:
    """Twists of the inertia-based kinematics at the map's track speeds.

    Equations (20) to (22) and (25) to (27). `inertia` is "measured" for the map's |F|, as from an IMU;
    "literal" or "smooth" for |F| implied by the model itself
    (`icreckon.estimator.motion.index_model.solve` in that form).
    """
    V_l, V_r = mapped.motion.V_l, mapped.motion.V_r
    if inertia != "measured":
        return solve(V_l, V_r, parameters.as_array(), mapped.vehicle, form=inertia).twist
    x_1, x_2 = symmetry_coordinates(V_l, V_r, parameters.H)
    indices = indices_at_inertia(mapped.magnitude, x_1, x_2, parameters.as_array())
    return direct(V_l, V_r, indices, mapped.vehicle.gauge)


def constant_twist(mapped: DynamicMap, icrs: ConstantIcr) -> PaperTwist:
    """Twists of the constant-ICR kinematics at the map's track speeds."""
    constant = Icrs(icrs.x_ICRl, icrs.x_ICRr, icrs.y_ICR)
    gauge = mapped.vehicle.gauge
    return direct(mapped.motion.V_l, mapped.motion.V_r, indices_from_icrs(constant, gauge), gauge)


def rmse(twist: PaperTwist, truth: PaperTwist, counted: Any = ...) -> PaperTwist:
    """RMSE of each velocity component, over the `counted` motions (mask)."""
    errors = np.stack(twist) - np.stack(truth)
    return PaperTwist(*(float(np.sqrt(np.mean(error[counted] ** 2))) for error in errors))


def write_motions(path: Path, mapped: DynamicMap) -> None:
    """Write the motions of a map as a CSV table, in the paper's axes.

    X is right, Y forward. ICRs and indices of motions that do not turn are empty cells.
    """
    speeds = mapped.motion.V_l, mapped.motion.V_r
    motion = *speeds, *mapped.motion.twist, *mapped.icrs, *mapped.indices
    columns = [np.ravel(column) for column in (*motion, *mapped.inertia, mapped.magnitude)]
    rows = np.stack(columns, axis=-1).tolist()
    texts = [["" if np.isnan(value) else f"{value:.9g}" for value in row] for row in rows]
    lines = [MOTION_COLUMNS, *map(",".join, texts)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
