"""Contact of a robot with its usual ground, and the indices of its slow turns."""

import numpy as np

from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.motion.icr import IndexValues
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.soil import Soil
from icreckon.simulation.contact.contact import Body, Contact, equally_spaced
from icreckon.simulation.contact.steady_state import solve_steady

# Slow turns to both sides, tracks left and right as shares of the crawl [m/s]: inertia is negligible.
TURNS = np.array([[1.0, 2.0], [2.0, 1.0], [1.0, 1.3], [1.3, 1.0]])
CRAWL = 0.05


def contact_of(robot: Robot) -> Contact:
    """Contact of the tracks with the robot's usual ground, `Soil()` if unknown.

    Raises:
        EstimatorError: the centre of mass does not lie over the contact, or below the ground.
    """
    vehicle = robot.vehicle
    try:
        return Contact(
            Soil() if robot.soil is None else robot.soil,
            equally_spaced(
                vehicle.track_gauge, vehicle.half_contact_length, vehicle.contact_points
            ),
            Body(vehicle.mass, *robot.centre_of_mass_paper, vehicle.centre_of_mass[2]),
        )
    except ValueError as error:
        raise EstimatorError(
            f"{robot.name}: no contact with the ground: {error}; correct [vehicle], or simulate with "
            'truth = "kinematic"'
        ) from error


def slow_turns(contact: Contact) -> IndexValues:
    """Indices, (4,) each, of slow stationary turns, wide and narrow, to both sides."""
    V_l, V_r = CRAWL * TURNS.T
    twist = solve_steady(V_l, V_r, contact, strict=False).twist
    return IndexValues(
        twist.v_x / twist.w,
        (0.5 * (V_l + V_r) - twist.v_y) / twist.w,
        (V_r - V_l) / (contact.geometry.gauge * twist.w),
    )
