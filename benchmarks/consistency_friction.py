"""Is the filter as sure as it may be where friction is the truth? Pose NEES by conditions.

Default tuning throughout. Each run lasts 120 s, with a position fix each second for the first 60 s
(NEES from 10 s on) and none after that; ideal is 3, and the goal is from 1.5 to 6. Drives, robots and
noise are drawn anew for each run, from a seed that is used for no tuning. With another class of IMU the
robot file has that class' data sheet.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
from _study import mean_interval, spread, study_parser, table, told

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.streaming.run import run
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import noise_preset
from icreckon.simulation.simulate import simulate

SEED = 20_243
FIXES_END, DURATION, SETTLED = 60, 120, 10
VARIANTS = ("constant-online", "inertia-online")


class Condition(NamedTuple):
    """What is driven, on what ground, with what IMU."""

    trajectory: str = "random"
    rolling_resistance: float | None = None
    noise: str = "nominal"


CONDITIONS = {
    "everyday": Condition(),
    "everyday, no rolling resistance": Condition(rolling_resistance=0.0),
    "aggressive": Condition("aggressive"),
    "aggressive, no rolling resistance": Condition("aggressive", 0.0),
    "everyday, consumer IMU": Condition(noise="consumer"),
    "everyday, industrial IMU": Condition(noise="industrial"),
    "everyday, tactical IMU": Condition(noise="tactical"),
}
Job = tuple[str, str, int]


def robot_of(condition: Condition) -> Robot:
    """The robot, with the ground of a condition and the data sheet of its IMU."""
    robot = load_robot("auriga-alpha")
    if condition.rolling_resistance is not None:
        soil = msgspec.structs.replace(
            contact_of(robot).soil, rolling_resistance=condition.rolling_resistance
        )
        robot = msgspec.structs.replace(robot, soil=soil)
    preset = noise_preset(condition.noise)
    figures = {
        f"{sensor}_{name}": getattr(spec, name)
        for sensor, spec in (("gyro", preset.gyro), ("accelerometer", preset.accelerometer))
        for name in ("noise_density", "bias_sigma", "bias_walk")
        if getattr(spec, name) is not None
    }
    if preset.gyro.scale_sigma is not None:
        figures["gyro_scale_sigma"] = preset.gyro.scale_sigma
    return msgspec.structs.replace(robot, imu=msgspec.structs.replace(robot.imu, **figures))


def score(job: Job) -> Floats:
    """Mean pose NEES of one run with fixes, and after them."""
    name, variant, index = job
    condition = CONDITIONS[name]
    robot = robot_of(condition)
    scenario = Scenario(
        trajectory=condition.trajectory,
        noise=condition.noise,
        duration=float(DURATION),
        seed=SEED,
        truth_rate=5.0,
        outages=((float(FIXES_END), float(DURATION)),),
    )
    log = simulate(scenario, robot, run_index=index)
    nees = nees_each_second(run(log, robot, variant).trajectory, log)
    return np.array([nees[SETTLED:FIXES_END].mean(), np.nanmean(nees[FIXES_END:])])


def nees_each_second(found: Trajectory, log: Log) -> Floats:
    """Pose NEES (n,) at whole seconds; NaN before the first estimate, or with a singular covariance."""
    if log.truth is None:
        raise ValueError(f"log {log.name!r} has no truth")
    stamps = log.start + np.arange(DURATION + 1) * round(1.0 / NANOSECOND)
    at = np.searchsorted(found.stamps, stamps).clip(0, len(found.stamps) - 1)
    truth = interpolate_poses(log.truth.poses, stamps)
    errors = interpolate_poses(found.pose_series, stamps) - truth
    errors[:, 2] = wrap_angle(errors[:, 2])
    covariances = found.pose_covariances[at]
    nees = np.full(len(stamps), np.nan)
    regular = np.linalg.eigvalsh(covariances)[:, 0] > 1e-12
    solved = np.linalg.solve(covariances[regular], errors[regular][..., None])[..., 0]
    nees[regular] = np.einsum("ij,ij->i", errors[regular], solved)
    nees[stamps < found.stamps[0]] = np.nan
    return nees


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 12, VARIANTS)
    parser.add_argument("--conditions", nargs="+", choices=CONDITIONS, default=list(CONDITIONS))
    arguments = parser.parse_args()
    cells = [(name, variant) for name in arguments.conditions for variant in arguments.variants]
    jobs = [(*cell, index) for cell in cells for index in range(arguments.runs)]
    scores = np.array(spread(score, jobs, arguments.workers)).reshape(len(cells), arguments.runs, 2)
    print(f"{arguments.runs} runs of {DURATION} s for each row\n")
    rows = [
        [name, f"`{variant}`", *(told(*mean_interval(part), ".1f") for part in found.T)]
        for (name, variant), found in zip(cells, scores, strict=True)
    ]
    table(("conditions", "variant", "with fixes (95 %)", "without fixes (95 %)"), rows)


if __name__ == "__main__":
    main()
