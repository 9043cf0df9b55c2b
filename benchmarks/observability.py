"""What each manoeuvre shows with which sensors: rank, condition number, and what cannot be told.

Computed from the filter's own Jacobians along each manoeuvre (`analysis.observability`); no noise is
drawn, so there is no interval. Each manoeuvre lasts 60 s (the drives of `simulation.drives.trajectories`
without their first standstill), random everyday driving is one fixed seed. Sensors are the robot
file's, position fixes (0.05 m) and pose fixes (and 0.02 rad) come each second, body velocities (0.05
m/s) ten times a second. States are in units of what is not known of them at the start: 1 m and 1 rad of
the pose, 0.1 of H, 1 % of the scales, and the variant's and the robot file's standard deviations for
the rest.

The second table is for the practice: the share of that which is left after the manoeuvre, with slip as
the filter expects it.
"""

from __future__ import annotations

import argparse

import numpy as np
from _study import table
from analysis.linearised import Sensors
from analysis.observability import Observability, observe

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.simulation.drives.smooth_speeds import STANDSTILL
from icreckon.simulation.drives.trajectories import make_trajectory

SEED = 20_241
SECONDS, RATE = 60.0, 20.0
# After the standstill and the ramp that begin every trajectory [s].
BEGIN = STANDSTILL + 2.0
ALONE = Sensors()
GYRO = Sensors(gyro=True)
IMU = Sensors(gyro=True, accelerometer=True)
SENSOR_SETS = {
    "tracks": ALONE,
    "+ gyro": GYRO,
    "+ gyro, accelerometer": IMU,
    "+ IMU, position fixes": Sensors(gyro=True, accelerometer=True, position_sigma=0.05),
    "+ IMU, pose fixes": Sensors(
        gyro=True, accelerometer=True, position_sigma=0.05, heading_sigma=0.02
    ),
    "+ IMU, body velocity": Sensors(gyro=True, accelerometer=True, velocity_sigma=0.05),
}
DRIVES = ("circle", "slalom", "figure-eight", "spin", "random")


def manoeuvres(robot: Robot) -> dict[str, Floats]:
    """Track speeds (n, 2) of each manoeuvre, at `RATE`."""
    count = int(SECONDS * RATE)
    times = np.arange(count) / RATE
    top = robot.vehicle.max_track_speed
    found = {
        "standstill": np.zeros((count, 2)),
        "straight": np.full((count, 2), 0.5 * top),
        "straight, accelerating": np.tile(
            (0.5 + 0.3 * np.sin(2.0 * np.pi * 0.1 * times))[:, None] * top, 2
        ),
    }
    for name in DRIVES:
        rng = np.random.default_rng(SEED)
        found[name] = make_trajectory(name, SECONDS + BEGIN, robot, rng)(BEGIN + times)
    return found


def rank_row(manoeuvre: str, sensors: str, seen: Observability) -> list[str]:
    """A row of the first table."""
    condition = "" if np.isnan(seen.condition) else f"{seen.condition:.1g}"
    return [manoeuvre, sensors, f"{seen.rank} of {len(seen.states)}", condition, in_words(seen)]


def in_words(seen: Observability) -> str:
    """What cannot be told."""
    names = seen.unobservable_names
    alone = [name for name in names if name in seen.states]
    if len(alone) == len(names) > len(seen.states) // 2:
        rest = [f"`{name}`" for name in seen.states if name not in alone]
        return "all but " + ", ".join(rest) if rest else "all"
    parts = [" ".join(f"`{w}`" if w in seen.states else w for w in one.split()) for one in names]
    return "; ".join(parts) if parts else "none"


def left_row(manoeuvre: str, sensors: str, seen: Observability, states: list[str]) -> list[str]:
    """A row of the second table."""
    cells = [f"{seen.left_of(name):.2f}" if name in seen.states else "" for name in states]
    return [manoeuvre, sensors, *cells]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", default="auriga-alpha")
    parser.add_argument("--variants", nargs="+", default=["inertia-online"])
    arguments = parser.parse_args()
    robot = load_robot(arguments.robot)
    for variant in arguments.variants:
        seen = {
            (manoeuvre, name): observe(robot, variant, speeds, 1.0 / RATE, sensors)
            for manoeuvre, speeds in manoeuvres(robot).items()
            for name, sensors in SENSOR_SETS.items()
        }
        print(f"`{variant}`\n")
        table(
            ("manoeuvre", "sensors", "rank", "condition", "cannot be told"),
            [rank_row(*key, one) for key, one in seen.items()],
        )
        last = seen["random", "+ IMU, body velocity"].states
        states = [name for name in last if name not in ("x", "y", "yaw", "H")]
        print()
        table(
            ("manoeuvre", "sensors", *(f"`{name}`" for name in states)),
            [
                left_row(*key, one, states)
                for key, one in seen.items()
                if key[1] not in ("tracks", "+ gyro")
            ],
        )
        print()


if __name__ == "__main__":
    main()
