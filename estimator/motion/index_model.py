"""The paper's inertia-based index model in steady motion on level ground.

The model is implicit: indices depend on the force of inertia, inertia on the twist, the twist on the
indices. One scalar u, the (signed) force of inertia, determines all of them, so the model is

    w   = D / (L eta)                D = V_r - V_l,  V_m = (V_l + V_r) / 2
    v_y = V_m - w epsilon
    v_x =       w zeta
    zeta = zeta0 + zeta1 Z    epsilon = epsilon0 + epsilon1 S    eta = eta0 + eta1 S + eta2 u²
    u = g(v_x, v_y, w)

with, for the smooth form,   g = -M w (v_y + x_CM w),   S = u,   Z = -u sign(w),
and, for the literal form,   g = |F| of (11),   S = u sign(x_1) sign(x_2),   Z = u sign(x_2).

The indices are evaluated at a force of inertia of at most the weight: friction cannot balance more, and
so the equation has a solution for any parameters.

u is found by Newton's iteration from u = 0, or by bisection in the rare case that this does not converge
(parameters far from any real vehicle's).

Symbols and axes are the paper's (see `icreckon.estimator.motion.icr`). Arguments broadcast; floats give
floats. The filter's model is `icreckon.estimator.motion.lagged_index_model`.
"""

from typing import Any, Literal, NamedTuple

from icreckon.estimator.base.choices import every, some
from icreckon.estimator.motion.icr import GRAVITY, IndexValues, Number, PaperTwist
from icreckon.estimator.motion.motion_model import (
    Motion,
    VehicleConstants,
    at_least,
    at_or_above,
    is_zero,
    sign,
)

Form = Literal["smooth", "literal"]

NEWTON_ITERATIONS = 20
BISECTIONS = 80
TOLERANCE = 1e-13
# Newton's denominator 1 - dg/du is kept above this, so that a step never runs away near a fold.
SMALLEST_SLOPE = 0.25


def solve(
    V_l: Number, V_r: Number, parameters: Any, vehicle: VehicleConstants, *, form: Form = "smooth"
) -> Motion:
    """Body velocity, indices and inertia from track speeds.

    Args:
        V_l: speed of the left track [m/s].
        V_r: speed of the right track [m/s].
        parameters: `icreckon.Indices`, as `robot.indices`, or its values in that order, each of which
            broadcasts.
        vehicle: L, M, x_CM, y_CM, as `robot.constants`.
        form: "smooth" (signed inertia) or "literal" (the paper's |F| and signs).
    """
    values = parameters.as_array() if hasattr(parameters, "as_array") else parameters
    # eta > 0, so the sign of the yaw rate is that of D.
    S_u, Z_u, is_literal = 1.0, -sign(V_r - V_l), form == "literal"
    if is_literal:
        # sign(x_1) and sign(x_2) of (14) and (15); the first parameter is H.
        Z_u = sign(V_l + values[0] * V_r)
        S_u = sign(V_l - V_r) * Z_u
    problem = _Problem(V_r - V_l, 0.5 * (V_l + V_r), values, vehicle, is_literal, S_u, Z_u)
    u = _balance(problem)
    at = _evaluate(u, problem)
    return Motion(at.twist, at.indices, u, at.force)


class _Problem(NamedTuple):
    """Inputs of the balance for the force of inertia."""

    D: Number  # V_r - V_l [m/s]
    V_m: Number  # mean track speed [m/s]
    parameters: Any  # in the order of `Indices`
    vehicle: VehicleConstants
    is_literal: bool  # the literal form, not the smooth one
    S_u: Number  # S over u: 1 or -1
    Z_u: Number  # Z over u: 1, 0 or -1


class _Evaluation(NamedTuple):
    """Evaluation of the model at one u."""

    twist: PaperTwist
    indices: IndexValues
    force: Number  # u limited to the weight [N]
    g: Number  # force of inertia of that twist [N]
    g_u: Number  # derivative of g by u [-]


def _balance(problem: _Problem) -> Number:
    """Zero of u - g(u), reached by Newton's iteration from zero."""
    u = 0.0 * problem.D
    is_settled: Any = False
    for _ in range(NEWTON_ITERATIONS):
        step = _evaluate(u, problem)
        change = (step.g - u) / at_least(1.0 - step.g_u, SMALLEST_SLOPE)
        u = u + change
        is_settled = abs(change) <= TOLERANCE * (1.0 + abs(u))
        if every(is_settled):
            return u
    return is_settled * u + (1.0 - is_settled) * _bisect(problem)


def _bisect(problem: _Problem) -> Number:
    """Zero of u - g(u) by bisection: g is continuous and bounded, as the indices are.

    Sums of products select, for numbers and arrays alike.
    """
    high = 1.0 + 0.0 * problem.D  # 1 N for each D
    # Double the interval from -high to high where it does not contain the zero.
    for _ in range(BISECTIONS):
        zero_is_above = (high - _evaluate(high, problem).g).real < 0.0
        is_outside = zero_is_above | ((-high - _evaluate(-high, problem).g).real > 0.0)
        if not some(is_outside):
            break
        high = high * (1.0 + is_outside)
    low = -high
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        middle_is_below = 1.0 * ((middle - _evaluate(middle, problem).g).real < 0.0)
        low = middle_is_below * middle + (1.0 - middle_is_below) * low
        high = middle_is_below * high + (1.0 - middle_is_below) * middle
    return 0.5 * (low + high)


def _evaluate(u: Number, problem: _Problem) -> _Evaluation:
    """Evaluate indices, twist, g and their derivatives at one value of u."""
    _, zeta0, zeta1, epsilon0, epsilon1, eta0, eta1, eta2 = problem.parameters[:8]
    gauge, mass, x_CM, y_CM, *_ = problem.vehicle
    S_u, Z_u = problem.S_u, problem.Z_u
    weight = mass * GRAVITY
    is_below = 1.0 - at_or_above(abs(u.real), weight)
    force = is_below * u + (1.0 - is_below) * sign(u) * weight
    S = S_u * force
    eta_sum = eta0 + eta1 * S + eta2 * force * force
    # A track never turns the vehicle more than the ideal differential drive does: eta >= 1.
    eta_is_free = at_or_above(eta_sum, 1.0)
    eta = eta_is_free * eta_sum + (1.0 - eta_is_free)
    epsilon = epsilon0 + epsilon1 * S
    zeta = zeta0 + zeta1 * Z_u * force
    w = problem.D / (gauge * eta)
    v_x, v_y = w * zeta, problem.V_m - w * epsilon
    forward = v_y + x_CM * w
    if problem.is_literal:
        right = v_x - y_CM * w
        speed = (right * right + forward * forward) ** 0.5
        per_speed = 1.0 / (speed + is_zero(speed))
        sign_w = sign(w)
        g = mass * sign_w * w * speed
        scale = mass * sign_w * w * per_speed
        g_w = mass * sign_w * speed + scale * (x_CM * forward - y_CM * right)
        g_twist = (scale * right, scale * forward, g_w)
    else:
        g = -mass * w * forward
        g_twist = (0.0, -mass * w, -mass * (forward + x_CM * w))
    w_u = -w / eta * is_below * eta_is_free * (eta1 * S_u + 2.0 * eta2 * force)
    g_u = g_twist[0] * (w_u * zeta + is_below * w * zeta1 * Z_u)
    g_u = g_u - g_twist[1] * (w_u * epsilon + is_below * w * epsilon1 * S_u) + g_twist[2] * w_u
    return _Evaluation(PaperTwist(v_x, v_y, w), IndexValues(zeta, epsilon, eta), force, g, g_u)
