"""Remarks on a robot file that leaves out what simulated friction needs."""

import numpy as np

from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.contact.of_robot import contact_of, slow_turns

FRICTION = "friction"
"""Name of the truth in which the contact moves the robot."""
FAR = 1.15
"""Factor between the effective tracks of the file and of its contact that is remarked on [-]."""


def robot_remarks(robot: Robot, truth: str) -> list[str]:
    """Describe what a robot file leaves out, so that simulations with it mislead.

    Args:
        robot: the robot.
        truth: name of the scenario's truth.
    """
    if truth != FRICTION:
        return []
    found = []
    if robot.vehicle.centre_of_mass[2] == 0.0:
        found.append(
            f"{robot.name}: the centre of mass is on the ground, so no load shifts in bends and the ICRs "
            "hardly move with inertia; set its height, the third number of centre_of_mass in [vehicle]"
        )
    contact = float(np.mean(slow_turns(contact_of(robot)).eta))
    stated = robot.constant_indices.eta0
    if not 1.0 / FAR < contact / stated < FAR:
        found.append(
            f"{robot.name}: its contact turns it with an effective track of {contact:.2f} times the "
            f"gauge, its file states {stated:.2f}, where the filters begin; set eta0 = "
            f"{contact:.2f} in [indices], or calibrate on simulated logs"
        )
    return found
