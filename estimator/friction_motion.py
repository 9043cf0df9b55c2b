"""The friction index model: the indices of the friction solution, with offsets and gains.

    w   = D / (L eta) + r_w          D = V_r - V_l,  V_m = (V_l + V_r) / 2
    v_y = V_m - D / (L eta) epsilon + r_y
    v_x =       D / (L eta) zeta + r_x
    zeta = zeta0 + zeta1 dzeta(V)    epsilon = epsilon0 + epsilon1 depsilon(V)
    eta = max(1, eta0 + eta1 deta(V))

where d...(V) is what `estimator.friction_map` says at these track speeds, less its reference. With gains
of 1 and offsets at the reference this is the friction solution itself. The gains are shares of it [-]; H
and eta2 have no part. The model is explicit, and since the table goes by the track speeds, slip does not
change the indices.

Symbols and axes are the paper's (see `kinematics`). Arguments broadcast; floats give floats, and complex
numbers pass through, for complex-step differentiation, and numba compiles the same functions, see
`estimator.motion_model`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from estimator.friction_map import FrictionMap, Table, look_up
from estimator.kinematics import (
    GRAVITY,
    IndexValues,
    Number,
    PaperTwist,
    direct,
    signed_inertia,
)
from estimator.motion_model import (
    Channels,
    Motion,
    Regressors,
    TwistDerivatives,
    Unremembering,
    VehicleConstants,
    at_or_above,
    sign,
    through_channels,
)


@dataclass(frozen=True)
class FrictionMotion(Unremembering):
    """The friction index model of one vehicle on its ground."""

    vehicle: VehicleConstants
    map: FrictionMap

    def linearise(
        self, V_l: Number, V_r: Number, parameters: Any, slip: tuple[Number, Number, Number]
    ) -> tuple[Motion, TwistDerivatives]:
        """See `MotionModel`; `u` is the smooth signed inertia of the twist."""
        table, reference = self.map.table, self.map.reference
        return linearise(V_l, V_r, parameters, slip, self.vehicle, table, reference)


def linearise(
    V_l: Number,
    V_r: Number,
    parameters: Any,
    slip: tuple[Number, Number, Number],
    vehicle: VehicleConstants,
    table: Table,
    reference: IndexValues,
) -> tuple[Motion, TwistDerivatives]:
    """See `FrictionMotion.linearise`."""
    _, zeta0, zeta1, epsilon0, epsilon1, eta0, eta1, _ = parameters
    gauge, mass, x_CM, _ = vehicle
    at = look_up(table, V_l, V_r)
    d_zeta = at.indices.zeta - reference.zeta
    d_epsilon = at.indices.epsilon - reference.epsilon
    d_eta = at.indices.eta - reference.eta
    eta_free = eta0 + eta1 * d_eta
    is_free = at_or_above(eta_free, 1.0)
    zeta, epsilon = zeta0 + zeta1 * d_zeta, epsilon0 + epsilon1 * d_epsilon
    eta = is_free * eta_free + (1.0 - is_free)
    indices = IndexValues(zeta, epsilon, eta)
    v_x, v_y, w = direct(V_l, V_r, indices, gauge)
    twist = PaperTwist(v_x + slip[0], v_y + slip[1], w + slip[2])
    u, _ = signed_inertia(twist, mass, x_CM)
    weight = mass * GRAVITY
    is_above = at_or_above(abs(u.real), weight)
    force = (1.0 - is_above) * u + is_above * sign(u) * weight
    motion = Motion(twist, indices, u, force)

    per_eta = -is_free * w / eta
    by_eta = (per_eta * zeta, -per_eta * epsilon, per_eta)
    per_D = 1.0 / (gauge * eta)
    gains = IndexValues(w * zeta1, w * epsilon1, eta1)
    by = Channels(
        _total((zeta * per_D, -epsilon * per_D, per_D), at.by_D, gains, by_eta),
        _total((0.0, 1.0, 0.0), at.by_V_m, gains, by_eta),
        (w, 0.0, 0.0),
        (0.0, -w, 0.0),
        by_eta,
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    return motion, through_channels(by, Regressors(d_zeta, d_epsilon, d_eta, 0.0 * d_eta))


def _total(
    direct_by: tuple[Number, Number, Number],
    by: IndexValues,
    gains: IndexValues,
    by_eta: tuple[Number, Number, Number],
) -> tuple[Number, Number, Number]:
    """The twist by a track speed: at fixed indices, and through them."""
    of_eta = gains.eta * by.eta
    return (
        direct_by[0] + gains.zeta * by.zeta + by_eta[0] * of_eta,
        direct_by[1] - gains.epsilon * by.epsilon + by_eta[1] * of_eta,
        direct_by[2] + by_eta[2] * of_eta,
    )
