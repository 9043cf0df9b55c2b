"""Equations of `icreckon.simulation.contact.contact` for one motion, compiled.

Loads, friction and rolling resistance are implemented only here; `contact`, the stationary solver and the
transient dynamics all call it. Import it inside functions only: numba takes half a second to load. Every
function but `newton_of_many` accepts floats, or complex numbers for complex-step differentiation
(comparisons use the real part, as in `V.real`). Columns of Jacobians are, in this order, the derivatives
by v_x, v_y, w, V_l, V_r and by the force at the centre of mass to the right and forward.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import WRONG_SIZE
from icreckon.estimator.tracing.jit_kernel import compiled

COLUMNS = 7
# Distance of a tipping vehicle's centre of pressure inside the contact's edge, as a share of half the
# contact's extent; on the edge itself the planar loads are not unique.
TIPPING_MARGIN = 1e-6
ACTIVE_SET_ITERATIONS = 100
LINE_SEARCH_HALVINGS = 40
ARMIJO = 1e-4
NO_LOAD = 1e-13  # below this share of the mean load, a load is zero to rounding
# Points that touch are collinear if their moments' dimensionless determinant is below this; a ridge of
# this share, added to the moments, keeps the step of the active-set iteration finite there.
RIDGE = 1e-12
# Newton's iteration for stationary motions: least share of its step by which it improves, smallest step.
SUFFICIENT_DECREASE = 1e-4
SMALLEST_STEP = 1e-6


class Ground(NamedTuple):
    """Contact as plain numbers, with fields of `icreckon.simulation.contact.contact`."""

    x: Floats  # (m,) contact points, left track first, right of the origin [m]
    y: Floats  # (m,) contact points, forward of the origin [m]
    share: Floats  # (m,) share of each point in the load under even pressure, sum 1 [-]
    # (3, 3) inverse of all points' moments of 1, x, y, weighted by their shares; times (1, x, y) of the
    # centre of pressure it is (a, b, c) of the planar loads
    even: Floats
    half_gauge: float  # L / 2 [m]
    # half width, rear and front end of the rectangle around all points [m]
    outline: tuple[float, float, float]
    # (2, 2) coefficients across and along the track, of the left and the right track [-]
    friction: Floats
    rolling_resistance: Floats  # (2,) coefficients of the left and the right track [-]
    shear_modulus: float  # K [m], 0 for full friction at any slip
    small: float  # regularising speed [m/s]
    opposes_travel: bool  # True if rolling resistance opposes the travel of the centreline
    mass: float  # M [kg]
    weight: float  # force that presses on the ground [N]
    centre: tuple[float, float, float]  # x_CM, y_CM, z_CM [m]


class PointLoads(NamedTuple):
    """Loads of the contact points, and their derivatives by the force on the body."""

    loads: Any  # (m,) loads [N]
    by_right: Floats  # (m,) derivatives by the force to the right [-]
    by_forward: Floats  # (m,) derivatives by the force forward [-]


@compiled
def point_loads(
    ground: Ground, weight: float, right: Any, forward: Any, results: PointLoads
) -> bool:
    """Compute loads [N] under weight and a force at the centre of mass.

    They overwrite `results`. `weight` is the force that presses on the ground [N]; the force to
    the right and forward [N] is the force of inertia, and gravity's part along a slope.

    Loads are planar over the points that touch and zero at those that lift off: p = weight max(0, a + b x
    + c y). They solve a convex problem: minimise sum(p^2 / weight) subject to the balance of force and
    moments and p >= 0. The solution is unique while the weight and the force together point inside the
    contact. Newton's iteration over the set of touching points, with a line search on the dual function,
    ends at the exact set.

    Returns True if the vehicle tips: no loads balance the moment. Then the centre of pressure (x, y) is
    held just inside the contact's edge.
    """
    loads, by_right, by_forward = results
    x_CM, y_CM, z_CM = ground.centre
    half, rear, front = ground.outline
    arm = z_CM / weight
    inside = 1.0 - TIPPING_MARGIN
    middle, reach = 0.5 * (rear + front), 0.5 * (front - rear) * inside
    x, y = x_CM + arm * right, y_CM + arm * forward
    x_free = y_free = 1.0  # 0.0 where the centre of pressure is held: it has no derivative
    # 0.0 * x keeps the type, which may be complex.
    if abs(x.real) >= half * inside:
        x = 0.0 * x + (half * inside if x.real > 0.0 else -half * inside)
        x_free = 0.0
    if abs(y.real - middle) >= reach:
        y = 0.0 * y + (middle + reach if y.real > middle else middle - reach)
        y_free = 0.0
    # A point at (X, Y) carries its share of the pressure p_a + p_b X + p_c Y.
    inverse = ground.even
    p_a, p_b, p_c = _pressure_plane(inverse, weight, x, y)
    lifts = False
    for i in range(len(ground.x)):
        pressed = p_a + p_b * ground.x[i] + p_c * ground.y[i]
        lifts |= pressed.real < 0.0
    if lifts:
        plane = np.array([p_a.real, p_b.real, p_c.real]) / weight
        inverse = _inverse_of_touching(ground, x.real, y.real, plane)
        p_a, p_b, p_c = _pressure_plane(inverse, weight, x, y)
    for i in range(len(ground.x)):
        X, Y, share = ground.x[i], ground.y[i], ground.share[i]
        pressed = share * (p_a + p_b * X + p_c * Y)
        # The contact of a point whose load is zero to rounding makes no difference.
        if pressed.real <= NO_LOAD * weight * share:
            pressed, share = 0.0 * pressed, 0.0
        loads[i] = pressed
        by_x = inverse[0, 1] + inverse[1, 1] * X + inverse[2, 1] * Y
        by_y = inverse[0, 2] + inverse[1, 2] * X + inverse[2, 2] * Y
        by_right[i] = x_free * z_CM * share * by_x
        by_forward[i] = y_free * z_CM * share * by_y
    return x_free * y_free == 0.0


@compiled
def add_track_forces(
    ground: Ground, twist: Any, speeds: Any, pressing: PointLoads, values: Any, jacobian: Any
) -> None:
    """Add the ground's force and moment on both tracks, and their derivatives.

    Both are added to `values` (3,) [N, N, N m] and `jacobian` (3, COLUMNS). The tuples `twist` and
    `speeds` are v_x, v_y [m/s], w [rad/s], and V_l, V_r of the left and the right track [m/s].
    """
    v_x, v_y, w = twist
    V_l, V_r = speeds
    loads, by_right, by_forward = pressing
    count = len(ground.x) // 2
    sheared = ground.shear_modulus > 0.0
    for track in range(2):
        V = V_r if track else V_l
        V_column = 3 + track
        mu_x, mu_y = ground.friction[track]
        zero = 0.0 * V  # keeps the type, which may be complex
        # Sums over the points: load, friction, and their derivatives by the force right and forward.
        load = f_x = f_y = moment = zero
        right_load = right_x = right_y = right_moment = zero
        forward_load = forward_x = forward_y = forward_moment = zero
        # Sums of the derivatives k_xx, k_xy, k_yy of friction by slip; xx_y is the sum of k_xx y.
        xx = xx_y = xx_yy = yy = yy_x = yy_xx = xy = xy_x = xy_y = xy_xy = zero
        for i in range(track * count, (track + 1) * count):
            x, y, p = ground.x[i], ground.y[i], loads[i]
            # Slip velocity times friction (u), its direction (e), and the friction force per load (t).
            u_x, u_y = mu_x * (v_x - y * w), mu_y * (v_y + x * w - V)
            scale = 1.0 / np.sqrt(u_x * u_x + u_y * u_y + mu_x * mu_y * ground.small * ground.small)
            e_x, e_y = u_x * scale, u_y * scale
            t_x, t_y = mu_x * e_x, mu_y * e_y
            p_over_slip = p * scale
            if sheared:
                h, h_x, h_y, h_w, h_V = _mobilised(ground, x, y, v_x, v_y, w, V)
                # By the product rule: the mobilised share h has derivatives h_x, h_y, h_w, h_V as well.
                for column, h_by in ((0, h_x), (1, h_y), (2, h_w), (V_column, h_V)):
                    jacobian[0, column] -= p * t_x * h_by
                    jacobian[1, column] -= p * t_y * h_by
                    jacobian[2, column] -= p * (x * t_y - y * t_x) * h_by
                t_x, t_y, p_over_slip = t_x * h, t_y * h, p_over_slip * h
            arm = x * t_y - y * t_x  # moment per load
            load += p
            f_x += p * t_x
            f_y += p * t_y
            moment += p * arm
            right_load += by_right[i]
            right_x += by_right[i] * t_x
            right_y += by_right[i] * t_y
            right_moment += by_right[i] * arm
            forward_load += by_forward[i]
            forward_x += by_forward[i] * t_x
            forward_y += by_forward[i] * t_y
            forward_moment += by_forward[i] * arm
            k_xx = mu_x * mu_x * p_over_slip * (1.0 - e_x * e_x)
            k_xy = -mu_x * mu_y * p_over_slip * e_x * e_y
            k_yy = mu_y * mu_y * p_over_slip * (1.0 - e_y * e_y)
            xx += k_xx
            xx_y += k_xx * y
            xx_yy += k_xx * y * y
            xy += k_xy
            xy_x += k_xy * x
            xy_y += k_xy * y
            xy_xy += k_xy * x * y
            yy += k_yy
            yy_x += k_yy * x
            yy_xx += k_yy * x * x
        values[0] -= f_x
        values[1] -= f_y
        values[2] -= moment
        for column, x_slope, y_slope, moment_slope in (
            (0, xx, xy, xy_x - xx_y),
            (1, xy, yy, yy_x - xy_y),
            (2, xy_x - xx_y, yy_x - xy_y, xx_yy - 2.0 * xy_xy + yy_xx),
            (V_column, -xy, -yy, xy_y - yy_x),
            (5, right_x, right_y, right_moment),
            (6, forward_x, forward_y, forward_moment),
        ):
            jacobian[0, column] -= x_slope
            jacobian[1, column] -= y_slope
            jacobian[2, column] -= moment_slope
        if ground.rolling_resistance[track] > 0.0:
            track_loads = load, right_load, forward_load
            _add_rolling_resistance(ground, track, twist, V, track_loads, values, jacobian)


@compiled
def _add_rolling_resistance(
    ground: Ground, track: int, twist: Any, V: Any, loads: Any, values: Any, jacobian: Any
) -> None:
    """Add the rolling resistance of a track, by its load [N] and its derivatives."""
    (_, v_y, w), (load, right_load, forward_load) = twist, loads
    resistance, small = ground.rolling_resistance[track], ground.small
    X = ground.half_gauge if track else -ground.half_gauge
    speed = v_y + X * w if ground.opposes_travel else V
    scale = 1.0 / np.sqrt(speed * speed + small * small)
    unit = -resistance * speed * scale
    slope = -resistance * load * scale * scale * scale * small * small
    for row, lever in ((1, 1.0), (2, X)):
        values[row] += lever * load * unit
        jacobian[row, 5] += lever * right_load * unit
        jacobian[row, 6] += lever * forward_load * unit
        if ground.opposes_travel:
            jacobian[row, 1] += lever * slope
            jacobian[row, 2] += lever * X * slope
        else:
            jacobian[row, 3 + track] += lever * slope


@compiled
def add_steady_balance(
    ground: Ground, twist: Any, speeds: Any, pressing: PointLoads, values: Any, jacobian: Any
) -> bool:
    """Add to zeros the balance (3,) of steady motion and its derivatives (3, COLUMNS).

    The force at the centre of mass is that of inertia, (4) and (10). `pressing` is overwritten; for the
    other arguments see `add_track_forces`. Returns True if the vehicle tips.
    """
    v_x, v_y, w = twist
    M = ground.mass
    x, y, _ = ground.centre
    right, forward = M * w * (v_y + x * w), M * w * (y * w - v_x)
    tips = point_loads(ground, ground.weight, right, forward, pressing)
    add_track_forces(ground, twist, speeds, pressing, values, jacobian)
    values[0] += right
    values[1] += forward
    values[2] += x * forward - y * right
    for column, right_slope, forward_slope in (
        (0, 0.0 * w, -M * w),
        (1, M * w, 0.0 * w),
        (2, M * (v_y + 2.0 * x * w), M * (2.0 * y * w - v_x)),
    ):
        for row, inertia_slope in (
            (0, right_slope),
            (1, forward_slope),
            (2, x * forward_slope - y * right_slope),
        ):
            jacobian[row, column] += (
                inertia_slope + jacobian[row, 5] * right_slope + jacobian[row, 6] * forward_slope
            )
    return tips


@compiled
def _solve_3(matrix: Any, right_hand_side: Any, solution: Any) -> None:
    """Solve a 3 by 3 system by cofactors; zero if it is singular."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    g, h, i = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    x, y, z = right_hand_side[0], right_hand_side[1], right_hand_side[2]
    first, second, third = e * i - f * h, f * g - d * i, d * h - e * g
    determinant = a * first + b * second + c * third
    if determinant == 0.0:
        solution[:] = 0.0
        return
    solution[0] = (first * x + (c * h - b * i) * y + (b * f - c * e) * z) / determinant
    solution[1] = (second * x + (a * i - c * g) * y + (c * d - a * f) * z) / determinant
    solution[2] = (third * x + (b * g - a * h) * y + (a * e - b * d) * z) / determinant


