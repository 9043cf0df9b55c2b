"""Equations of motion of a vehicle on its tracks, and their integration, compiled.

The state is v_x, v_y, w of the origin in the paper's axes, the force q at the centre of mass that
transfers load (right, forward), and yaw:

    A d(v_x, v_y, w)/dt = forces of the ground + force of inertia in steady motion + pull of the slope
    T dq/dt = -(forces of the ground) - q        d(yaw)/dt = w

A is the mass matrix about the origin. Loads are transferred with a short lag T, as a vehicle on its
suspension rolls and pitches. In the steady state of q they are those of d'Alembert's force. Friction
grows from nothing to its full size within the regularising speed (0.1 mm/s), which makes this very stiff:
near zero slip, velocities settle within microseconds, elsewhere within tens of milliseconds.

The integrator is RODAS, a Rosenbrock method of order 4(3) with six stages, L-stable and stiffly accurate.
RODAS has full order for differential-algebraic equations, which very stiff friction approaches (Hairer
and Wanner, Solving Ordinary Differential Equations II, section IV.7 and VI.4). It uses the analytic
Jacobian, needs no inner iteration, and controls its step by the embedded third-order solution.

Import this module inside functions only: numba takes half a second to load.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import WRONG_SIZE
from icreckon.estimator.tracing.jit_kernel import compiled
from icreckon.simulation.contact.contact_forces import (
    COLUMNS,
    Ground,
    PointLoads,
    add_track_forces,
    point_loads,
)
from icreckon.simulation.truth.surface_kernel import TrackGround, gravity_on, look_up, ride, tilt
from icreckon.simulation.truth.terrain import PATCH_WIDTH, Surface

SIZE = 6
FORCE_RIGHT, FORCE_FORWARD, YAW = 3, 4, 5  # places in the state after those of v_x, v_y, w
STAGES = 6
# Coefficients of RODAS, in the form without products with the Jacobian.
GAMMA = 0.25
A = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [1.544, 0.0, 0.0, 0.0, 0.0],
        [0.9466785280815826, 0.2557011698983284, 0.0, 0.0, 0.0],
        [3.314825187068521, 2.896124015972201, 0.9986419139977817, 0.0, 0.0],
        [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 0.0],
        [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0],
    ]
)
C = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [-5.6688, 0.0, 0.0, 0.0, 0.0],
        [-2.430093356833875, -0.2063599157091915, 0.0, 0.0, 0.0],
        [-0.1073529058151375, -9.594562251023355, -20.47028614809616, 0.0, 0.0],
        [7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160, 0.0],
        [
            8.083246795921522,
            -7.981132988064893,
            -31.52159432874371,
            16.31930543123136,
            -6.058818238834054,
        ],
    ]
)
STAGE_TIMES = np.array([0.0, 0.386, 0.21, 0.63, 1.0, 1.0])
TIME_GAMMAS = np.array([0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0])
# Step control: safety, and how much a step may shrink or grow.
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0
SMALLEST_STEP = 1e-10


class Vehicle(NamedTuple):
    """Constants of the moving vehicle."""

    ground: Ground  # its friction and rolling resistance (arrays) are overwritten in each step
    inverse_mass: Floats  # (3, 3) inverse of the mass matrix about the origin
    load_lag: float  # time constant T of the load transfer [s]


class TrackForces(NamedTuple):
    """Forces of the ground on the tracks, overwritten by `_rates`."""

    loads: PointLoads  # loads of the contact points
    values: Floats  # (3,) force and moment on the vehicle [N, N, N m]
    jacobian: Floats  # (3, COLUMNS) their derivatives


class DrivenTracks(NamedTuple):
    """Track speeds on an even grid of time; cubic between the grid points."""

    start: float  # time of the first grid point [s]
    step: float  # time between grid points [s]
    speeds: Floats  # (n, 2) speeds of the left and the right track [m/s]
    rates: Floats  # (n, 2) their derivatives [m/s²]


class GridMotion(NamedTuple):
    """Motion at the grid points."""

    # (3,) x, y [m], heading [rad] in odom at the newest grid point; without terrain the heading is that
    # of the state
    pose: Floats
    states: Floats  # (n, 6) states
    # (n, 2) acceleration of gravity along the ground [m/s²], in odom; on terrain, in axes that turn
    # with the ground's normal, but not by the state's yaw
    slopes: Floats
    tipping: NDArray[np.bool_]  # (n,) True if the vehicle tips there
    # (n, 3) slip residual of v_x, v_y [m/s], w [rad/s] in base_link's axes, which moves the vehicle on
    # terrain
    slip: Floats


@compiled
def integrate(
    vehicle: Vehicle,
    surface: Surface,
    patches: Floats,
    tracks: DrivenTracks,
    tolerance: float,
    scales: Floats,
    motion: GridMotion,
) -> int:
    """Integrate from grid point to grid point; the ground is looked up at each one.

    Of `motion`, the slip and the first pose and state are inputs. The rest is overwritten, except for the
    last value of `tipping`; the pose with the last one. `patches` (k, PATCH_WIDTH) are those of
    `icreckon.simulation.truth.surface_kernel`. The error allowed per step is the tolerance [-] of the
    state, and of `scales` (6,) in its units.

    Returns:
        Index of the last grid point that was reached; beyond, the step became too small.

    Raises:
        ValueError: an array has the wrong size.
    """
    start, step, speeds, speed_rates = tracks
    pose, states, slopes, tipping, slip = motion
    n = len(speeds)
    sizes_fit = speeds.shape == speed_rates.shape == slopes.shape == (n, 2)
    sizes_fit &= states.shape == (n, SIZE) and tipping.shape == (n,) and pose.shape == (3,)
    sizes_fit &= slip.shape == (n, 3)
    if not sizes_fit or patches.shape[1] != PATCH_WIDTH or scales.shape != (SIZE,):
        raise ValueError(WRONG_SIZE)
    ground, points = vehicle.ground, len(vehicle.ground.x)
    loads = PointLoads(np.empty(points), np.empty(points), np.empty(points))
    forces = TrackForces(loads, np.empty(3), np.empty((3, COLUMNS)))
    # Rate of the state, its derivatives by time and by the state; linear system of all stages.
    rate, by_time, by_state = np.empty(SIZE), np.empty(SIZE), np.empty((SIZE, SIZE))
    matrix, pivots = np.empty((SIZE, SIZE)), np.empty(SIZE, dtype=np.int64)
    stages, trial = np.empty((STAGES, SIZE)), np.empty(SIZE)
    outside_patches = TrackGround(ground.friction.copy(), ground.rolling_resistance.copy())
    h = step  # length of the next step [s]
    for k in range(n):
        time = start + k * step
        _find_ground(
            ground, surface, patches, outside_patches, time, states[k, YAW], pose, slopes[k]
        )
        if k + 1 == n:
            break
        weight = _weight_on_slope(ground, slopes[k])
        y = states[k + 1]
        # Row by row: numba compiles a copy of a whole array for seconds.
        for row in range(SIZE):
            y[row] = states[k, row]
        done = 0.0  # share of the way to the next grid point [-]
        while done < 1.0:
            rest = (1.0 - done) * step
            # A step that nearly reaches the next grid point reaches it.
            if h > 0.999 * (1.0 - done) * step:
                h = rest
            # The stages, not in a function of their own, which would take 1.5 times as long.
            for stage in range(STAGES):
                for row in range(SIZE):
                    trial[row] = y[row]
                    for before in range(stage):
                        trial[row] += A[stage, before] * stages[before, row]
                share = done + STAGE_TIMES[stage] * h / step
                left, left_rate = _speed_at(speeds, speed_rates, k, 0, step, share)
                right, right_rate = _speed_at(speeds, speed_rates, k, 1, step, share)
                tips = _rates(vehicle, weight, slopes[k], trial, (left, right), forces, rate)
                if stage == 0:
                    if done == 0.0:
                        tipping[k] = tips
                    speed_rate, jacobian = (left_rate, right_rate), forces.jacobian
                    _rate_derivatives(
                        vehicle, slopes[k], y, speed_rate, jacobian, by_state, by_time
                    )
                    for row in range(SIZE):
                        for column in range(SIZE):
                            matrix[row, column] = -by_state[row, column]
                        matrix[row, row] += 1.0 / (GAMMA * h)
                    _factor(matrix, pivots)
                for row in range(SIZE):
                    total = rate[row] + h * TIME_GAMMAS[stage] * by_time[row]
                    for before in range(stage):
                        total += C[stage, before] / h * stages[before, row]
                    stages[stage, row] = total
                _substitute(matrix, pivots, stages[stage])
            # The last stage is the difference from the embedded solution.
            for row in range(SIZE):
                trial[row] += stages[STAGES - 1, row]
            error = _step_error(y, trial, stages[STAGES - 1], tolerance, scales)
            h_tried, h = h, _next_step(h, error)
            if error <= 1.0:
                for row in range(SIZE):
                    y[row] = trial[row]
                done += h_tried / step
                if 1.0 - done < 1e-12:
                    done = 1.0
            elif h < SMALLEST_STEP:
                return k
        if surface.present:
            moved = _displacement(states[k], y, slip[k], slip[k + 1], step)
            times, place = (time, time + step), (pose[0], pose[1], pose[2])
            pose[0], pose[1], pose[2], _ = ride(surface, patches, times, place, moved)
        else:
            _advance(pose, states[k], y, step)
    return n - 1


@compiled
def _find_ground(
    ground: Ground,
    surface: Surface,
    patches: Floats,
    outside_patches: TrackGround,
    time: float,
    yaw: float,
    pose: Floats,
    slope: Floats,
) -> None:
    """Set friction and rolling resistance under both tracks, and the ground's slope.

    At a time [s], a pose (3,) and the yaw of the state [rad]. Without terrain the pose gets that yaw; the
    slope (2,) is as in `GridMotion`.
    """
    if not surface.present:
        pose[2] = yaw
    place = (pose[0], pose[1], pose[2])
    under_tracks = TrackGround(ground.friction, ground.rolling_resistance)
    look_up(patches, time, place, ground.half_gauge, outside_patches, under_tracks, slope)
    if surface.present:
        p_x, p_y = tilt(surface, patches, time, pose[0], pose[1])
        forward, left, _ = gravity_on(p_x, p_y, pose[2])
        cos, sin = np.cos(yaw), np.sin(yaw)
        slope[0] = cos * forward - sin * left
        slope[1] = sin * forward + cos * left


@compiled
def _step_error(
    before: Floats, after: Floats, difference: Floats, tolerance: float, scales: Floats
) -> float:
    """RMS error of a step over its tolerance, by the embedded solution's difference."""
    error = 0.0
    for row in range(SIZE):
        largest = max(abs(before[row]), abs(after[row]))
        allowed = tolerance * scales[row] + tolerance * largest
        error += (difference[row] / allowed) ** 2
    return float(np.sqrt(error / SIZE))


