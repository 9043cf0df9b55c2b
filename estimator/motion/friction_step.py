"""Step of the friction motion model and of its derivatives, compiled.

The body's twist v about the origin follows the tracks by the forces of
`estimator.motion.contact_forces`. A step of h seconds is implicit in the stiff part, friction, and
explicit in the slow parts, the loads and the force of inertia I:

    A (v' - v) = h (F(v', V, loads(q)) + I(v))
    q' = k q - (1 - k) F(v', V, loads(q)),  k = exp(-h / T)

A is the mass matrix about the origin, V are the track speeds and q the force at the centre of mass that
transfers load, with the lag T of a body that rolls and pitches on its suspension. At given loads friction
has a potential, so v' is the minimum of a convex function, which Newton's iteration with a line search
finds from any start. The friction's regularising speed is that of `FrictionMotion`, well above that of
the soil.

The derivatives of v and q by the parameters are integrated, too (forward sensitivities, from the implicit
function theorem at each step), and those of v by the track speeds of the step alone.

Symbols and axes are the paper's. Import this module inside functions only: numba takes half a second to
load.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.motion.contact_forces import (
    COLUMNS,
    Ground,
    PointLoads,
    add_track_forces,
    mass_matrix,
    point_loads,
    solve_3,
)
from icreckon.estimator.motion.friction_layout import (
    AT_PARAMETERS,
    AT_SPEEDS,
    FRICTION,
    LENGTH,
    MEMORY,
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
from icreckon.estimator.tracing.jit_kernel import compiled

# Longest substep [s].
LONGEST_SUBSTEP = 0.0101
# Time after which earlier motion has no effect [s]: a longer step counts as one of this length, and so
# does the first, before which the vehicle has been moving at its track speeds.
SETTLING = 2.0
NEWTON_ITERATIONS, LINE_SEARCHES = 30, 10
# Newton's iteration ends with a step below this [m/s, rad/s].
SETTLED = 1e-7
# A Newton step that overshoots the minimum is shortened, unless its slope there is below this share of
# the initial slope.
OVERSHOOT = 0.5
# Step of the central difference by the contact length, as a share of it.
DIFFERENCE = 1e-5
# Slower turns do not determine indices [rad/s]; indices of turns are averaged over this time [s].
TURNS, AVERAGING = 0.1, 0.5
LARGEST_ETA = 20.0


class FrictionConstants(NamedTuple):
    """Constants of the friction model.

    Attributes:
        ground: the contact at the nominal parameters.
        nominal: (PARAMETERS,) nominal parameters.
        yaw_inertia: moment of inertia about the vertical through the centre of mass [kg m²].
        load_lag: T [s].
        estimated: (PARAMETERS,) not zero for parameters with derivatives.
    """

    ground: Ground
    nominal: Floats
    yaw_inertia: float
    load_lag: float
    estimated: Floats


# Numbers before the arrays of the points in packed constants.
PACKED = 43


def packed(constants: FrictionConstants) -> Floats:
    """Pack the constants into one array (PACKED + 3 m,), which numba unboxes quickly."""
    ground, nominal, yaw_inertia, load_lag, estimated = constants
    numbers = [
        *(yaw_inertia, load_lag, ground.half_gauge, *ground.outline, ground.shear_modulus),
        *(ground.small, ground.opposes_travel, ground.mass, ground.weight, *ground.centre),
        *(*ground.rolling_resistance, 0.0, *ground.friction.ravel(), *ground.even.ravel()),
        *(*nominal, *estimated),
    ]
    points = ground.x, ground.y, ground.share
    return np.concatenate([numbers, np.zeros(PACKED - len(numbers)), *points])


@compiled
def unpacked(numbers: Floats) -> FrictionConstants:
    """Constants of a packed array.

    Raises:
        ValueError: the array has the wrong size.
    """
    m = (len(numbers) - PACKED) // 3
    if m < 1 or len(numbers) != PACKED + 3 * m:
        raise ValueError(WRONG_SIZE)
    n = numbers
    ground = Ground(
        n[PACKED : PACKED + m],
        n[PACKED + m : PACKED + 2 * m],
        n[PACKED + 2 * m :],
        n[21:30].reshape(3, 3),
        n[2],
        (n[3], n[4], n[5]),
        n[17:21].reshape(2, 2),
        n[14:16],
        n[6],
        n[7],
        n[8] != 0.0,
        n[9],
        n[10],
        (n[11], n[12], n[13]),
    )
    return FrictionConstants(ground, n[30:36], n[0], n[1], n[36:42])


@compiled
def step_packed(
    numbers: Floats, parameters: Floats, V_l: float, V_r: float, dt: float, memory: Floats
) -> None:
    """Integrate one step by `step_motion`, with packed constants."""
    step_motion(unpacked(numbers), parameters, V_l, V_r, dt, memory)


@compiled
def with_parameters(ground: Ground, nominal: Floats, parameters: Floats) -> Ground:
    """Contact at given parameters instead of the nominal ones, each (PARAMETERS,)."""
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
    constants: FrictionConstants,
    parameters: Floats,
    V_l: float,
    V_r: float,
    dt: float,
    memory: Floats,
) -> None:
    """Integrate one step at constant track speeds; the first one settles from rest.

    Args:
        constants: vehicle and contact.
        parameters: (PARAMETERS,) or more, the present estimate.
        V_l: speed of the left track [m/s].
        V_r: speed of the right track [m/s].
        dt: length of the step [s].
        memory: see `estimator.motion.friction_model`; overwritten.

    Raises:
        ValueError: an array has the wrong size.
    """
    ground, nominal, yaw_inertia, _, estimated = constants
    sizes_fit = memory.shape == (MEMORY,) and nominal.shape == estimated.shape == (PARAMETERS,)
    if not sizes_fit or len(parameters) < PARAMETERS:
        raise ValueError(WRONG_SIZE)
    y = memory[OF_STATES]
    S = memory[OF_SENSITIVITIES].reshape(STATES, PARAMETERS)
    B = memory[OF_SPEEDS].reshape(3, 2)
    at = memory[AT_PARAMETERS]
    # Parameter updates since the last step change its final state.
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
    mass = mass_matrix(here.mass, here.centre[0], here.centre[1], yaw_inertia)
    state = FrictionState(y, S, np.zeros((STATES, 2)))
    workspace = np.empty((6, len(ground.x)))
    for _ in range(substeps):
        _substep(constants, at, here, mass, (V_l, V_r), h, state, workspace)
    B[:] = state.by_speeds[:3]
    w, turn = y[2], memory[TURN]
    if abs(w) > TURNS:
        share = 1.0 - np.exp(-dt / AVERAGING)
        eta = (V_r - V_l) / (2.0 * ground.half_gauge * w)
        turn[0] += share * (y[0] / w - turn[0])
        turn[1] += share * ((0.5 * (V_l + V_r) - y[1]) / w - turn[1])
        turn[2] += share * (min(LARGEST_ETA, max(1.0, eta)) - turn[2])


class FrictionState(NamedTuple):
    """State of the friction model with its derivatives.

    Attributes:
        y: (STATES,) the state.
        by_parameters: (STATES, PARAMETERS) its derivatives by the parameters.
        by_speeds: (STATES, 2) its derivatives by the track speeds of the step.
    """

    y: Floats
    by_parameters: Floats
    by_speeds: Floats


class Substep(NamedTuple):
    """Inputs of a substep.

    Attributes:
        ground: the contact at the present parameters.
        mass: (3, 3) mass matrix A.
        V: speeds of the left and the right track [m/s].
        h: length of the substep [s].
        start: (STATES,) state at the start.
        inertia: (3,) force of inertia I at the start.
        pressing: loads of the contact points at the start.
    """

    ground: Ground
    mass: Floats
    V: tuple[float, float]
    h: float
    start: Floats
    inertia: Floats
    pressing: PointLoads


class TrackForces(NamedTuple):
    """The ground's forces at the end of a substep.

    Attributes:
        values: (3,) force and moment F.
        jacobian: (3, COLUMNS) their derivatives.
        matrix: (3, 3) A - h dF/dv.
    """

    values: Floats
    jacobian: Floats
    matrix: Floats


@compiled
def _substep(
    constants: FrictionConstants,
    parameters: Floats,
    here: Ground,
    mass: Floats,
    V: tuple[float, float],
    h: float,
    state: FrictionState,
    workspace: Floats,
) -> None:
    """Integrate a substep, in place."""
    M, y = here.mass, state.y
    x_CM, y_CM, _ = here.centre
    start, v = y.copy(), y[:3].copy()
    values, jacobian = np.empty(3), np.empty((3, COLUMNS))
    pressing = PointLoads(workspace[0], workspace[1], workspace[2])
    point_loads(here, y[3], y[4], pressing.loads, pressing.by_right, pressing.by_forward)
    v_x, v_y, w = start[0], start[1], start[2]
    right, forward = M * w * (v_y + x_CM * w), M * w * (y_CM * w - v_x)
    inertia = np.array([right, forward, x_CM * forward - y_CM * right])
    step = Substep(here, mass, V, h, start, inertia, pressing)
    _minimise(step, v, values, jacobian)
    keep = np.exp(-h / constants.load_lag)
    forces = TrackForces(values, jacobian, mass - h * jacobian[:, :3])

    by_parameter = np.zeros((3, PARAMETERS))
    _forces_by_parameter(constants, parameters, step, v, forces, workspace, by_parameter)
    d_x, d_y, d_w = v[0] - v_x, v[1] - v_y, v[2] - w
    direct, scratch = np.empty(3), np.empty((3, 3))
    for k in range(PARAMETERS):
        if constants.estimated[k] == 0.0:
            continue
        # The force of inertia and the change of momentum by the centre of mass.
        direct[:] = 0.0
        if k == X_CM:
            direct[0] = h * M * w * w
            direct[1] = -M * d_w
            direct[2] = h * (forward - y_CM * M * w * w) - M * (d_y + 2.0 * x_CM * d_w)
        elif k == Y_CM:
            direct[0] = M * d_w
            direct[1] = h * M * w * w
            direct[2] = h * (x_CM * M * w * w - right) - M * (2.0 * y_CM * d_w - d_x)
        slopes = state.by_parameters[:, k]
        _differentiate(step, keep, forces, by_parameter[:, k], direct, slopes, scratch)
    direct[:] = 0.0
    for track in range(2):
        of_track, slopes = jacobian[:, 3 + track], state.by_speeds[:, track]
        _differentiate(step, keep, forces, of_track, direct, slopes, scratch)

    y[:3] = v
    for row in range(2):
        y[3 + row] = keep * start[3 + row] - (1.0 - keep) * values[row]


@compiled
def _differentiate(
    step: Substep,
    keep: float,
    forces: TrackForces,
    by_force: Floats,
    direct: Floats,
    slopes: Floats,
    scratch: Floats,
) -> None:
    """Propagate derivatives of the states by one quantity over a substep.

    Args:
        step: inputs of the substep.
        keep: k.
        forces: forces at the end.
        by_force: (3,) derivative of the forces by the quantity at given twist and loads.
        direct: (3,) derivative of h I - A (v' - v) by it at given twists.
        slopes: (5,) overwritten.
        scratch: (3, 3) overwritten.
    """
    M, h, mass, jacobian = step.ground.mass, step.h, step.mass, forces.jacobian
    x_CM, y_CM, _ = step.ground.centre
    v_x, v_y, w = step.start[0], step.start[1], step.start[2]
    s_x, s_y, s_w = slopes[0], slopes[1], slopes[2]
    right = M * (s_w * (v_y + 2.0 * x_CM * w) + w * s_y)
    forward = M * (s_w * (2.0 * y_CM * w - v_x) - w * s_x)
    inertia = (right, forward, x_CM * forward - y_CM * right)
    explicit, side, rise = scratch[0], scratch[1], scratch[2]
    for row in range(3):
        explicit[row] = by_force[row] + jacobian[row, 5] * slopes[3] + jacobian[row, 6] * slopes[4]
        side[row] = h * (explicit[row] + inertia[row]) + direct[row]
        for column in range(3):
            side[row] += mass[row, column] * slopes[column]
    solve_3(forces.matrix, side, rise)
    for row in range(3):
        slopes[row] = rise[row]
    for row in range(2):
        total = explicit[row]
        for column in range(3):
            total += jacobian[row, column] * rise[column]
        slopes[3 + row] = keep * slopes[3 + row] - (1.0 - keep) * total


@compiled
def _minimise(step: Substep, v: Floats, values: Floats, jacobian: Floats) -> None:
    """Find the twist v (3,) after a step from an initial guess, in place.

    `values` (3,) and `jacobian` are overwritten with the forces and their derivatives.
    """
    gradient, move, trial = np.empty(3), np.empty(3), np.empty(3)
    _gradient(step, v, values, jacobian, gradient)
    for _ in range(NEWTON_ITERATIONS):
        solve_3(step.mass - step.h * jacobian[:, :3], gradient, move)
        slope = -(gradient[0] * move[0] + gradient[1] * move[1] + gradient[2] * move[2])
        size = max(abs(move[0]), abs(move[1]), abs(move[2]))
        share = 1.0
        for _ in range(LINE_SEARCHES):
            for row in range(3):
                trial[row] = v[row] - share * move[row]
            _gradient(step, trial, values, jacobian, gradient)
            there = -(gradient[0] * move[0] + gradient[1] * move[1] + gradient[2] * move[2])
            if there <= -OVERSHOOT * slope or size < SETTLED:
                break
            share *= max(0.1, slope / (slope - there))
        v[:] = trial
        if share * size < SETTLED:
            break


@compiled
def _gradient(step: Substep, v: Floats, values: Floats, jacobian: Floats, gradient: Floats) -> None:
    """Residual (3,) A (v - v_start) - h (F + I) of a twist v; F and its Jacobian, too."""
    values[:] = 0.0
    jacobian[:] = 0.0
    add_track_forces(step.ground, (v[0], v[1], v[2]), step.V, step.pressing, values, jacobian)
    for row in range(3):
        total = -step.h * (values[row] + step.inertia[row])
        for column in range(3):
            total += step.mass[row, column] * (v[column] - step.start[column])
        gradient[row] = total


@compiled
def _forces_by_parameter(
    constants: FrictionConstants,
    at: Floats,
    step: Substep,
    v: Floats,
    forces: TrackForces,
    workspace: Floats,
    by_parameter: Floats,
) -> None:
    """Derivatives (3, PARAMETERS) of the ground's forces at fixed twist, speeds and q.

    Forces are linear in friction, in rolling resistance and in the loads, through which the centre of
    mass acts; only the contact's length needs a finite difference.
    """
    ground, nominal, _, _, estimated = constants
    values, jacobian, start = forces.values, forces.jacobian, step.start
    weight, z_CM, twist = step.ground.weight, at[Z_CM], (v[0], v[1], v[2])
    other, slopes = np.zeros(3), np.zeros((3, COLUMNS))
    if estimated[FRICTION] != 0.0 or estimated[ROLLING] != 0.0:
        more = at.copy()
        more[ROLLING] += 1.0
        there = with_parameters(ground, nominal, more)
        add_track_forces(there, twist, step.V, step.pressing, other, slopes)
        for row in range(3):
            rolling = other[row] - values[row]
            by_parameter[row, ROLLING] = rolling
            by_parameter[row, FRICTION] = (values[row] - at[ROLLING] * rolling) / at[FRICTION]
    for row in range(3):
        by_parameter[row, X_CM] = jacobian[row, 5] * weight / z_CM
        by_parameter[row, Y_CM] = jacobian[row, 6] * weight / z_CM
        by_parameter[row, Z_CM] = (jacobian[row, 5] * start[3] + jacobian[row, 6] * start[4]) / z_CM
    if estimated[LENGTH] != 0.0:
        pressing = PointLoads(workspace[3], workspace[4], workspace[5])
        difference = DIFFERENCE * nominal[LENGTH]
        for sign in (1.0, -1.0):
            moved = at.copy()
            moved[LENGTH] += sign * difference
            there = with_parameters(ground, nominal, moved)
            point_loads(
                there, start[3], start[4], pressing.loads, pressing.by_right, pressing.by_forward
            )
            other[:] = 0.0
            add_track_forces(there, twist, step.V, pressing, other, slopes)
            for row in range(3):
                by_parameter[row, LENGTH] += 0.5 * sign * other[row] / difference
