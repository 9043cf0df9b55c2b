"""Kinematics of tracked vehicles by ICRs and inertia: equations (1) to (30).

Symbols and axes are the paper's: X right, Y forward, Z up, origin at the centre of the tracks' contact
area. So `v_x` is the lateral and `v_y` the longitudinal velocity, in this folder only. Every function is
plain arithmetic: its arguments broadcast, and floats give floats.

Source: "Inertia-based ICR Kinematic Model for Tracked Skid-Steer Robots"; the constant-ICR model is
that of Martinez et al., "Approximating kinematics for tracked mobile robots", IJRR 24(10), 2005.
"""

from typing import Any, NamedTuple

import numpy as np

GRAVITY = 9.81  # m/s²

Number = Any  # a float, a complex number or an array of either


class Icrs(NamedTuple):
    """Instantaneous centres of rotation of the tracks in the paper's axes [m]."""

    x_ICRl: Number
    x_ICRr: Number
    y_ICR: Number


class IndexValues(NamedTuple):
    """Sliding index zeta [m], eccentricity epsilon [m], steering efficiency eta [-]."""

    zeta: Number
    epsilon: Number
    eta: Number


class PaperTwist(NamedTuple):
    """Velocity of the origin in paper axes: v_x right, v_y forward [m/s], w [rad/s]."""

    v_x: Number
    v_y: Number
    w: Number


def icrs_from_twist(V_l: Number, V_r: Number, twist: PaperTwist) -> Icrs:
    """ICRs of the tracks from track speeds [m/s] and twist, equations (1) to (3).

    At w = 0 they lie at infinity: a float argument raises ZeroDivisionError, an array gives inf or nan.
    """
    return Icrs((V_l - twist.v_y) / twist.w, (V_r - twist.v_y) / twist.w, twist.v_x / twist.w)


def velocity_of_centre_of_mass(
    twist: PaperTwist, x_CM: Number, y_CM: Number
) -> tuple[Number, Number]:
    """Velocity of the centre of mass (right, forward) [m/s], equation (9)."""
    return twist.v_x - y_CM * twist.w, twist.v_y + x_CM * twist.w


def inertial_force(
    twist: PaperTwist, mass: Number, x_CM: Number, y_CM: Number
) -> tuple[Number, Number]:
    """Force of inertia in steady motion (right, forward) [N], equation (10).

    The force is -M w x v_CM; the paper's first component, M w (v_y + x_CM w), and its second,
    M w (-v_x + y_CM w), follow from (4) and (9).
    """
    right, forward = velocity_of_centre_of_mass(twist, x_CM, y_CM)
    return mass * twist.w * forward, -mass * twist.w * right


def symmetry_coordinates(V_l: Number, V_r: Number, H: Number) -> tuple[Number, Number]:
    """x_1, zero in straight motion, and x_2, zero in on-spot turns [m/s], (14), (15)."""
    return V_l - V_r, V_l + H * V_r


def indices_from_icrs(icrs: Icrs, gauge: Number) -> IndexValues:
    """Indices from ICRs, equations (17) to (19); `gauge` is L [m]."""
    epsilon, eta = 0.5 * (icrs.x_ICRr + icrs.x_ICRl), (icrs.x_ICRr - icrs.x_ICRl) / gauge
    return IndexValues(icrs.y_ICR, epsilon, eta)


def icrs_from_indices(indices: IndexValues, gauge: Number) -> Icrs:
    """ICRs from indices, equations (28) to (30); `gauge` is L [m]."""
    half = 0.5 * gauge * indices.eta
    return Icrs(indices.epsilon - half, indices.epsilon + half, indices.zeta)


def direct(V_l: Number, V_r: Number, indices: IndexValues, gauge: Number) -> PaperTwist:
    """Twist from track speeds [m/s] and indices, equations (20) to (22)."""
    w = (V_r - V_l) / (gauge * indices.eta)
    return PaperTwist(w * indices.zeta, 0.5 * (V_l + V_r) - w * indices.epsilon, w)


def inverse(v_y: Number, w: Number, indices: IndexValues, gauge: Number) -> tuple[Number, Number]:
    """Track speeds V_l, V_r [m/s] for a forward velocity and yaw rate, (23) and (24)."""
    half = 0.5 * gauge * indices.eta
    return v_y + w * (indices.epsilon - half), v_y + w * (indices.epsilon + half)


def indices_at_inertia(force: Number, x_1: Number, x_2: Number, parameters: Any) -> IndexValues:
    """Indices at a measured force of inertia, equations (25) to (27), literally.

    Args:
        force: magnitude of the force of inertia |F| [N].
        x_1: V_l - V_r [m/s], only its sign counts.
        x_2: V_l + H V_r [m/s], only its sign counts.
        parameters: eight index parameters, in the order of `icreckon.estimator.robot.robot_file.Indices`.
    """
    _, zeta0, zeta1, epsilon0, epsilon1, eta0, eta1, eta2 = parameters[:8]
    signed = force * np.sign(x_1) * np.sign(x_2)
    return IndexValues(
        zeta0 + zeta1 * force * np.sign(x_2),
        epsilon0 + epsilon1 * signed,
        eta0 + eta1 * signed + eta2 * force**2,
    )