@compiled
def _next_step(h: float, error: float) -> float:
    """Length of the next step by the error of one of length h, which may be NaN."""
    if error > 0.0:
        factor: float = SAFETY * error**-0.25
        return h * min(GROW, max(SHRINK, factor))
    return h * GROW if error == 0.0 else h * SHRINK


@compiled
def _rates(
    vehicle: Vehicle,
    weight: float,
    slope: Floats,
    y: Floats,
    V: tuple[float, float],
    forces: TrackForces,
    rate: Floats,
) -> bool:
    """Compute `forces` and `rate` (6,) of a state; return True if the vehicle tips.

    `weight` is from `_weight_on_slope`, `V` the speeds of the left and the right track [m/s].
    """
    v_x, v_y, w = y[0], y[1], y[2]
    values = forces.values
    values[:] = 0.0
    forces.jacobian[:] = 0.0
    ground, q_right, q_forward = vehicle.ground, y[FORCE_RIGHT], y[FORCE_FORWARD]
    tips = point_loads(ground, weight, q_right, q_forward, forces.loads)
    add_track_forces(ground, (v_x, v_y, w), V, forces.loads, values, forces.jacobian)
    rate[FORCE_RIGHT] = (-values[0] - q_right) / vehicle.load_lag
    rate[FORCE_FORWARD] = (-values[1] - q_forward) / vehicle.load_lag
    rate[YAW] = w
    x, y_CM, _ = ground.centre
    M, (g_right, g_forward) = ground.mass, _in_body(slope, y[YAW])
    right = M * (w * (v_y + x * w) + g_right)
    forward = M * (w * (y_CM * w - v_x) + g_forward)
    f_x, f_y = values[0] + right, values[1] + forward
    moment = values[2] + x * forward - y_CM * right
    for row in range(3):
        inverse = vehicle.inverse_mass[row]
        rate[row] = inverse[0] * f_x + inverse[1] * f_y + inverse[2] * moment
    return tips


