"""Drift against constant ICRs, scenario by scenario, with friction as the truth.

Each run lasts 300 s, with a position fix each second for the first 100 s and none after that; every
variant has its default tuning, the same measurements, and the robot file; robots, drives and noise are
drawn anew for each run, from a seed that is used for no tuning. Drift is the mean position error after
30 s without fixes, % of the distance. Ratios are of the means over the same runs to `constant-online`,
with 95 % bootstrap intervals.

In the last scenarios the truth has friction that is weaker along the track, and friction that builds up
with shear.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from _study import bootstrap, drift_and_nees, spread, study_parser, table, told

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.streaming.run import run
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import Patch

SEED = 31_337
DURATION, FIXES_END = 300.0, 100.0
BASELINE = "constant-online"
VARIANTS = ("gyro", BASELINE, "inertia-online")
# Grass, gravel and a slippery stretch in turn, 20 s each.
TERRAIN = tuple(
    Patch(time=(20.0 * k, 20.0 * (k + 1)), friction=friction, rolling_resistance=rolling)
    for k, (friction, rolling) in enumerate(((0.9, 0.07), (0.6, 0.03), (0.4, 0.1)) * 5)
)


@dataclass(frozen=True)
class Conditions:
    """What is driven, and what differs from the robot file in soil and terrain.

    Attributes:
        trajectory: what is driven.
        soil: what replaces figures of `[soil]`.
        patches: terrain along the way.
        in_file: whether the filter's robot file has these figures, too.
    """

    trajectory: str = "random"
    soil: dict[str, Any] = field(default_factory=dict)
    patches: tuple[Patch, ...] = ()
    in_file: bool = False


SCENARIOS = {
    "everyday": Conditions(),
    "aggressive": Conditions("aggressive"),
    "everyday, no rolling resistance": Conditions(soil={"rolling_resistance": 0.0}, in_file=True),
    "aggressive, no rolling resistance": Conditions(
        "aggressive", soil={"rolling_resistance": 0.0}, in_file=True
    ),
    "everyday, slippery (friction 0.4)": Conditions(soil={"friction": 0.4}, in_file=True),
    "everyday, heavy (rolling resistance 0.12)": Conditions(
        soil={"rolling_resistance": 0.12}, in_file=True
    ),
    "everyday, changing ground": Conditions(patches=TERRAIN),
    "unlike: friction 0.7 along the track": Conditions(soil={"longitudinal_friction": 0.7}),
    "unlike: shear modulus 2 mm": Conditions(soil={"shear_modulus": 0.002}),
}
Job = tuple[str, str, int]


def true_robot(robot: Robot, conditions: Conditions) -> Robot:
    """The robot file of what is simulated."""
    soil = msgspec.structs.replace(contact_of(robot).soil, **conditions.soil)
    return msgspec.structs.replace(robot, soil=soil)


def score(job: Job) -> Floats:
    """Drift [%] and pose NEES of one run."""
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
    found = run(log, true if conditions.in_file else robot, variant)
    return np.array(drift_and_nees(found.trajectory, log))


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 20, VARIANTS)
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS))
    arguments = parser.parse_args()
    variants = list(dict.fromkeys([*arguments.variants, BASELINE]))
    cells = [(name, variant) for name in arguments.scenarios for variant in variants]
    jobs = [(*cell, index) for cell in cells for index in range(arguments.runs)]
    found = np.array(spread(score, jobs, arguments.workers))
    found = found.reshape(len(arguments.scenarios), len(variants), arguments.runs, 2)
    print(f"{arguments.runs} runs of {DURATION:.0f} s for each row\n")
    rows = []
    for name, of_scenario in zip(arguments.scenarios, found, strict=True):
        baseline = of_scenario[variants.index(BASELINE)]
        for variant, scores in zip(variants, of_scenario, strict=True):
            row = [name, f"`{variant}`", told(*bootstrap(_mean, scores[:, :1]))]
            pairs = np.stack([scores[:, 0], baseline[:, 0]], axis=-1)
            row.append("1" if variant == BASELINE else told(*bootstrap(_ratio, pairs)))
            rows.append([*row, f"{scores[:, 1].mean():.1f}"])
    table(("scenario", "variant", "drift 30 s, %", "drift ratio", "pose NEES (3)"), rows)


def _mean(samples: Floats) -> Floats:
    return np.asarray(samples[..., 0].mean(axis=-1))


def _ratio(samples: Floats) -> Floats:
    return np.asarray(samples[..., 0].mean(axis=-1) / samples[..., 1].mean(axis=-1))


if __name__ == "__main__":
    main()