@compiled
def newton_of_many(
    ground: Ground,
    V: Floats,
    steps: int,
    tolerance: float,
    twist: Floats,
    residual: Floats,
    tipping: NDArray[np.bool_],
) -> None:
    """Newton's iteration with step halving, until solved, stuck, or out of steps.

    `twist` (n, 3), right, forward, yaw [m/s, m/s, rad/s], has guesses for track speeds V (n, 2) [m/s]; it
    is changed to the best ones. `residual` (n,) gets the largest component of the balance over the weight
    (moments: over the weight times half the gauge), and `tipping` (n,) whether the vehicle tips. A pair
    ends at `tolerance`, or after `steps` evaluations beyond the first.

    Raises:
        ValueError: an array has the wrong size.
    """
    if V.shape != (len(V), 2) or twist.shape != (len(V), 3):
        raise ValueError(WRONG_SIZE)
    if residual.shape != (len(V),) or tipping.shape != (len(V),):
        raise ValueError(WRONG_SIZE)
    unit = np.array([1.0, 1.0, 1.0 / ground.half_gauge]) / ground.weight
    count = len(ground.x)
    pressing = PointLoads(np.empty(count), np.empty(count), np.empty(count))
    values, jacobian = np.empty(3), np.empty((3, COLUMNS))
    step, trial = np.empty(3), np.empty(3)
    for pair in range(len(V)):
        step_share, best_squares = 1.0, np.inf
        trial[:] = twist[pair]
        step[:] = 0.0
        for _ in range(steps + 1):
            values[:] = 0.0
            jacobian[:] = 0.0
            trial_twist, speeds = (trial[0], trial[1], trial[2]), (V[pair, 0], V[pair, 1])
            tips = add_steady_balance(ground, trial_twist, speeds, pressing, values, jacobian)
            values *= unit
            squares = (values * values).sum()
            if squares < (1.0 - SUFFICIENT_DECREASE * step_share) * best_squares:
                best_squares = squares
                twist[pair], tipping[pair] = trial, tips
                residual[pair] = np.abs(values).max()
                if residual[pair] <= tolerance:
                    break
                for row in range(3):
                    jacobian[row] *= unit[row]
                # A singular Jacobian gives a zero step, which improves nothing: the pair is stuck.
                _solve_3(jacobian, values, step)
                step_share = 1.0
            else:
                step_share *= 0.5
                if step_share <= SMALLEST_STEP:
                    break
            trial[:] = twist[pair] - step_share * step


