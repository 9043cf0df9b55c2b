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
numbers pass through, for complex-step differentiation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from estimator.friction_map import FrictionMap
from estimator.kinematics import (
    GRAVITY,
    IndexValues,
    Number,
    PaperTwist,
    direct,
    signed_inertia,
)
from estimator.motion import Channels, Motion, Regressors, VehicleConstants


@dataclass(frozen=True)
class FrictionMotion:
    """The friction index model of one vehicle on its ground."""

    vehicle: VehicleConstants
    map: FrictionMap

    def linearise(
        self, V_l: Number, V_r: Number, parameters: Any, slip: tuple[Number, Number, Number]
    ) -> tuple[Motion, Channels]:
        """See `estimator.motion.MotionModel`; `u` is the smooth signed inertia of the twist."""
        _, zeta0, zeta1, epsilon0, epsilon1, eta0, eta1, _ = parameters
        gauge, mass, x_CM, _ = self.vehicle
        at, reference = self.map.at(V_l, V_r), self.map.reference
        d_zeta, d_epsilon, d_eta = (
            value - middle for value, middle in zip(at.indices, reference, strict=True)
        )
        eta_free = eta0 + eta1 * d_eta
        is_free = 1.0 * (eta_free.real >= 1.0)
        zeta, epsilon = zeta0 + zeta1 * d_zeta, epsilon0 + epsilon1 * d_epsilon
        eta = is_free * eta_free + (1.0 - is_free)
        indices = IndexValues(zeta, epsilon, eta)
        v_x, v_y, w = direct(V_l, V_r, indices, gauge)
        twist = PaperTwist(v_x + slip[0], v_y + slip[1], w + slip[2])
        u, _ = signed_inertia(twist, mass, x_CM)
        weight = mass * GRAVITY
        within = 1.0 * (abs(u.real) < weight)
        force = within * u + (1.0 - within) * weight * ((u.real > 0.0) * 2.0 - 1.0)
        motion = Motion(twist, indices, u, force, Regressors(d_zeta, d_epsilon, d_eta, 0.0 * d_eta))

        per_eta = -is_free * w / eta
        by_eta = (per_eta * zeta, -per_eta * epsilon, per_eta)

        def total(direct_x: Number, direct_y: Number, direct_w: Number, by: IndexValues) -> Any:
            """Twist by a track speed: at fixed indices, and through them."""
            of_eta = eta1 * by.eta
            return (
                direct_x + w * zeta1 * by.zeta + by_eta[0] * of_eta,
                direct_y - w * epsilon1 * by.epsilon + by_eta[1] * of_eta,
                direct_w + by_eta[2] * of_eta,
            )

        per_D = 1.0 / (gauge * eta)
        return motion, Channels(
            D=total(zeta * per_D, -epsilon * per_D, per_D, at.by_D),
            V_m=total(0.0, 1.0, 0.0, at.by_V_m),
            zeta=(w, 0.0, 0.0),
            epsilon=(0.0, -w, 0.0),
            eta=by_eta,
            r_x=(1.0, 0.0, 0.0),
            r_y=(0.0, 1.0, 0.0),
            r_w=(0.0, 0.0, 1.0),
        )
