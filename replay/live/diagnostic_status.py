"""One line of a diagnostics panel (diagnostic_msgs/DiagnosticStatus)."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats

OK, WARN, ERROR, STALE = 0, 1, 2, 3  # levels, as diagnostic_msgs numbers them
LARGE_NIS = 4.0  # mean NIS per degree of freedom from which a sensor is reported as `WARN`


class DiagnosticStatus(NamedTuple):
    """Status of one component."""

    level: int  # `OK`, `WARN`, `ERROR` or `STALE`
    name: str  # name of the component
    message: str  # summary in one sentence
    values: dict[str, str]  # details by key


def estimate_status(
    name: str, covariance: Floats, twist: Floats, details: Mapping[str, str] | None = None
) -> DiagnosticStatus:
    """Make the status of an estimate, with its uncertainty and its twist as details.

    `covariance` (3, 3) is of x, y [m], yaw [rad]; `twist` (3,) is v_x, v_y [m/s], w [rad/s] of base_link.
    """
    position = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]), 0.0))
    yaw = math.degrees(math.sqrt(max(float(covariance[2, 2]), 0.0)))
    v_x, v_y, w = twist.tolist()
    values = {
        "position_sigma_m": f"{position:.4f}",
        "yaw_sigma_deg": f"{yaw:.4f}",
        "v_x_m_s": f"{v_x:.4f}",
        "v_y_m_s": f"{v_y:.4f}",
        "w_rad_s": f"{w:.4f}",
        **(details or {}),
    }
    return DiagnosticStatus(OK, name, f"sigma {position:.2f} m, {yaw:.2f} deg", values)
