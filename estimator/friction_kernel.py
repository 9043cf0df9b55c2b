"""A step of the friction motion model and of its derivatives, compiled.

The body's twist v about the origin follows the tracks by the forces of `estimator.contact_kernel`. A
step of h seconds is implicit in what is stiff, friction, and explicit in what is slow, the loads and the
force of inertia I:

    A (v' - v) = h (F(v', V, loads(q)) + I(v))
    q' = k q - (1 - k) F(v', V, loads(q)),  k = exp(-h / T)

A is the mass matrix about the origin, V are the track speeds and q the force at the centre of mass that
the loads answer to, with the lag T of a body that rolls and pitches on its suspension. At given loads
friction has a potential, so v' is the minimum of a convex function, which Newton's iteration with a line
search finds from anywhere; the friction's regularising speed is that of `FrictionMotion`, well above that
of the soil.

Beside it run the derivatives of v and q by the parameters (forward sensitivities, from the implicit
function theorem at each step) and those of v by the track speeds of the step alone.

Symbols and axes are the paper's. Import this module inside functions only: numba takes half a second to
load.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.contact_kernel import (
    COLUMNS,
    Ground,
    add_track_forces,
    compiled,
    point_loads,
    solve_3,
)
from estimator.friction_motion import (
    AT_PARAMETERS,
    AT_SPEEDS,
    FRICTION,
    LENGTH,
    OF_SENSITIVITIES,
    OF_SPEEDS,
    OF_STATES,
    PARAMETERS,
    ROLLING,
    STARTED,
    STATES,
    TURN,
    X_CM,
    Y_CM,
    Z_CM,
)

Floats = NDArray[np.float64]

# No substep is longer than this [s].
LONGEST_SUBSTEP = 0.0101
# Motion of so long ago is forgotten [s]: a longer step counts as one of this length, and so does the
# first, before which the vehicle has been moving at its track speeds.
SETTLING = 2.0
NEWTON_ITERATIONS, LINE_SEARCHES = 30, 10
# Newton's iteration ends with a step below this [m/s, rad/s].
SETTLED = 1e-7
# A Newton step that overshoots the minimum along its way is shortened, unless the slope there is below
# this share of what it was.
OVERSHOOT = 0.5
# Step of the central difference by the contact length, as a share of it.
DIFFERENCE = 1e-5
# Slower turns show no indices [rad/s]; those of turns are averaged over some time [s].
TURNS, AVERAGING = 0.1, 0.5
LARGEST_ETA = 20.0


@compiled
def with_parameters(ground: Ground, nominal: Floats, parameters: Floats) -> Ground:
    """The contact at other parameters than the nominal ones, each (PARAMETERS,)."""
    stretch = parameters[LENGTH] / nominal[LENGTH]
    even = ground.even.copy()
    for k in range(3):
        even[2, k] /= stretch
        even[k, 2] /= stretch
    half, rear, front = ground.outline
    return Ground(
        ground.x,
        ground.y * stretch,
        ground.share,
        even,
        ground.half_gauge,
        (half, rear * stretch, front * stretch),
        ground.friction * (parameters[FRICTION] / nominal[FRICTION]),
        np.full(2, parameters[ROLLING]),
        ground.shear_modulus,
        ground.small,
        ground.opposes_travel,
        ground.mass,
        ground.weight,
        (parameters[X_CM], parameters[Y_CM], parameters[Z_CM]),
    )


@compiled
def step_motion(
    ground: Ground,
    nominal: Floats,
    yaw_inertia: float,
    load_lag: float,
    estimated: Floats,
    parameters: Floats,
    V_l: float,
    V_r: float,
    dt: float,
    memory: Floats,
) -> None:
    """Move on by a step, with constant track speeds; the first one settles from rest instead.

    Args:
        ground: the contact at the nominal parameters.
        nominal: (PARAMETERS,).
        yaw_inertia: about the vertical through the centre of mass [kg m²].
        load_lag: T [s].
        estimated: (PARAMETERS,) not zero where derivatives are wanted.
        parameters: (PARAMETERS,) or more, as they are known now.
        V_l: speed of the left track [m/s].
        V_r: speed of the right track [m/s].
        dt: [s].
        memory: see `estimator.friction_motion`; overwritten.
    """
    y = memory[OF_STATES]
    S = memory[OF_SENSITIVITIES].reshape(STATES, PARAMETERS)
    B = memory[OF_SPEEDS].reshape(3, 2)
    at = memory[AT_PARAMETERS]
    # What was learnt since the last step changes where it led to.
    for k in range(PARAMETERS):
        change = parameters[k] - at[k]
        at[k] = parameters[k]
        for row in range(STATES):
            y[row] += S[row, k] * change
    memory[AT_SPEEDS][0], memory[AT_SPEEDS][1] = V_l, V_r
    if memory[STARTED] == 0.0:
        dt = SETTLING
        memory[STARTED] = 1.0
    dt = min(dt, SETTLING)
    substeps = int(max(1.0, np.ceil(dt / LONGEST_SUBSTEP)))
    h = dt / substeps
    here = with_parameters(ground, nominal, at)
    by_speeds = np.zeros((STATES, 2))
    workspace = np.empty((6, len(ground.x)))
    jacobian = np.empty((3, COLUMNS))
    for _ in range(substeps):
        _substep(
            ground, nominal, here, yaw_inertia, load_lag, estimated, V_l, V_r, h, y, S, by_speeds,
            workspace, jacobian,
        )  # fmt: skip
    B[:] = by_speeds[:3]
    w, turn = y[2], memory[TURN]
    if abs(w) > TURNS:
        share = 1.0 - np.exp(-dt / AVERAGING)
        eta = (V_r - V_l) / (2.0 * ground.half_gauge * w)
        turn[0] += share * (y[0] / w - turn[0])
        turn[1] += share * ((0.5 * (V_l + V_r) - y[1]) / w - turn[1])
        turn[2] += share * (min(LARGEST_ETA, max(1.0, eta)) - turn[2])


@compiled
def _substep(
    ground: Ground,
    nominal: Floats,
    here: Ground,
    yaw_inertia: float,
    load_lag: float,
    estimated: Floats,
    V_l: float,
    V_r: float,
    h: float,
    y: Floats,
    S: Floats,
    by_speeds: Floats,
    workspace: Floats,
    jacobian: Floats,
) -> None:
    """One step of the scheme: states (5,), their derivatives (5, 6) and those by the speeds (5, 2)."""
    M = here.mass
    x_CM, y_CM, _ = here.centre
    mass = _mass_matrix(here, yaw_inertia)
    loads, by_right, by_forward = workspace[0], workspace[1], workspace[2]
    start, v, values = y.copy(), y[:3].copy(), np.empty(3)
    point_loads(here, y[3], y[4], loads, by_right, by_forward)
    v_x, v_y, w = start[0], start[1], start[2]
    right, forward = M * w * (v_y + x_CM * w), M * w * (y_CM * w - v_x)
    inertia = np.array([right, forward, x_CM * forward - y_CM * right])
    _minimise(
        here, mass, inertia, V_l, V_r, h, start, loads, by_right, by_forward, v, values, jacobian
    )
    keep = np.exp(-h / load_lag)
    matrix = mass - h * jacobian[:, :3]

    # By the parameters: of the forces at this motion, and of the inertia, mass and motion before.
    by_parameter = np.zeros((3, PARAMETERS))
    _forces_by_parameter(
        ground, nominal, here, estimated, V_l, V_r, start, v, values, jacobian, workspace,
        by_parameter,
    )  # fmt: skip
    side, rise = np.empty(3), np.empty(3)
    d_x, d_y, d_w = v[0] - v_x, v[1] - v_y, v[2] - w
    for k in range(PARAMETERS):
        if estimated[k] == 0.0:
            continue
        s_x, s_y, s_w = S[0, k], S[1, k], S[2, k]
        i_right = M * (s_w * (v_y + 2.0 * x_CM * w) + w * s_y)
        i_forward = M * (s_w * (2.0 * y_CM * w - v_x) - w * s_x)
        i_moment = x_CM * i_forward - y_CM * i_right
        m_x = m_y = m_w = 0.0
        if k == X_CM:
            i_right += M * w * w
            i_moment += forward - y_CM * M * w * w
            m_y, m_w = M * d_w, M * (d_y + 2.0 * x_CM * d_w)
        elif k == Y_CM:
            i_forward += M * w * w
            i_moment += x_CM * M * w * w - right
            m_x, m_w = -M * d_w, M * (2.0 * y_CM * d_w - d_x)
        for row in range(3):
            moved = mass[row, 0] * s_x + mass[row, 1] * s_y + mass[row, 2] * s_w
            by_loads = jacobian[row, 5] * S[3, k] + jacobian[row, 6] * S[4, k]
            by_parameter[row, k] += by_loads
            side[row] = moved + h * by_parameter[row, k]
        side[0] += h * i_right - m_x
        side[1] += h * i_forward - m_y
        side[2] += h * i_moment - m_w
        solve_3(matrix, side, rise)
        for row in range(3):
            S[row, k] = rise[row]
        for row in range(2):
            by_v = (
                jacobian[row, 0] * rise[0] + jacobian[row, 1] * rise[1] + jacobian[row, 2] * rise[2]
            )
            S[3 + row, k] = keep * S[3 + row, k] - (1.0 - keep) * (by_v + by_parameter[row, k])

    for track in range(2):
        b_x, b_y, b_w = by_speeds[0, track], by_speeds[1, track], by_speeds[2, track]
        i_right = M * (b_w * (v_y + 2.0 * x_CM * w) + w * b_y)
        i_forward = M * (b_w * (2.0 * y_CM * w - v_x) - w * b_x)
        explicit = np.empty(3)
        for row in range(3):
            explicit[row] = (
                jacobian[row, 3 + track]
                + jacobian[row, 5] * by_speeds[3, track]
                + jacobian[row, 6] * by_speeds[4, track]
            )
            moved = mass[row, 0] * b_x + mass[row, 1] * b_y + mass[row, 2] * b_w
            side[row] = moved + h * explicit[row]
        side[0] += h * i_right
        side[1] += h * i_forward
        side[2] += h * (x_CM * i_forward - y_CM * i_right)
        solve_3(matrix, side, rise)
        for row in range(3):
            by_speeds[row, track] = rise[row]
        for row in range(2):
            by_v = (
                jacobian[row, 0] * rise[0] + jacobian[row, 1] * rise[1] + jacobian[row, 2] * rise[2]
            )
            by_speeds[3 + row, track] = keep * by_speeds[3 + row, track] - (1.0 - keep) * (
                by_v + explicit[row]
            )

    y[:3] = v
    for row in range(2):
        y[3 + row] = keep * start[3 + row] - (1.0 - keep) * values[row]


@compiled
def _minimise(
    ground: Ground,
    mass: Floats,
    inertia: Floats,
    V_l: float,
    V_r: float,
    h: float,
    start: Floats,
    loads: Floats,
    by_right: Floats,
    by_forward: Floats,
    v: Floats,
    values: Floats,
    jacobian: Floats,
) -> None:
    """Bring v (3,), a twist to begin at, to that after a step, with the forces (3,) and their slopes."""
    gradient, move, trial = np.empty(3), np.empty(3), np.empty(3)
    _gradient(
        ground, mass, inertia, V_l, V_r, h, start, loads, by_right, by_forward, v, values, jacobian,
        gradient,
    )  # fmt: skip
    for _ in range(NEWTON_ITERATIONS):
        solve_3(mass - h * jacobian[:, :3], gradient, move)
        slope = -(gradient[0] * move[0] + gradient[1] * move[1] + gradient[2] * move[2])
        size = max(abs(move[0]), abs(move[1]), abs(move[2]))
        share = 1.0
        for _ in range(LINE_SEARCHES):
            for row in range(3):
                trial[row] = v[row] - share * move[row]
            _gradient(
                ground, mass, inertia, V_l, V_r, h, start, loads, by_right, by_forward, trial,
                values, jacobian, gradient,
            )  # fmt: skip
            there = -(gradient[0] * move[0] + gradient[1] * move[1] + gradient[2] * move[2])
            if there <= -OVERSHOOT * slope or size < SETTLED:
                break
            share *= max(0.1, slope / (slope - there))
        v[:] = trial
        if share * size < SETTLED:
            break


@compiled
def _gradient(
    ground: Ground,
    mass: Floats,
    inertia: Floats,
    V_l: float,
    V_r: float,
    h: float,
    start: Floats,
    loads: Floats,
    by_right: Floats,
    by_forward: Floats,
    v: Floats,
    values: Floats,
    jacobian: Floats,
    gradient: Floats,
) -> None:
    """What a twist v lacks of balance (3,): A (v - v_start) - h (F + I); also F and its Jacobian."""
    values[:] = 0.0
    jacobian[:] = 0.0
    add_track_forces(
        ground, v[0], v[1], v[2], V_l, V_r, loads, by_right, by_forward, values, jacobian
    )
    for row in range(3):
        total = -h * (values[row] + inertia[row])
        for column in range(3):
            total += mass[row, column] * (v[column] - start[column])
        gradient[row] = total


@compiled
def _forces_by_parameter(
    ground: Ground,
    nominal: Floats,
    here: Ground,
    estimated: Floats,
    V_l: float,
    V_r: float,
    start: Floats,
    v: Floats,
    values: Floats,
    jacobian: Floats,
    workspace: Floats,
    by_parameter: Floats,
) -> None:
    """Derivatives (3, PARAMETERS) of the ground's forces at given twist, track speeds and q.

    Forces are linear in friction, in rolling resistance and in the loads, which the centre of mass acts
    through; only the contact's length needs a difference.
    """
    z_CM = here.centre[2]
    at = np.empty(PARAMETERS)
    at[FRICTION] = nominal[FRICTION] * here.friction[0, 0] / ground.friction[0, 0]
    at[ROLLING] = here.rolling_resistance[0]
    at[LENGTH] = nominal[LENGTH] * here.outline[2] / ground.outline[2]
    at[X_CM], at[Y_CM], at[Z_CM] = here.centre
    loads, by_right, by_forward = workspace[3], workspace[4], workspace[5]
    other, slopes = np.zeros(3), np.zeros((3, COLUMNS))
    if estimated[FRICTION] != 0.0 or estimated[ROLLING] != 0.0:
        more = at.copy()
        more[ROLLING] += 1.0
        add_track_forces(
            with_parameters(ground, nominal, more), v[0], v[1], v[2], V_l, V_r, workspace[0],
            workspace[1], workspace[2], other, slopes,
        )  # fmt: skip
        for row in range(3):
            rolling = other[row] - values[row]
            by_parameter[row, ROLLING] = rolling
            by_parameter[row, FRICTION] = (values[row] - at[ROLLING] * rolling) / at[FRICTION]
    for row in range(3):
        by_parameter[row, X_CM] = jacobian[row, 5] * here.weight / z_CM
        by_parameter[row, Y_CM] = jacobian[row, 6] * here.weight / z_CM
        by_parameter[row, Z_CM] = (jacobian[row, 5] * start[3] + jacobian[row, 6] * start[4]) / z_CM
    if estimated[LENGTH] != 0.0:
        step = DIFFERENCE * nominal[LENGTH]
        for sign in (1.0, -1.0):
            moved = at.copy()
            moved[LENGTH] += sign * step
            there = with_parameters(ground, nominal, moved)
            point_loads(there, start[3], start[4], loads, by_right, by_forward)
            other[:] = 0.0
            add_track_forces(
                there, v[0], v[1], v[2], V_l, V_r, loads, by_right, by_forward, other, slopes
            )
            for row in range(3):
                by_parameter[row, LENGTH] += 0.5 * sign * other[row] / step


@compiled
def _mass_matrix(ground: Ground, yaw_inertia: float) -> Floats:
    """Mass matrix (3, 3) about the origin."""
    M = ground.mass
    x, y, _ = ground.centre
    matrix = np.zeros((3, 3))
    matrix[0, 0] = matrix[1, 1] = M
    matrix[0, 2] = matrix[2, 0] = -M * y
    matrix[1, 2] = matrix[2, 1] = M * x
    matrix[2, 2] = yaw_inertia + M * (x * x + y * y)
    return matrix
