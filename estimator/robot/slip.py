"""Size of the slip residual at given track speeds."""

from typing import Any

from icreckon.estimator.robot.robot_file import Slip


def slip_components(V_l: Any, V_r: Any, slip: Slip, effective_gauge: float) -> tuple[Any, Any, Any]:
    """Standard deviations of the slip residual of v_x, v_y, w (REP-103), see `Slip`.

    Args:
        V_l: speed of the left track [m/s], (n,) or a float.
        V_r: speed of the right track [m/s], (n,) or a float.
        slip: shares of turning and driving.
        effective_gauge: L eta0 [m].

    Returns:
        Three (n,) or floats [m/s, m/s, rad/s].
    """
    turning, driving = abs(V_r - V_l), 0.5 * abs(V_l + V_r)
    return (
        slip.turning_x * turning + slip.driving_x * driving,
        slip.turning_y * turning + slip.driving_y * driving,
        slip.turning_w / effective_gauge * turning + slip.driving_w * driving,
    )
