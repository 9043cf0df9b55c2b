"""Motion models: body velocity from track speeds and parameters, with its derivatives.

What a filter needs of one is `MotionModel`; `estimator.friction_motion` has another. The one here is that
of the paper, which without its gains is also that of constant ICRs and of the ideal differential drive.

It is implicit: indices depend on the force of inertia, inertia on the twist, the twist on the
indices. All of it hangs on one scalar u, the (signed) force of inertia, so the model is

    w   = D / (L eta) + r_w          D = V_r - V_l,  V_m = (V_l + V_r) / 2
    v_y = V_m - D / (L eta) epsilon + r_y
    v_x =       D / (L eta) zeta + r_x
    zeta = zeta0 + zeta1 Z    epsilon = epsilon0 + epsilon1 S    eta = eta0 + eta1 S + eta2 u²
    u = g(v_x, v_y, w)

with, for the smooth form,   g = -M w (v_y + x_CM w),   S = u,   Z = -u sign(w),
and, for the literal form,   g = |F| of (11),   S = u sign(x_1) sign(x_2),   Z = u sign(x_2).

The indices are evaluated at a force of inertia of at most the weight: friction cannot balance more, and
so the equation has a solution for any parameters.

u is found by Newton's iteration from u = 0, by bisection in the rare case where that does not settle
(parameters far from any real vehicle's), and the derivatives follow from the implicit-function
theorem. Inputs act only through eight *channels* (D, V_m, zeta, epsilon, eta and the slip r), so the
Jacobian by any parameter is a channel's column times that parameter's basis value.

Symbols and axes are the paper's (see `kinematics`). Arguments broadcast; floats give floats, and complex
numbers pass through, for complex-step differentiation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from estimator.kinematics import GRAVITY, IndexValues, Number, PaperTwist

Form = Literal["smooth", "literal"]

NEWTON_ITERATIONS = 20
BISECTIONS = 80
TOLERANCE = 1e-13
# Newton's denominator 1 - dg/du is kept above this, so that a step never runs away near a fold.
SMALLEST_SLOPE = 0.25
NO_SLIP: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


class VehicleConstants(NamedTuple):
    """L [m], M [kg] and the centre of mass (right, forward) [m], as the paper has them."""

    gauge: float
    mass: float
    x_CM: float
    y_CM: float


class Regressors(NamedTuple):
    """What multiplies each gain in its index, in units of the index over those of the gain."""

    zeta1: Number
    epsilon1: Number
    eta1: Number
    eta2: Number


class Motion(NamedTuple):
    """The solved motion.

    Attributes:
        twist: body velocity, slip included.
        indices: index values of this motion.
        u: the (signed) force of inertia [N].
        force: the same, of at most the weight.
        regressors: of the gains: Z, S, S [N] and `force` squared [N²] in the inertia-based model.
    """

    twist: PaperTwist
    indices: IndexValues
    u: Number
    force: Number
    regressors: Regressors


class Channels(NamedTuple):
    """Total derivatives of (v_x, v_y, w) by each channel: each a triple."""

    D: tuple[Number, Number, Number]
    V_m: tuple[Number, Number, Number]
    zeta: tuple[Number, Number, Number]
    epsilon: tuple[Number, Number, Number]
    eta: tuple[Number, Number, Number]
    r_x: tuple[Number, Number, Number]
    r_y: tuple[Number, Number, Number]
    r_w: tuple[Number, Number, Number]


class MotionModel(Protocol):
    """How a robot moves at given track speeds: an index model in the kinematics (20) to (22)."""

    @property
    def vehicle(self) -> VehicleConstants:
        """L, M, x_CM, y_CM."""

    def linearise(
        self, V_l: Number, V_r: Number, parameters: Any, slip: tuple[Number, Number, Number]
    ) -> tuple[Motion, Channels]:
        """The motion and the total derivatives of its twist.

        Args:
            V_l: speed of the left track [m/s].
            V_r: speed of the right track [m/s].
            parameters: the eight, in the order of `estimator.robot.Indices`.
            slip: residual (r_x, r_y, r_w) added to the kinematic twist.
        """


@dataclass(frozen=True)
class InertiaMotion:
    """The inertia-based index model: `solve` and `channels` with their options."""

    vehicle: VehicleConstants
    form: Form = "smooth"
    slip_in_inertia: bool = False

    def linearise(
        self, V_l: Number, V_r: Number, parameters: Any, slip: tuple[Number, Number, Number]
    ) -> tuple[Motion, Channels]:
        """See `MotionModel`."""
        in_inertia = slip if self.slip_in_inertia else NO_SLIP
        evaluate = _evaluator(V_l, V_r, parameters, self.vehicle, self.form, in_inertia)
        u = _balance(evaluate, V_r - V_l)
        at = evaluate(u)
        return _motion(u, at, slip), _channels(at, self.vehicle.gauge, self.slip_in_inertia)


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
        parameters: the eight, in the order of `estimator.robot.Indices`; each broadcasts.
        vehicle: L, M, x_CM, y_CM.
        form: "smooth" (signed inertia) or "literal" (the paper's |F| and signs).
        slip: residual (r_x, r_y, r_w) added to the kinematic twist.
        slip_in_inertia: whether the inertia is that of the twist with slip ("measured" inertia, when
            the slip is estimated from an IMU) or of the kinematic twist alone (track speeds only).

    Returns:
        The motion.
    """
    evaluate = _evaluator(V_l, V_r, parameters, vehicle, form, slip if slip_in_inertia else NO_SLIP)
    u = _balance(evaluate, V_r - V_l)
    return _motion(u, evaluate(u), slip)