@compiled
def _rate_derivatives(
    vehicle: Vehicle,
    slope: Floats,
    y: Floats,
    speed_rate: tuple[float, float],
    jacobian: Floats,
    by_state: Floats,
    by_time: Floats,
) -> None:
    """Compute derivatives of `_rates` by state (6, 6) and by time (6,), in place.

    `speed_rate` are the accelerations of both tracks [m/s²], the Jacobian that of the ground's forces.
    """
    by_state[:] = 0.0
    v_x, v_y, w = y[0], y[1], y[2]
    x, y_CM, _ = vehicle.ground.centre
    M, (g_right, g_forward) = vehicle.ground.mass, _in_body(slope, y[YAW])
    for column in range(SIZE):
        right = forward = f_x = f_y = moment = 0.0
        if column == 0:
            forward = -M * w
        elif column == 1:
            right = M * w
        elif column == 2:
            right, forward = M * (v_y + 2.0 * x * w), M * (2.0 * y_CM * w - v_x)
        elif column == YAW:
            right, forward = M * g_forward, -M * g_right
        if column < YAW:
            # The forces' Jacobian has the track speeds in columns 3 and 4.
            by = column if column < 3 else column + 2
            f_x, f_y, moment = jacobian[0, by], jacobian[1, by], jacobian[2, by]
        by_state[FORCE_RIGHT, column] = -f_x / vehicle.load_lag
        by_state[FORCE_FORWARD, column] = -f_y / vehicle.load_lag
        f_x, f_y, moment = f_x + right, f_y + forward, moment + x * forward - y_CM * right
        for row in range(3):
            inverse = vehicle.inverse_mass[row]
            by_state[row, column] = inverse[0] * f_x + inverse[1] * f_y + inverse[2] * moment
    by_state[FORCE_RIGHT, FORCE_RIGHT] -= 1.0 / vehicle.load_lag
    by_state[FORCE_FORWARD, FORCE_FORWARD] -= 1.0 / vehicle.load_lag
    by_state[YAW, 2] = 1.0
    left_rate, right_rate = speed_rate
    f_x = jacobian[0, 3] * left_rate + jacobian[0, 4] * right_rate
    f_y = jacobian[1, 3] * left_rate + jacobian[1, 4] * right_rate
    moment = jacobian[2, 3] * left_rate + jacobian[2, 4] * right_rate
    for row in range(3):
        inverse = vehicle.inverse_mass[row]
        by_time[row] = inverse[0] * f_x + inverse[1] * f_y + inverse[2] * moment
    by_time[FORCE_RIGHT] = -f_x / vehicle.load_lag
    by_time[FORCE_FORWARD] = -f_y / vehicle.load_lag
    by_time[YAW] = 0.0


