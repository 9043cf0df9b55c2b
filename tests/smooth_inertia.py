"""Equations of the paper against which the motion models are tested: (11), and (25) to (27) smooth."""

from typing import Any

import numpy as np

from icreckon.estimator.motion.icr import (
    IndexValues,
    Number,
    PaperTwist,
    inertial_force,
    velocity_of_centre_of_mass,
)


def signed_inertia(twist: PaperTwist, mass: Number, x_CM: Number) -> tuple[Number, Number]:
    """Smooth approximations of |F| sign(x_1) sign(x_2) and |F| sign(x_2) [N].

    They are -M w (v_y + x_CM w) and M |w| (v_y + x_CM w): the lateral force of inertia with the signs
    of (25) to (27), without their jumps at x_1 = 0 and x_2 = 0 and without H.
    """
    _, forward = velocity_of_centre_of_mass(twist, x_CM, 0.0)
    return -mass * twist.w * forward, mass * abs(twist.w) * forward


def indices_at_signed_inertia(signed: Number, directed: Number, parameters: Any) -> IndexValues:
    """Indices at the smooth signed inertia, (25) to (27).

    `signed_inertia` replaces |F| sign().
    """
    _, zeta0, zeta1, epsilon0, epsilon1, eta0, eta1, eta2 = parameters[:8]
    return IndexValues(
        zeta0 + zeta1 * directed,
        epsilon0 + epsilon1 * signed,
        eta0 + eta1 * signed + eta2 * signed**2,
    )


def inertial_force_magnitude(twist: PaperTwist, mass: Number, x_CM: Number, y_CM: Number) -> Number:
    """Magnitude of the force of inertia [N], equation (11)."""
    right, forward = inertial_force(twist, mass, x_CM, y_CM)
    return np.hypot(right, forward)
