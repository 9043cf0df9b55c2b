"""Effective track over gauge (eta) of each robot: what friction says of its contact, and its robot file.

Friction gives eta of slow turns from the place of the wheels or tracks alone, whatever the coefficient.
The robot files have it from logs of the real robots or from their controllers. The last column is half
the contact's length for which friction would give that, beside that of the robot file [m].
"""

from __future__ import annotations

import numpy as np
from _study import table

from icreckon.estimator.robot.nominal_contact import presumed_contact, slow_turns
from icreckon.estimator.robot.robot_file import Robot, load_robot, robot_names


def row_of(robot: Robot) -> tuple[str, ...]:
    """A row of the table."""
    of_contact = float(np.mean(slow_turns(robot.contact).eta))
    presumed = presumed_contact(robot).geometry.positions[-1]
    return (
        robot.name,
        f"{of_contact:.3f}",
        f"{robot.constant_indices.eta0:.3f}",
        f"{presumed:.3f}, {robot.vehicle.half_contact_length:.3f}",
    )


def main() -> None:
    """Print the table."""
    robots = [load_robot(name) for name in robot_names()]
    known = [robot for robot in robots if robot.constant_indices.eta0 > 1.0]
    table(("robot", "friction", "robot file", "half length"), map(row_of, known))


if __name__ == "__main__":
    main()
