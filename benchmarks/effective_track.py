"""Effective track over gauge (eta) of each robot: what friction says of its contact, and its robot file.

Friction gives eta of slow turns from the place of the wheels or tracks alone, whatever the coefficient.
The robot files have it from logs of the real robots or from their controllers.
"""

from __future__ import annotations

import numpy as np
from _study import table

from icreckon.estimator.robot.robot_file import Robot, load_robot, robot_names
from icreckon.simulation.contact.of_robot import contact_of, slow_turns


def row_of(robot: Robot) -> tuple[str, ...]:
    """A row of the table."""
    of_contact = float(np.mean(slow_turns(contact_of(robot)).eta))
    return (robot.name, f"{of_contact:.3f}", f"{robot.constant_indices.eta0:.3f}")


def main() -> None:
    """Print the table."""
    robots = [load_robot(name) for name in robot_names()]
    known = [robot for robot in robots if robot.constant_indices.eta0 > 1.0]
    table(("robot", "friction", "robot file"), map(row_of, known))


if __name__ == "__main__":
    main()