def channels(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    vehicle: VehicleConstants,
    motion: Motion,
    *,
    form: Form = "smooth",
    slip: tuple[Number, Number, Number] = NO_SLIP,
    slip_in_inertia: bool = False,
) -> Channels:
    """Total derivatives of the twist at a motion that `solve` returned for the same arguments."""
    evaluate = _evaluator(V_l, V_r, parameters, vehicle, form, slip if slip_in_inertia else NO_SLIP)
    return _channels(evaluate(motion.u), vehicle.gauge, slip_in_inertia)


def _balance(evaluate: Callable[[Number], _Evaluation], like: Number) -> Number:
    """A zero of u - g(u), the one that Newton's iteration reaches from zero."""
    u = 0.0 * like
    settled: Any = False
    for _ in range(NEWTON_ITERATIONS):
        step = evaluate(u)
        change = (step.g - u) / _at_least(1.0 - step.g_u, SMALLEST_SLOPE)
        u = u + change
        settled = abs(change) <= TOLERANCE * (1.0 + abs(u))
        if settled is True or (settled is not False and np.all(settled)):
            return u
    return settled * u + (1.0 - settled) * _bisect(evaluate, like)


def _motion(u: Number, at: _Evaluation, slip: tuple[Number, Number, Number]) -> Motion:
    kinematic = at.kinematic
    twist = PaperTwist(kinematic.v_x + slip[0], kinematic.v_y + slip[1], kinematic.w + slip[2])
    S = at.S_u * at.force
    regressors = Regressors(at.Z_u * at.force, S, S, at.force * at.force)
    return Motion(twist, at.indices, u, at.force, regressors)


def _channels(at: _Evaluation, gauge: float, slip_in_inertia: bool) -> Channels:
    w = at.kinematic.w
    zeta, epsilon, eta = at.indices
    per_D = 1.0 / (gauge * eta)
    # Twist by each channel at fixed u.
    by_D = (zeta * per_D, -epsilon * per_D, per_D)
    by_zeta, by_epsilon = w, -w
    by_eta = _by_eta(at)
    # u by each channel, and the twist by u.
    gain = 1.0 / (1.0 - at.g_u)
    u_D = gain * _dot(at.g_twist, by_D)
    u_V_m = gain * at.g_twist[1]
    u_zeta = gain * at.g_twist[0] * by_zeta
    u_epsilon = gain * at.g_twist[1] * by_epsilon
    u_eta = gain * _dot(at.g_twist, by_eta)
    by_u = at.twist_u

    def total(
        direct_x: Number, direct_y: Number, direct_w: Number, u_channel: Number
    ) -> tuple[Number, Number, Number]:
        return (
            direct_x + by_u[0] * u_channel,
            direct_y + by_u[1] * u_channel,
            direct_w + by_u[2] * u_channel,
        )

    free = at.eta_is_free
    slip_gain = gain if slip_in_inertia else 0.0 * gain
    return Channels(
        D=total(*by_D, u_D),
        V_m=total(0.0, 1.0, 0.0, u_V_m),
        zeta=total(by_zeta, 0.0, 0.0, u_zeta),
        epsilon=total(0.0, by_epsilon, 0.0, u_epsilon),
        eta=total(free * by_eta[0], free * by_eta[1], free * by_eta[2], free * u_eta),
        r_x=total(1.0, 0.0, 0.0, slip_gain * at.g_twist[0]),
        r_y=total(0.0, 1.0, 0.0, slip_gain * at.g_twist[1]),
        r_w=total(0.0, 0.0, 1.0, slip_gain * at.g_twist[2]),
    )


