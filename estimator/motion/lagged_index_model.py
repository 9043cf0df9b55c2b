"""Inertia-based index model of the filter, with lagged forces.

Friction balances the specific force at the centre of mass: inertia and gravity. Loads follow inertia with
the lag T of a body that rolls and pitches on its suspension, so the force at the start of a step
determines its indices, and the model is explicit. With V_m = (V_l + V_r) / 2 and D = V_r - V_l:

    w   = D / (L eta) + r_w
    v_y = V_m - D / (L eta) epsilon + r_y
    v_x =       D / (L eta) zeta + r_x
    zeta = zeta0 + zeta1 Z - zeta_F A    epsilon = epsilon0 + epsilon1 S + epsilon_F sign(D) P
    eta = eta0 + eta1 S + eta2 S²
    S = u - M g_right         Z = -S sign(D)          T du/dt = -M w (v_y - d + x_CM w) - u
    A = (a - g_forward) / g   P = A + c (sigma(V_l) + sigma(V_r)) / 2

S is the paper's signed force of inertia with gravity's part g_right along the ground. A and P are forces
along the tracks, as a share of the weight: A for the acceleration a (lagged, too) and against gravity's
part g_forward, P the ground's, against rolling resistance c, too. In a turn every contact point slides:
P shifts both ICRs to one side by epsilon_F P. A presses on the rear, so the ICRs move back by zeta_F A.
Part of v_y, by epsilon_F and gravity, is a slide d down the slope. While the robot turns, the direction
of d in the world is constant: it is no acceleration. The paper's model is the steady motion on level
ground with epsilon_F = 0 (`icreckon.estimator.motion.index_model`).

S is at most the weight, A at most 1. The ICRs of the tracks stay on both sides of the origin, and y_ICR
within the effective gauge: so v_y is between the track speeds for any parameters.

Symbols and axes are the paper's (see `icreckon.estimator.motion.icr`). Floats, complex numbers and traced
numbers pass through, see `icreckon.estimator.motion.motion_model`.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.bounds import ETA0, index_bounds
from icreckon.estimator.motion.icr import GRAVITY, IndexValues, Number, PaperTwist
from icreckon.estimator.motion.motion_model import (
    BodySlip,
    Gravity,
    Motion,
    TwistDerivatives,
    VehicleConstants,
    at_or_above,
    sign,
)

ROLLS_AT = 0.05  # speed of a track at which its rolling resistance has its full size [m/s]
# Memory: lagged force of inertia [N], lagged mean track speed [m/s], lagged acceleration [m/s²], and 1
# after the first step.
MEMORY = 4
CLOSEST = 0.02  # ICRs come no closer to the origin than this share of half the effective gauge


@dataclass
class LaggedIndexMotion:
    """Inertia-based index model with lagged forces; see `MotionModel`."""

    vehicle: VehicleConstants
    taught_by_imu: ClassVar[tuple[int, ...]] = (ETA0,)

    def __post_init__(self) -> None:
        self._memory: Floats = np.zeros(MEMORY)

    @property
    def bounds(self) -> Floats:
        """Bounds (n, 10) of the parameters, as in `MotionModel`."""
        return index_bounds(self.vehicle.gauge)

    def steering_efficiency(self, parameters: Any) -> float:
        """Typical steering efficiency index [-], as in `MotionModel`."""
        return float(parameters[ETA0])

    @property
    def memory(self) -> Floats:
        """Checkpoint (MEMORY,) of the forces."""
        return self._memory

    def recall(self, memory: Floats) -> None:
        """Restore a checkpoint, as in `MotionModel`."""
        if memory.shape != (MEMORY,):
            raise ValueError(
                f"the index model remembers {MEMORY} numbers, not {len(memory)}: they are another's"
            )
        self._memory = memory

    def begin_step(
        self, dt: float, V_l: float, V_r: float, parameters: Any, gravity: Gravity
    ) -> None:
        """Begin a step, as in `MotionModel`."""
        keep = math.exp(-dt / self.vehicle.load_lag)
        after = memory_after(self._memory, keep, (V_l, V_r), parameters, gravity, self.vehicle)
        self._memory = np.array(after, dtype=float)

    def linearise(
        self, V_l: Number, V_r: Number, parameters: Any, slip: BodySlip, gravity: Gravity
    ) -> tuple[Motion, TwistDerivatives]:
        """Motion and derivatives of its twist, as in `MotionModel`."""
        return linearise(V_l, V_r, parameters, slip, gravity, self.vehicle, self._memory)


def memory_after(
    memory: Any,
    keep: Number,
    speeds: tuple[Number, Number],
    parameters: Any,
    gravity: Gravity,
    vehicle: VehicleConstants,
) -> tuple[Number, Number, Number, Number]:
    """Memory (MEMORY,) after a step at constant track speeds.

    Args:
        memory: (MEMORY,) the memory before it.
        keep: factor exp(-dt / T) on the lagged forces.
        speeds: V_l, V_r [m/s].
        parameters: (9,) index parameters.
        gravity: gravity along the ground, right and forward [m/s²].
        vehicle: constants of the vehicle.
    """
    u_before, V_before, _, has_begun = memory
    V_m = 0.5 * (speeds[0] + speeds[1])
    at = evaluate(*speeds, parameters, gravity, vehicle, memory)
    twist, x_CM, epsilon_F = at.kinematic, vehicle.x_CM, parameters[8]
    slide = -twist.w * at.within_limits[1] * epsilon_F * at.signed_P_by_gravity * gravity[1]
    force = -vehicle.mass * twist.w * (twist.v_y - slide + x_CM * twist.w)
    # Before the first step the motion was steady: the force at once, and no acceleration.
    u = force + has_begun * keep * (u_before - force)
    V_before = has_begun * V_before + (1.0 - has_begun) * V_m
    V_after = V_m + keep * (V_before - V_m)
    return u, V_after, (V_m - V_after) / vehicle.load_lag, 1.0 + 0.0 * has_begun


class Evaluation(NamedTuple):
    """Evaluation of the model; `a_by_b` is the derivative of a by b."""

    kinematic: PaperTwist  # twist without slip
    indices: IndexValues  # index values
    S: Number  # signed specific force, limited to the weight [N]
    force: Number  # the same without the limit [N]
    Z_by_S: Number  # -sign(D) [-]
    signed_P: Number  # sign(D) P, which is epsilon_by_epsilon_F [-]
    S_by_gravity: Number  # by gravity to the right [kg]
    signed_P_by_gravity: Number  # by gravity forward [s²/m]
    signed_P_by_speeds: tuple[Number, Number]  # by the speeds of both tracks [s/m]
    eta_by_S: Number  # [1/N]
    # 1 where zeta, epsilon and eta are within their limits, else 0
    within_limits: tuple[Number, Number, Number]


def evaluate(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    gravity: Gravity,
    vehicle: VehicleConstants,
    memory: Any,
) -> Evaluation:
    """Evaluate forces, indices and twist; arguments as in `memory_after`."""
    zeta0, zeta1, epsilon0, epsilon1 = parameters[1], parameters[2], parameters[3], parameters[4]
    eta0, eta1, eta2, epsilon_F = parameters[5], parameters[6], parameters[7], parameters[8]
    D, V_m = V_r - V_l, 0.5 * (V_l + V_r)
    weight, sign_D = vehicle.mass * GRAVITY, sign(D)
    u, _, acceleration, _ = memory
    force = u - vehicle.mass * gravity[0]
    S, S_within = limited(force, weight)
    half_c = 0.5 * vehicle.rolling_resistance
    (sigma_l, sigma_l_by_V), (sigma_r, sigma_r_by_V) = _sigma(V_l), _sigma(V_r)
    A, A_within = limited((acceleration - gravity[1]) / GRAVITY, 1.0)
    P = half_c * (sigma_l + sigma_r) + A
    eta_sum = eta0 + eta1 * S + eta2 * S * S
    # A track never turns the vehicle more than the ideal differential drive does.
    eta_within = at_or_above(eta_sum, 1.0)
    eta = eta_within * eta_sum + (1.0 - eta_within)
    half_effective_gauge = 0.5 * vehicle.gauge * eta
    epsilon_sum = epsilon0 + epsilon1 * S + epsilon_F * sign_D * P
    epsilon, epsilon_within = limited(epsilon_sum, (1.0 - CLOSEST) * half_effective_gauge)
    zeta_sum = zeta0 - zeta1 * sign_D * S - vehicle.zeta_F * A
    zeta, zeta_within = limited(zeta_sum, 2.0 * half_effective_gauge)
    w = D / (vehicle.gauge * eta)
    return Evaluation(
        PaperTwist(w * zeta, V_m - w * epsilon, w),
        IndexValues(zeta, epsilon, eta),
        S,
        force,
        -sign_D,
        sign_D * P,
        -vehicle.mass * S_within,
        -sign_D * A_within / GRAVITY,
        (sign_D * half_c * sigma_l_by_V, sign_D * half_c * sigma_r_by_V),
        eta_within * (eta1 + 2.0 * eta2 * S),
        (zeta_within, epsilon_within, eta_within),
    )


def linearise(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    slip: BodySlip,
    gravity: Gravity,
    vehicle: VehicleConstants,
    memory: Any,
) -> tuple[Motion, TwistDerivatives]:
    """Compute the motion and the derivatives of its twist; lagged forces are inputs."""
    at = evaluate(V_l, V_r, parameters, gravity, vehicle, memory)
    zeta1, epsilon1, epsilon_F = parameters[2], parameters[4], parameters[8]
    (zeta, epsilon, eta), (zeta_within, epsilon_within, eta_within) = at.indices, at.within_limits
    v_x, v_y, w = at.kinematic.v_x, at.kinematic.v_y, at.kinematic.w
    zero = 0.0 * w  # zero and one of the type of the arguments: float, complex or traced
    one = 1.0 + zero
    # From v_x = w zeta and v_y = V_m - w epsilon, where the limits do not act.
    v_x_by_zeta, v_y_by_epsilon = w * zeta_within, -w * epsilon_within
    v_x_by_eta, v_y_by_eta, w_by_eta = _by_eta(at, vehicle.gauge)
    by_eta_sum = (eta_within * v_x_by_eta, eta_within * v_y_by_eta, eta_within * w_by_eta)
    gains = (at.Z_by_S * at.S, at.S, at.S * at.S, at.signed_P)
    by_parameters = (
        _by_parameters(v_x_by_zeta, zero, by_eta_sum[0], gains),
        _by_parameters(zero, v_y_by_epsilon, by_eta_sum[1], gains),
        _by_parameters(zero, zero, by_eta_sum[2], gains),
    )
    per_D = 1.0 / (vehicle.gauge * eta)
    v_x_by_D, v_y_by_D, v_y_by_P = zeta * per_D, -epsilon * per_D, v_y_by_epsilon * epsilon_F
    P_by_left, P_by_right = at.signed_P_by_speeds  # P times sign(D), in v_y_by_P, too
    by_speeds = (
        (zero - v_x_by_D, zero + v_x_by_D),
        (0.5 - v_y_by_D + v_y_by_P * P_by_left, 0.5 + v_y_by_D + v_y_by_P * P_by_right),
        (zero - per_D, zero + per_D),
    )
    v_x_by_S = v_x_by_zeta * zeta1 * at.Z_by_S + v_x_by_eta * at.eta_by_S
    v_y_by_S = v_y_by_epsilon * epsilon1 + v_y_by_eta * at.eta_by_S
    v_x_by_signed_A = v_x_by_zeta * vehicle.zeta_F * at.Z_by_S
    by_gravity = (
        (at.S_by_gravity * v_x_by_S, v_x_by_signed_A * at.signed_P_by_gravity),
        (at.S_by_gravity * v_y_by_S, v_y_by_P * at.signed_P_by_gravity),
        (at.S_by_gravity * (w_by_eta * at.eta_by_S), zero),
    )
    by_slip = ((one, zero, zero), (zero, one, zero), (zero, zero, one))
    twist = PaperTwist(v_x + slip[0], v_y + slip[1], w + slip[2])
    derivatives = TwistDerivatives(by_parameters, by_speeds, by_slip, by_gravity)
    return Motion(twist, at.indices, at.force, at.S), derivatives


def _by_eta(at: Evaluation, gauge: Number) -> tuple[Number, Number, Number]:
    """Derivatives (3,) of the twist by eta, on which w and two limits depend."""
    (zeta, epsilon, eta), w = at.indices, at.kinematic.w
    zeta_within, epsilon_within, _ = at.within_limits
    w_by_eta, half_gauge = -w / eta, 0.5 * gauge
    epsilon_by_eta = (1.0 - epsilon_within) * sign(epsilon) * (1.0 - CLOSEST) * half_gauge
    zeta_by_eta = (1.0 - zeta_within) * sign(zeta) * 2.0 * half_gauge
    return w_by_eta * zeta + w * zeta_by_eta, -w_by_eta * epsilon - w * epsilon_by_eta, w_by_eta


def _by_parameters(
    zeta: Number, epsilon: Number, eta: Number, gains: tuple[Number, Number, Number, Number]
) -> tuple[Number, ...]:
    """Derivatives (9,) of a component of the twist by the parameters.

    Given are those by zeta, epsilon and eta. That by H is zero. The gains are derivatives: zeta by zeta1,
    epsilon by epsilon1 (and eta by eta1), eta by eta2, and epsilon by epsilon_F.
    """
    zeta_by_zeta1, S, S_squared, signed_P = gains
    return (
        0.0 * zeta,
        zeta,
        zeta * zeta_by_zeta1,
        epsilon,
        epsilon * S,
        eta,
        eta * S,
        eta * S_squared,
        epsilon * signed_P,
    )


def limited(value: Number, limit: Number) -> tuple[Number, Number]:
    """Value limited to ±limit, and its derivative: 1 where it is within, else 0."""
    is_above = at_or_above(abs(value.real) - limit.real, 0.0)
    return (1.0 - is_above) * value + is_above * sign(value) * limit, 1.0 - is_above


def _sigma(V: Number) -> tuple[Number, Number]:
    """Sign of a track's speed, smooth at standstill, and its derivative [s/m]."""
    share, is_slow = limited(V / ROLLS_AT, 1.0)
    return share, is_slow / ROLLS_AT
