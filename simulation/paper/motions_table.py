"""Table of the stationary motions behind the paper's figures."""

from pathlib import Path

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.simulation.paper.dynamic_map import DynamicMap


def motion_columns(mapped: DynamicMap) -> dict[str, Floats]:
    """Columns (n,) of the motions of a map by name, in the paper's axes.

    X is right, Y forward. ICRs and indices of motions that do not turn are NaN.
    """
    motion, icrs, indices = mapped.motion, mapped.icrs, mapped.indices
    columns = {
        "V_l_m_s": motion.V_l,
        "V_r_m_s": motion.V_r,
        "v_x_m_s": motion.twist.v_x,
        "v_y_m_s": motion.twist.v_y,
        "w_rad_s": motion.twist.w,
        "x_ICRl_m": icrs.x_ICRl,
        "x_ICRr_m": icrs.x_ICRr,
        "y_ICR_m": icrs.y_ICR,
        "zeta_m": indices.zeta,
        "epsilon_m": indices.epsilon,
        "eta": indices.eta,
        "F_x_N": mapped.inertia[0],
        "F_y_N": mapped.inertia[1],
        "F_N": mapped.magnitude,
    }
    return {name: np.asarray(values, dtype=float).ravel() for name, values in columns.items()}


def write_motions(path: Path, mapped: DynamicMap) -> None:
    """Write the motions of a map as a CSV table; NaN are empty cells."""
    columns = motion_columns(mapped)
    lines = [",".join(columns)]
    lines += [
        ",".join("" if np.isnan(value) else f"{value:.9g}" for value in row)
        for row in zip(*(values.tolist() for values in columns.values()), strict=True)
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