@compiled
def _mobilised(
    ground: Ground, x: float, y: float, v_x: Any, v_y: Any, w: Any, V: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """Mobilised share h = 1 - exp(-j / K) of a point's friction, and its derivatives.

    A point of the track enters the contact at the end toward which the track drives, and reaches y after
    the time |y - y_entry| / |V|. Its shear displacement j [m] is that time multiplied by the slip speed
    halfway there (midpoint rule); the vehicle's rotation meanwhile is neglected. Returns h [-] (Wong and
    Chiang) and its derivatives by v_x, v_y [s/m], w [s/rad] and V [s/m].
    """
    _, rear, front = ground.outline
    # At V = 0 no end is the entry: the travel time is very long, and friction practically full.
    entry, distance = y, front - rear
    if V.real > 0.0:
        entry, distance = front, abs(y - front)
    elif V.real < 0.0:
        entry, distance = rear, abs(y - rear)
    small, K = ground.small, ground.shear_modulus
    time = distance / np.sqrt(V * V + small * small)
    time_by_V = -time * V / (V * V + small * small)
    halfway = 0.5 * (y + entry)
    slip_x, slip_y = v_x - halfway * w, v_y + x * w - V
    slip = np.sqrt(slip_x * slip_x + slip_y * slip_y + small * small)
    unmobilised = np.exp(-time * slip / K)
    by_slip_over_slip = unmobilised * time / (K * slip)
    by_x, by_y = by_slip_over_slip * slip_x, by_slip_over_slip * slip_y
    by_w = by_slip_over_slip * (x * slip_y - halfway * slip_x)
    by_V = -by_slip_over_slip * slip_y + unmobilised / K * slip * time_by_V
    return 1.0 - unmobilised, by_x, by_y, by_w, by_V


@compiled
def _pressure_plane(inverse: Floats, weight: float, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Pressure plane a + b X + c Y [N] of a weight [N] with its centre at x, y [m].

    `inverse` (3, 3) is that of the moments of the points that carry it.
    """
    return (
        weight * (inverse[0, 0] + inverse[0, 1] * x + inverse[0, 2] * y),
        weight * (inverse[1, 0] + inverse[1, 1] * x + inverse[1, 2] * y),
        weight * (inverse[2, 0] + inverse[2, 1] * x + inverse[2, 2] * y),
    )


@compiled
def _invert_moments(ground: Ground, active: NDArray[np.bool_], inverse: Floats) -> None:
    """Set `inverse` (3, 3) to that of the moments of 1, x, y of the active points."""
    n = s_x = s_y = xx = xy = yy = 0.0  # moments of 1, x, y, x², xy, y²
    for i in range(len(active)):
        if active[i]:
            share, x, y = ground.share[i], ground.x[i], ground.y[i]
            n += share
            s_x += share * x
            s_y += share * y
            xx += share * x * x
            xy += share * x * y
            yy += share * y * y
    half, rear, front = ground.outline
    reach = 0.5 * (front - rear)
    for ridge in (0.0, RIDGE):
        n, xx, yy = n + ridge, xx + ridge * half * half, yy + ridge * reach * reach
        # Cofactors of the first row.
        c_00, c_01, c_02 = xx * yy - xy * xy, xy * s_y - s_x * yy, s_x * xy - xx * s_y
        determinant = n * c_00 + s_x * c_01 + s_y * c_02
        if determinant >= RIDGE * half * half * reach * reach:
            break
    inverse[0, 0] = c_00 / determinant
    inverse[0, 1] = inverse[1, 0] = c_01 / determinant
    inverse[0, 2] = inverse[2, 0] = c_02 / determinant
    inverse[1, 1] = (n * yy - s_y * s_y) / determinant
    inverse[1, 2] = inverse[2, 1] = (s_x * s_y - n * xy) / determinant
    inverse[2, 2] = (n * xx - s_x * s_x) / determinant


@compiled
def _inverse_of_touching(ground: Ground, x: float, y: float, plane: Floats) -> Floats:
    """Inverse (3, 3) of the touching points' moments, unit weight at (x, y) [m].

    Newton's iteration on the dual function, from the plane (3,) of loads of either sign.
    """
    inverse, step = np.empty((3, 3)), np.empty(3)
    active = np.empty(len(ground.x), dtype=np.bool_)
    gradient, moments = np.empty(3), np.array([1.0, x, y])
    previous = _dual(ground, plane, moments, gradient, active)
    for _ in range(ACTIVE_SET_ITERATIONS):
        _invert_moments(ground, active, inverse)
        if np.abs(gradient).max() <= NO_LOAD:
            break
        descent = 0.0
        for row in range(3):
            step[row] = 0.0
            for column in range(3):
                step[row] -= inverse[row, column] * gradient[column]
            descent += step[row] * gradient[row]
        step_share = 1.0
        for _ in range(LINE_SEARCH_HALVINGS):
            trial = plane + step_share * step
            value = _dual(ground, trial, moments, gradient, active)
            if value <= previous + ARMIJO * step_share * descent + 1e-15:  # a rounding error
                break
            step_share *= 0.5
        plane, previous = trial, value
    return inverse


@compiled
def _dual(
    ground: Ground, plane: Floats, moments: Floats, gradient: Floats, active: NDArray[np.bool_]
) -> float:
    """Dual function of the loads at a plane; overwrites gradient and active points."""
    value = 0.0
    for k in range(3):
        value -= moments[k] * plane[k]
        gradient[k] = -moments[k]
    for i in range(len(active)):
        pressure = plane[0] + plane[1] * ground.x[i] + plane[2] * ground.y[i]
        active[i] = pressure > 0.0
        if active[i]:
            value += 0.5 * ground.share[i] * pressure * pressure
            gradient[0] += ground.share[i] * pressure
            gradient[1] += ground.share[i] * pressure * ground.x[i]
            gradient[2] += ground.share[i] * pressure * ground.y[i]
    return value