def _bisect(evaluate: Callable[[Number], _Evaluation], like: Number) -> Number:
    """A zero of u - g(u) by bisection: g is continuous and bounded, since the indices are."""
    high = 1.0 + 0.0 * like
    for _ in range(BISECTIONS):
        short = ((high - evaluate(high).g).real < 0.0) | ((-high - evaluate(-high).g).real > 0.0)
        if not np.any(short):
            break
        high = high * (1.0 + short)
    low = -high
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        below = 1.0 * ((middle - evaluate(middle).g).real < 0.0)
        low = below * middle + (1.0 - below) * low
        high = below * high + (1.0 - below) * middle
    return 0.5 * (low + high)


class _Evaluation(NamedTuple):
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


def _evaluator(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    vehicle: VehicleConstants,
    form: Form,
    slip: tuple[Number, Number, Number],
) -> Callable[[Number], _Evaluation]:
    """Everything at one value of u, as a function of u alone; the slip is that in the inertia."""
    D, V_m = V_r - V_l, 0.5 * (V_l + V_r)
    signs = _literal_signs(V_l, V_r, parameters[0]) if form == "literal" else None
    return lambda u: _evaluate(u, D, V_m, parameters, vehicle, signs, slip)


def _evaluate(
    u: Number,
    D: Number,
    V_m: Number,
    parameters: Any,
    vehicle: VehicleConstants,
    signs: tuple[Number, Number] | None,
    slip: tuple[Number, Number, Number],
) -> _Evaluation:
    """Everything at one value of u: indices, twist, g and their derivatives by u and by the twist."""
    _, zeta0, zeta1, epsilon0, epsilon1, eta0, eta1, eta2 = parameters
    gauge, mass, x_CM, y_CM = vehicle
    if signs is None:
        # eta > 0, so the sign of the yaw rate is that of D; with slip in the inertia it may differ
        # for a moment at w = 0, where Z vanishes anyway.
        S_u, Z_u = 1.0, -_sign(D)
    else:
        S_u, Z_u = signs[0] * signs[1], signs[1]
    weight = mass * GRAVITY
    is_below = 1.0 - _at_or_above(abs(u.real), weight)
    force = is_below * u + (1.0 - is_below) * _sign(u) * weight
    S = S_u * force
    eta_free = eta0 + eta1 * S + eta2 * force * force
    # A track never turns the vehicle more than the ideal differential drive does: eta >= 1.
    eta_is_free = _at_or_above(eta_free, 1.0)
    eta = eta_is_free * eta_free + (1.0 - eta_is_free)
    epsilon = epsilon0 + epsilon1 * S
    zeta = zeta0 + zeta1 * Z_u * force
    w = D / (gauge * eta)
    kinematic = PaperTwist(w * zeta, V_m - w * epsilon, w)
    v_x, v_y, w_all = kinematic.v_x + slip[0], kinematic.v_y + slip[1], w + slip[2]
    forward = v_y + x_CM * w_all
    if signs is None:
        g = -mass * w_all * forward
        g_twist = (0.0, -mass * w_all, -mass * (forward + x_CM * w_all))
    else:
        right = v_x - y_CM * w_all
        speed = (right * right + forward * forward) ** 0.5
        per_speed = 1.0 / (speed + _is_zero(speed))
        sign_w = _sign(w_all)
        g = mass * sign_w * w_all * speed
        scale = mass * sign_w * w_all * per_speed
        g_twist = (
            scale * right,
            scale * forward,
            mass * sign_w * speed + scale * (x_CM * forward - y_CM * right),
        )
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
        _dot(g_twist, twist_u),
    )


def _by_eta(at: _Evaluation) -> tuple[Number, Number, Number]:
    """The twist by eta at fixed u: v_x = w zeta and v_y = V_m - w epsilon with w ~ 1 / eta."""
    per_eta = -at.kinematic.w / at.indices.eta
    return per_eta * at.indices.zeta, -per_eta * at.indices.epsilon, per_eta


def _literal_signs(V_l: Number, V_r: Number, H: Number) -> tuple[Number, Number]:
    """sign(x_1) and sign(x_2) of (14) and (15)."""
    return _sign(V_l - V_r), _sign(V_l + H * V_r)


def _dot(a: tuple[Number, Number, Number], b: tuple[Number, Number, Number]) -> Number:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


# Comparisons look at the real part only, so that a complex step passes through.


def _sign(x: Number) -> Number:
    return 1.0 * (x.real > 0.0) - 1.0 * (x.real < 0.0)


def _at_or_above(x: Number, bound: float) -> Number:
    return 1.0 * (x.real >= bound)


def _is_zero(x: Number) -> Number:
    return 1.0 * (x == 0.0)


def _at_least(x: Number, bound: float) -> Number:
    inside = _at_or_above(x, bound)
    return inside * x + (1.0 - inside) * bound
