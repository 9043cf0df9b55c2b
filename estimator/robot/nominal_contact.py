"""Nominal contact of the friction model, for a robot on unknown ground."""

from __future__ import annotations

from functools import lru_cache

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.contact import Contact, Soil
from icreckon.estimator.motion.icr import GRAVITY, IndexValues
from icreckon.estimator.motion.steady_state import solve_steady
from icreckon.estimator.robot.robot_file import Robot

# Slow turns to both sides, tracks left and right as shares of the crawl [m/s]: inertia is negligible.
TURNS = np.array([[1.0, 2.0], [2.0, 1.0], [1.0, 1.3], [1.3, 1.0]])
CRAWL = 0.05
# Bounds of the search for the contact's half length, as shares of the robot file's value.
SHORTEST, LONGEST = 0.5, 2.0
# Bound of the centre of mass in that search, as a share of half the extent.
OFF_CENTRE = 0.7
# Distance of a track from its ICR, as a share of half the contact's length: beyond this range it shows
# ground that is not Coulomb's.
LEAST_AWAY, MOST_AWAY = 0.5, 1.5


def presumed_contact(robot: Robot) -> Contact:
    """Initial contact of the friction model.

    It is the robot file's if that describes the ground (`[soil]`). Otherwise length and centre of mass
    are chosen such that slow turns have the robot's constant ICRs: ICRs are measured, lengths and weights
    of a robot file mostly are not.

    Raises:
        EstimatorError: the centre of mass does not lie over the contact.
    """
    known = robot.constant_indices
    if robot.soil is not None or known.eta0 <= 1.0:
        return robot.contact
    return _with_slow_turns(robot.contact, known.zeta0, known.epsilon0, known.eta0)


def slow_turns(contact: Contact) -> IndexValues:
    """Indices, (4,) each, of slow stationary turns, wide and narrow, to both sides."""
    V_l, V_r = CRAWL * TURNS.T
    twist = solve_steady(V_l, V_r, contact, strict=False).twist
    return IndexValues(
        twist.v_x / twist.w,
        (0.5 * (V_l + V_r) - twist.v_y) / twist.w,
        (V_r - V_l) / (contact.geometry.gauge * twist.w),
    )


@lru_cache(maxsize=32)
def _with_slow_turns(contact: Contact, zeta: float, epsilon: float, eta: float) -> Contact:
    """Contact with length and centre of mass such that slow turns have these indices."""
    from scipy.optimize import least_squares

    geometry, body = contact.geometry, contact.body
    half_gauge, half_length = 0.5 * geometry.gauge, geometry.positions[-1]

    def of(shares: Floats) -> Contact:
        stretch, right, forward = (float(share) for share in shares)
        return Contact(
            contact.soil,
            msgspec.structs.replace(
                geometry, positions=tuple(stretch * at for at in geometry.positions)
            ),
            msgspec.structs.replace(
                body, x_CM=right * half_gauge, y_CM=forward * stretch * half_length
            ),
        )

    def short_of(shares: Floats) -> Floats:
        found = slow_turns(of(shares))
        lengths = (half_gauge * found.eta, found.epsilon, found.zeta)
        return np.asarray(np.mean(lengths, axis=1) - [half_gauge * eta, epsilon, zeta])

    low = np.array([SHORTEST, -OFF_CENTRE, -OFF_CENTRE])
    high = np.array([LONGEST, OFF_CENTRE, OFF_CENTRE])
    start = np.array([1.0, body.x_CM / half_gauge, body.y_CM / half_length])
    start = np.clip(start, low + 1e-3, high - 1e-3)
    return of(least_squares(short_of, start, bounds=(low, high), diff_step=1e-4).x)


def coulomb_gains(robot: Robot) -> tuple[float, float]:
    """Gains zeta1 [m/N] and epsilon_F [m] of Coulomb friction at the contact points.

    In a turn a contact point at y along a track, whose ICR is a away from it, slides in proportion to
    (a, y). All points together push with the shares mean(a / r) and mean(y / r) of their friction along
    and across the track, r² = a² + y². A force along the tracks, as a share of the weight, shifts a by
    1 / (mu mean(y² / r³)); one across them, in N, shifts y_ICR by 1 / (mu M g mean(a² / r³)).

    Both are zero if nothing is known of the robot's slip: eta0 is 1 then.
    """
    if robot.constant_indices.eta0 <= 1.0:
        return 0.0, 0.0
    vehicle, soil = robot.vehicle, robot.soil
    friction = Soil().friction if soil is None else soil.friction
    half = vehicle.half_contact_length
    y = np.linspace(-half, half, vehicle.contact_points)
    away = 0.5 * (robot.constant_indices.eta0 - 1.0) * vehicle.track_gauge
    a = min(max(away, LEAST_AWAY * half), MOST_AWAY * half)
    cube = (a * a + y * y) ** 1.5
    across, along = float(np.mean(a * a / cube)), float(np.mean(y * y / cube))
    return 1.0 / (friction * vehicle.mass * GRAVITY * across), 1.0 / (friction * along)
