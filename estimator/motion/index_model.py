"""The paper's inertia-based index model in steady motion on level ground.

It is implicit: indices depend on the force of inertia, inertia on the twist, the twist on the
indices. One scalar u, the (signed) force of inertia, determines all of them, so the model is

    w   = D / (L eta) + r_w          D = V_r - V_l,  V_m = (V_l + V_r) / 2
    v_y = V_m - D / (L eta) epsilon + r_y
    v_x =       D / (L eta) zeta + r_x
    zeta = zeta0 + zeta1 Z    epsilon = epsilon0 + epsilon1 S    eta = eta0 + eta1 S + eta2 u²
    u = g(v_x, v_y, w)

with, for the smooth form,   g = -M w (v_y + x_CM w),   S = u,   Z = -u sign(w),
and, for the literal form,   g = |F| of (11),   S = u sign(x_1) sign(x_2),   Z = u sign(x_2).

The indices are evaluated at a force of inertia of at most the weight: friction cannot balance more, and
so the equation has a solution for any parameters.

u is found by Newton's iteration from u = 0, or by bisection in the rare case that this does not converge
(parameters far from any real vehicle's). The derivatives follow from the implicit-function theorem.

Symbols and axes are the paper's (see `icreckon.estimator.motion.icr`). Arguments broadcast; floats give
floats, complex numbers pass through, for complex-step differentiation. The filter's model is
`icreckon.estimator.motion.lagged_index_model`.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from icreckon.estimator.base.choices import every, some
from icreckon.estimator.motion.icr import GRAVITY, IndexValues, Number, PaperTwist
from icreckon.estimator.motion.motion_model import (
    NO_SLIP,
    Channels,
    GainFactors,
    Motion,
    TwistDerivatives,
    VehicleConstants,
    at_least,
    at_or_above,
    dot,
    is_zero,
    sign,
    through_channels,
)

Form = Literal["smooth", "literal"]

NEWTON_ITERATIONS = 20
BISECTIONS = 80
TOLERANCE = 1e-13
# Newton's denominator 1 - dg/du is kept above this, so that a step never runs away near a fold.
SMALLEST_SLOPE = 0.25


def solve(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    vehicle: VehicleConstants,
    *,
    form: Form = "smooth",
    slip: tuple[Number, Number, Number] = NO_SLIP,
    slip_in_inertia: bool = False,
) -> Motion:
    """Body velocity, indices and inertia from track speeds.

    Args:
        V_l: speed of the left track [m/s].
        V_r: speed of the right track [m/s].
        parameters: `icreckon.Indices`, as `robot.indices`, or its values in that order, each of which
            broadcasts.
        vehicle: L, M, x_CM, y_CM, as `robot.constants`.
        form: "smooth" (signed inertia) or "literal" (the paper's |F| and signs).
        slip: residual (r_x, r_y, r_w) added to the kinematic twist.
        slip_in_inertia: True for the inertia of the twist with slip ("measured" inertia, if the slip is
            estimated from an IMU), False for that of the kinematic twist alone (track speeds only).

    Returns:
        The motion.
    """
    in_inertia = slip if slip_in_inertia else NO_SLIP
    values = parameters.as_array() if hasattr(parameters, "as_array") else parameters
    problem = balance_problem(V_l, V_r, values, vehicle, form == "literal", in_inertia)
    u = balance(problem)
    return _motion(u, evaluate(u, problem), slip)


def linearise(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    slip: tuple[Number, Number, Number],
    vehicle: VehicleConstants,
    is_literal: bool,
    slip_in_inertia: bool,
) -> tuple[Motion, TwistDerivatives]:
    """Compute the motion and the derivatives of its twist; arguments as in `solve`."""
    in_inertia = slip if slip_in_inertia else NO_SLIP
    problem = balance_problem(V_l, V_r, parameters, vehicle, is_literal, in_inertia)
    return linearise_at(balance(problem), problem, slip, slip_in_inertia)


def linearise_at(
    u: Number, problem: BalanceProblem, slip: tuple[Number, Number, Number], slip_in_inertia: bool
) -> tuple[Motion, TwistDerivatives]:
    """Compute motion and derivatives at the solution u of a balance; see `linearise`."""
    at = evaluate(u, problem)
    by = _channels(at, problem.vehicle.gauge, slip_in_inertia)
    return _motion(u, at, slip), through_channels(by, _gain_factors(at))


class BalanceProblem(NamedTuple):
    """Inputs of the balance for the force of inertia; the slip is that in the inertia."""

    D: Number
    V_m: Number
    parameters: Any
    vehicle: VehicleConstants
    is_literal: bool
    S_u: Number
    Z_u: Number
    slip: tuple[Number, Number, Number]


class _Evaluation(NamedTuple):
    """Evaluation of the model at one u; `eta_is_free` is 0 if eta is held at 1."""

    kinematic: PaperTwist
    indices: IndexValues
    force: Number
    S_u: Number
    Z_u: Number
    eta_is_free: Number
    g: Number
    g_twist: tuple[Number, Number, Number]
    twist_u: tuple[Number, Number, Number]
    g_u: Number


def balance_problem(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    vehicle: VehicleConstants,
    is_literal: bool,
    slip: tuple[Number, Number, Number],
) -> BalanceProblem:
    """Inputs of the balance at these track speeds; arguments as in `solve`."""
    D, V_m = V_r - V_l, 0.5 * (V_l + V_r)
    if is_literal:
        # sign(x_1) and sign(x_2) of (14) and (15).
        x_1, x_2 = sign(V_l - V_r), sign(V_l + parameters[0] * V_r)
        return BalanceProblem(D, V_m, parameters, vehicle, is_literal, x_1 * x_2, x_2, slip)
    # eta > 0, so the sign of the yaw rate is that of D; with slip in the inertia it may differ for a
    # moment at w = 0, where Z vanishes anyway.
    return BalanceProblem(D, V_m, parameters, vehicle, is_literal, 1.0, -sign(D), slip)


def balance(problem: BalanceProblem) -> Number:
    """Zero of u - g(u), reached by Newton's iteration from zero."""
    u = 0.0 * problem.D
    settled: Any = False
    for _ in range(NEWTON_ITERATIONS):
        step = evaluate(u, problem)
        change = (step.g - u) / at_least(1.0 - step.g_u, SMALLEST_SLOPE)
        u = u + change
        settled = abs(change) <= TOLERANCE * (1.0 + abs(u))
        if every(settled):
            return u
    return settled * u + (1.0 - settled) * _bisect(problem)


def _bisect(problem: BalanceProblem) -> Number:
    """Zero of u - g(u) by bisection: g is continuous and bounded, as the indices are."""
    high = 1.0 + 0.0 * problem.D
    for _ in range(BISECTIONS):
        short = ((high - evaluate(high, problem).g).real < 0.0) | (
            (-high - evaluate(-high, problem).g).real > 0.0
        )
        if not some(short):
            break
        high = high * (1.0 + short)
    low = -high
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        below = 1.0 * ((middle - evaluate(middle, problem).g).real < 0.0)
        low = below * middle + (1.0 - below) * low
        high = below * high + (1.0 - below) * middle
    return 0.5 * (low + high)


def evaluate(u: Number, problem: BalanceProblem) -> _Evaluation:
    """Evaluate indices, twist, g and their derivatives at one value of u."""
    _, zeta0, zeta1, epsilon0, epsilon1, eta0, eta1, eta2 = problem.parameters[:8]
    gauge, mass, x_CM, y_CM, *_ = problem.vehicle
    S_u, Z_u, slip = problem.S_u, problem.Z_u, problem.slip
    weight = mass * GRAVITY
    is_below = 1.0 - at_or_above(abs(u.real), weight)
    force = is_below * u + (1.0 - is_below) * sign(u) * weight
    S = S_u * force
    eta_free = eta0 + eta1 * S + eta2 * force * force
    # A track never turns the vehicle more than the ideal differential drive does: eta >= 1.
    eta_is_free = at_or_above(eta_free, 1.0)
    eta = eta_is_free * eta_free + (1.0 - eta_is_free)
    epsilon = epsilon0 + epsilon1 * S
    zeta = zeta0 + zeta1 * Z_u * force
    w = problem.D / (gauge * eta)
    kinematic = PaperTwist(w * zeta, problem.V_m - w * epsilon, w)
    v_x, v_y, w_all = kinematic.v_x + slip[0], kinematic.v_y + slip[1], w + slip[2]
    forward = v_y + x_CM * w_all
    if problem.is_literal:
        right = v_x - y_CM * w_all
        speed = (right * right + forward * forward) ** 0.5
        per_speed = 1.0 / (speed + is_zero(speed))
        sign_w = sign(w_all)
        g = mass * sign_w * w_all * speed
        scale = mass * sign_w * w_all * per_speed
        g_twist = (
            scale * right,
            scale * forward,
            mass * sign_w * speed + scale * (x_CM * forward - y_CM * right),
        )
    else:
        g = -mass * w_all * forward
        g_twist = (0.0, -mass * w_all, -mass * (forward + x_CM * w_all))
    eta_u = is_below * eta_is_free * (eta1 * S_u + 2.0 * eta2 * force)
    w_u = -w / eta * eta_u
    twist_u = (
        w_u * zeta + is_below * w * zeta1 * Z_u,
        -w_u * epsilon - is_below * w * epsilon1 * S_u,
        w_u,
    )
    return _Evaluation(
        kinematic,
        IndexValues(zeta, epsilon, eta),
        force,
        S_u,
        Z_u,
        eta_is_free,
        g,
        g_twist,
        twist_u,
        dot(g_twist, twist_u),
    )


def _motion(u: Number, at: _Evaluation, slip: tuple[Number, Number, Number]) -> Motion:
    kinematic = at.kinematic
    twist = PaperTwist(kinematic.v_x + slip[0], kinematic.v_y + slip[1], kinematic.w + slip[2])
    return Motion(twist, at.indices, u, at.force)


def _gain_factors(at: _Evaluation) -> GainFactors:
    """Gain factors Z, S, S [N] and the square of the force [N²]."""
    S = at.S_u * at.force
    return GainFactors(at.Z_u * at.force, S, S, at.force * at.force)


def _channels(at: _Evaluation, gauge: float, slip_in_inertia: bool) -> Channels:
    w = at.kinematic.w
    zeta, epsilon, eta = at.indices
    per_D = 1.0 / (gauge * eta)
    # Twist by each channel at fixed u: v_x = w zeta and v_y = V_m - w epsilon with w = D / (L eta).
    by_D = (zeta * per_D, -epsilon * per_D, per_D)
    by_zeta, by_epsilon = w, -w
    per_eta = -w / eta * at.eta_is_free
    by_eta = (per_eta * zeta, -per_eta * epsilon, per_eta)
    # u by each channel, and the twist by u.
    gain = 1.0 / (1.0 - at.g_u)
    by_u, g_twist = at.twist_u, at.g_twist
    slip_gain = gain if slip_in_inertia else 0.0 * gain
    return Channels(
        _total(by_D, by_u, gain * dot(g_twist, by_D)),
        _total((0.0, 1.0, 0.0), by_u, gain * g_twist[1]),
        _total((by_zeta, 0.0, 0.0), by_u, gain * g_twist[0] * by_zeta),
        _total((0.0, by_epsilon, 0.0), by_u, gain * g_twist[1] * by_epsilon),
        _total(by_eta, by_u, gain * dot(g_twist, by_eta)),
        _total((1.0, 0.0, 0.0), by_u, slip_gain * g_twist[0]),
        _total((0.0, 1.0, 0.0), by_u, slip_gain * g_twist[1]),
        _total((0.0, 0.0, 1.0), by_u, slip_gain * g_twist[2]),
    )


def _total(
    direct: tuple[Number, Number, Number],
    by_u: tuple[Number, Number, Number],
    u_channel: Number,
) -> tuple[Number, Number, Number]:
    """Total derivative of the twist by a channel: at fixed u, and through u."""
    return (
        direct[0] + by_u[0] * u_channel,
        direct[1] + by_u[1] * u_channel,
        direct[2] + by_u[2] * u_channel,
    )
