"""Drift and velocity errors against constant ICRs, scenario by scenario, with friction as the truth.

Each run lasts 300 s, with a position fix each second for the first 100 s and none after that; every
variant has its default tuning, the same measurements, and the robot file; robots, drives and noise are
drawn anew for each run, from a seed that is used for no tuning. Drift is the mean position error after
30 s without fixes, % of the distance; RMSE that of the filter's twist without fixes, of v_x, v_y and w in
the paper's axes, as in its Table II. Ratios are of the means over the same runs to `constant-online`,
with 95 % bootstrap intervals.

In the last scenarios the truth has other contact points, friction that is weaker along the track,
friction that builds up with shear, and loads that follow faster or slower.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from _friction import fixes_of, true_poses
from _study import bootstrap, spread, study_parser, table, told

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.log.scores import drift, pose_nees, velocity_errors, without_fixes
from icreckon.estimator.robot.robot_file import Robot, Slope, load_robot
from icreckon.estimator.streaming.run import run
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import Patch

SEED = 31_337
DURATION, FIXES_END = 300.0, 100.0
BASELINE = "constant-online"
VARIANTS = ("gyro", BASELINE, "full-linear", "inertia-online")
PARTS = ("v_x", "v_y", "w")
# Grass, gravel and a slippery stretch in turn, 20 s each.
TERRAIN = tuple(
    Patch(time=(20.0 * k, 20.0 * (k + 1)), friction=friction, rolling_resistance=rolling)
    for k, (friction, rolling) in enumerate(((0.9, 0.07), (0.6, 0.03), (0.4, 0.1)) * 5)
)


@dataclass(frozen=True)
class Conditions:
    """What is driven, and what differs from the robot file in soil, vehicle and terrain.

    Attributes:
        trajectory: what is driven.
        soil: what replaces figures of `[soil]`.
        vehicle: what replaces figures of `[vehicle]`.
        patches: terrain along the way.
        in_file: whether the filter's robot file has these figures, too.
        level: whether the filter's robot file says that the ground is level (`[slope] sigma = 0`).
    """

    trajectory: str = "random"
    soil: dict[str, Any] = field(default_factory=dict)
    vehicle: dict[str, Any] = field(default_factory=dict)
    patches: tuple[Patch, ...] = ()
    in_file: bool = False
    level: bool = False


SCENARIOS = {
    "everyday": Conditions(),
    "aggressive": Conditions("aggressive"),
    "aggressive, known to be level": Conditions("aggressive", level=True),
    "everyday, no rolling resistance": Conditions(soil={"rolling_resistance": 0.0}, in_file=True),
    "aggressive, no rolling resistance": Conditions(
        "aggressive", soil={"rolling_resistance": 0.0}, in_file=True
    ),
    "everyday, slippery (friction 0.4)": Conditions(soil={"friction": 0.4}, in_file=True),
    "everyday, heavy (rolling resistance 0.12)": Conditions(
        soil={"rolling_resistance": 0.12}, in_file=True
    ),
    "everyday, changing ground": Conditions(patches=TERRAIN),
    "unlike: 9 contact points": Conditions(vehicle={"contact_points": 9}),
    "unlike: friction 0.7 along the track": Conditions(soil={"longitudinal_friction": 0.7}),
    "unlike: shear modulus 2 mm": Conditions(soil={"shear_modulus": 0.002}),
    "unlike: load lag 0.15 s, aggressive": Conditions("aggressive", vehicle={"load_lag": 0.15}),
    "unlike: load lag 0.4 s, aggressive": Conditions("aggressive", vehicle={"load_lag": 0.4}),
}
Job = tuple[str, str, int]


def true_robot(robot: Robot, conditions: Conditions) -> Robot:
    """The robot file of what is simulated."""
    return msgspec.structs.replace(
        robot,
        soil=msgspec.structs.replace(contact_of(robot).soil, **conditions.soil),
        vehicle=msgspec.structs.replace(robot.vehicle, **conditions.vehicle),
    )


def score(job: Job) -> Floats:
    """Drift [%], RMSE of v_x, v_y [m/s] and w [rad/s], and pose NEES of one run."""
    name, variant, index = job
    conditions = SCENARIOS[name]
    robot = load_robot("auriga-alpha")
    true = true_robot(robot, conditions)
    scenario = Scenario(
        trajectory=conditions.trajectory,
        duration=DURATION,
        seed=SEED,
        outages=((FIXES_END, DURATION),),
        patches=conditions.patches,
    )
    log = simulate(scenario, true, run_index=index)
    own = true if conditions.in_file else robot
    if conditions.level:
        own = msgspec.structs.replace(own, slope=Slope(sigma=0.0, walk=0.0))
    result = run(log, own, variant)
    poses, fixes = true_poses(log), fixes_of(log)
    free = without_fixes(fixes.stamps, log.start, log.end, 10.0)
    drifted = drift(result.trajectory.pose_series, poses, 30.0, within=free)
    stamps = log.truth.twists.stamps
    after = stamps >= log.start + round(FIXES_END / NANOSECOND)
    errors = velocity_errors(result.trajectory, log.truth)
    rmse = np.sqrt((errors[after[-len(errors) :]] ** 2).mean(axis=0))[[1, 0, 2]]
    nees = pose_nees(result.trajectory, poses)
    return np.array([drifted.percent_mean, *rmse, float(np.mean(nees))])


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 20, VARIANTS)
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS))
    arguments = parser.parse_args()
    variants = list(dict.fromkeys([*arguments.variants, BASELINE]))
    cells = [(name, variant) for name in arguments.scenarios for variant in variants]
    jobs = [(*cell, index) for cell in cells for index in range(arguments.runs)]
    found = np.array(spread(score, jobs, arguments.workers))
    found = found.reshape(len(arguments.scenarios), len(variants), arguments.runs, 5)
    print(f"{arguments.runs} runs of {DURATION:.0f} s for each row\n")
    rows = []
    for name, of_scenario in zip(arguments.scenarios, found, strict=True):
        baseline = of_scenario[variants.index(BASELINE)]
        for variant, scores in zip(variants, of_scenario, strict=True):
            row = [name, f"`{variant}`", told(*bootstrap(_mean, scores[:, :1]))]
            for part in range(4):
                pairs = np.stack([scores[:, part], baseline[:, part]], axis=-1)
                row.append("1" if variant == BASELINE else told(*bootstrap(_ratio, pairs)))
            rows.append([*row, f"{scores[:, 4].mean():.1f}"])
    heads = [f"{part} RMSE ratio" for part in PARTS]
    table(("scenario", "variant", "drift 30 s, %", "drift ratio", *heads, "pose NEES (3)"), rows)


def _mean(samples: Floats) -> Floats:
    return np.asarray(samples[..., 0].mean(axis=-1))


def _ratio(samples: Floats) -> Floats:
    return np.asarray(samples[..., 0].mean(axis=-1) / samples[..., 1].mean(axis=-1))


if __name__ == "__main__":
    main()
