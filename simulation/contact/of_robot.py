"""Contact of a robot with its usual ground, and warnings about its file."""

import numpy as np

from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.motion.icr import IndexValues, icrs_from_twist, indices_from_icrs
from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.contact.contact import Body, Contact, equally_spaced
from icreckon.simulation.contact.steady_state import solve_steady

# Slow turns to both sides, with negligible inertia: speeds (left, right) in multiples of CRAWL [m/s].
TURNS = np.array([[1.0, 2.0], [2.0, 1.0], [1.0, 1.3], [1.3, 1.0]])
CRAWL = 0.05
FRICTION = "friction"  # name of the truth in which the contact moves the robot
# A warning is given if the eta0 of the file and of its contact differ by more than this factor [-].
LARGEST_ETA_RATIO = 1.15


def contact_of(robot: Robot) -> Contact:
    """Contact of the tracks with the robot's usual ground.

    Raises:
        EstimatorError: the centre of mass does not lie over the contact, or below the ground.
    """
    vehicle = robot.vehicle
    try:
        geometry = equally_spaced(
            vehicle.track_gauge, vehicle.half_contact_length, vehicle.contact_points
        )
        body = Body(vehicle.mass, *robot.centre_of_mass_paper, vehicle.centre_of_mass[2])
        return Contact(robot.soil, geometry, body)
    except ValueError as error:
        raise EstimatorError(
            f"{robot.name}: no contact with the ground: {error}; correct [vehicle], or simulate with "
            'truth = "kinematic"'
        ) from error


def slow_turns(contact: Contact) -> IndexValues:
    """Indices, (4,) each, of slow stationary turns, wide and narrow, to both sides."""
    V_l, V_r = CRAWL * TURNS.T
    # Not strict: an inexact index still serves for a warning, which must not stop a run.
    twist = solve_steady(V_l, V_r, contact, strict=False).twist
    return indices_from_icrs(icrs_from_twist(V_l, V_r, twist), contact.geometry.gauge)


def robot_remarks(robot: Robot, truth: str) -> list[str]:
    """Return warnings about a robot file that makes friction simulations misleading.

    Such a file has a centre of mass without height, or an eta0 far from that of its contact. `truth` is
    the name of the scenario's truth; only `FRICTION` has warnings.
    """
    if truth != FRICTION:
        return []
    warnings = []
    if robot.vehicle.centre_of_mass[2] == 0.0:
        warnings.append(
            f"{robot.name}: the centre of mass is on the ground, so no load shifts in bends and the ICRs "
            "hardly move with inertia; set its height, the third number of centre_of_mass in [vehicle]"
        )
    eta_of_contact = float(np.mean(slow_turns(contact_of(robot)).eta))
    eta0_of_file = robot.constant_indices.eta0
    if not 1.0 / LARGEST_ETA_RATIO < eta_of_contact / eta0_of_file < LARGEST_ETA_RATIO:
        warnings.append(
            f"{robot.name}: its contact turns it with an effective track of {eta_of_contact:.2f} times "
            f"the gauge, its file states {eta0_of_file:.2f}, where the filters begin; set eta0 = "
            f"{eta_of_contact:.2f} in [indices], or calibrate on simulated logs"
        )
    return warnings
