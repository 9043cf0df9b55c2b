"""Gains by Coulomb friction, for a robot file that has none."""

from __future__ import annotations

import numpy as np

from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import Robot, Soil

# Distance of a track from its ICR, as a share of half the contact's length: beyond this range it shows
# ground that is not Coulomb's.
LEAST_AWAY, MOST_AWAY = 0.5, 1.5


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
