"""How many constant hard turns do not settle, for several lags of the load transfer.

Auriga-alpha starts from rest and is driven at constant track speeds for 20 s; a turn has not settled
where the twist still varies by more than 1 mm/s (mrad/s, standard deviation) in the last 3 s.
"""

from __future__ import annotations

import numpy as np

from icreckon.estimator.robot.robot_file import LOAD_LAG, load_robot
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.drives.smooth_speeds import Blends
from icreckon.simulation.truth.friction import TRACK_LAG, drive, follow

RATE, SECONDS, LAST, SETTLED = 100.0, 20.0, 3.0, 1e-3
LAGS = (0.05, 0.1, 0.15, LOAD_LAG, 0.3)
TURNS = (
    (-0.4, 0.6),
    (-0.67, 1.0),
    (-1.0, 0.67),
    (1.0, -1.0),
    (-0.3, 0.3),
    (0.0, 1.0),
    (0.2, 1.0),
    (1.0, 0.2),
    (0.5, 1.0),
    (-1.0, -0.2),
    (-0.2, -1.0),
    (-0.5, 1.0),
    (1.0, 0.0),
)


def main() -> None:
    """Print a line for each lag."""
    robot = load_robot("auriga-alpha")
    times = np.arange(int(SECONDS * RATE) + 1) / RATE
    for lag in LAGS:
        unsettled = []
        for turn in TURNS:
            command = Blends(np.array([1.0]), np.array([1.9]), np.array([turn]))
            speeds, rates = follow(command(times), 1.0 / RATE, TRACK_LAG)
            driven = drive(
                contact_of(robot), robot.yaw_inertia, speeds, rates, 1.0 / RATE, load_lag=lag
            )
            if driven.twists[-int(LAST * RATE) :].std(axis=0).max() > SETTLED:
                unsettled.append(turn)
        print(f"lag {lag:.2f} s: {len(unsettled)} of {len(TURNS)} turns do not settle {unsettled}")


if __name__ == "__main__":
    main()