@compiled
def _in_body(slope: Floats, yaw: float) -> tuple[float, float]:
    """Rotate a vector of the plane from odom to the paper's axes: right, forward."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return slope[0] * sin - slope[1] * cos, slope[0] * cos + slope[1] * sin


@compiled
def _weight_on_slope(ground: Ground, slope: Floats) -> float:
    """Part of the weight that is square to the slope [N]."""
    flat = ground.weight / ground.mass  # acceleration of gravity [m/s²]
    down = np.sqrt(max(flat * flat - slope[0] * slope[0] - slope[1] * slope[1], 0.0))
    return float(ground.mass * down)


@compiled
def _speed_at(
    speeds: Floats, rates: Floats, k: int, side: int, step: float, share: float
) -> tuple[float, float]:
    """Speed of a track and its rate, on the cubic from grid point k, at a share of it."""
    s = share
    # Cubic Hermite polynomials of s, and their derivatives by time.
    from_value, to_value = (1.0 + 2.0 * s) * (1.0 - s) ** 2, s * s * (3.0 - 2.0 * s)
    from_rate, to_rate = step * s * (1.0 - s) ** 2, step * s * s * (s - 1.0)
    value_rate = 6.0 * s * (s - 1.0) / step
    from_rate_rate, to_rate_rate = (1.0 - s) * (1.0 - 3.0 * s), s * (3.0 * s - 2.0)
    before, after = speeds[k, side], speeds[k + 1, side]
    rate, next_rate = rates[k, side], rates[k + 1, side]
    return (
        from_value * before + to_value * after + from_rate * rate + to_rate * next_rate,
        value_rate * (before - after) + from_rate_rate * rate + to_rate_rate * next_rate,
    )


@compiled
def _advance(pose: Floats, before: Floats, after: Floats, step: float) -> None:
    """Move x, y in odom of a pose (3,) by the mean velocity of both ends of a step."""
    for state in (before, after):
        cos, sin = np.cos(state[YAW]), np.sin(state[YAW])
        pose[0] += 0.5 * step * (cos * state[1] + sin * state[0])
        pose[1] += 0.5 * step * (sin * state[1] - cos * state[0])


@compiled
def _displacement(
    before: Floats, after: Floats, slip_before: Floats, slip_after: Floats, step: float
) -> tuple[float, float, float]:
    """Displacement forward, left [m] and turn [rad] in a step, in axes at its start."""
    half = 0.5 * step
    # States are to the right and forward, slips forward and to the left.
    forward = half * (before[1] + after[1] + slip_before[0] + slip_after[0])
    left = half * (slip_before[1] + slip_after[1] - before[0] - after[0])
    turn = after[YAW] - before[YAW] + half * (slip_before[2] + slip_after[2])
    # The chord lies half the turn to the left of the first heading.
    cos, sin = np.cos(0.5 * turn), np.sin(0.5 * turn)
    return cos * forward - sin * left, sin * forward + cos * left, turn


@compiled
def _factor(matrix: Floats, pivots: NDArray[np.int64]) -> None:
    """LU factorisation in place, with partial pivoting."""
    size = len(pivots)
    for k in range(size):
        best = k
        for row in range(k + 1, size):
            if abs(matrix[row, k]) > abs(matrix[best, k]):
                best = row
        pivots[k] = best
        if best != k:
            for column in range(size):
                matrix[k, column], matrix[best, column] = matrix[best, column], matrix[k, column]
        for row in range(k + 1, size):
            matrix[row, k] /= matrix[k, k]
            for column in range(k + 1, size):
                matrix[row, column] -= matrix[row, k] * matrix[k, column]


@compiled
def _substitute(matrix: Floats, pivots: NDArray[np.int64], vector: Floats) -> None:
    """Solve in place with the factors from `_factor`."""
    size = len(pivots)
    for k in range(size):
        best = pivots[k]
        vector[k], vector[best] = vector[best], vector[k]
    for row in range(size):
        for column in range(row):
            vector[row] -= matrix[row, column] * vector[column]
    for row in range(size - 1, -1, -1):
        for column in range(row + 1, size):
            vector[row] -= matrix[row, column] * vector[column]
        vector[row] /= matrix[row, row]
