"""Plain GPS: fixes whose error wanders, treated as white noise and as what it is.

    python benchmarks/wander.py [--runs N] [--variants NAMES]

Everyday driving of 300 s with friction as truth; position fixes at 5 Hz with white noise of 0.3 m in each
coordinate and a first-order Gauss-Markov process of 1.2 m and 60 s. The filters treat them

- as white noise of 0.3 m, which is what the fixes differ by from one to the next,
- as white noise of the whole size, 1.24 m,
- as what they are: `wander_sigma = 1.2`, `wander_time = 60`,
- as that with half and with twice the size, and with half and with twice the time.

NEES of the pose (ideal 3), and RMS errors of position and yaw, from 60 s on, of each run; means over the
runs with 95 % bootstrap intervals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from _study import bootstrap, spread, study_parser, table, told

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses, pose_nees
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import FixWander, Settings
from icreckon.estimator.streaming.run import run
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import FixSpec
from icreckon.simulation.simulate import simulate

SEED, DURATION, SETTLED, RATE = 20_261, 300.0, 60.0, 5.0
WHITE, WANDER, TIME = 0.3, 1.2, 60.0
# What the filter assumes: white noise [m], wander [m], its correlation time [s].
TREATMENTS = {
    "white, 0.3 m": (WHITE, 0.0, 0.0),
    "white, 1.24 m": (float(np.hypot(WHITE, WANDER)), 0.0, 0.0),
    "wander": (WHITE, WANDER, TIME),
    "wander, half the size": (WHITE, 0.5 * WANDER, TIME),
    "wander, twice the size": (WHITE, 2.0 * WANDER, TIME),
    "wander, half the time": (WHITE, WANDER, 0.5 * TIME),
    "wander, twice the time": (WHITE, WANDER, 2.0 * TIME),
}
VARIANTS = ("gyro", "constant-online", "inertia-online")
Job = tuple[str, int]


def score(job: Job) -> Floats:
    """NEES, position error [m] and yaw error [deg] of each treatment in one run."""
    variant, index = job
    robot = load_robot("auriga-alpha")
    errors = FixSpec(sigma=WHITE, wander_sigma=WANDER, wander_time=TIME)
    scenario = Scenario(duration=DURATION, seed=SEED, fix_rate=RATE, fixes=errors)
    log = simulate(scenario, robot, run_index=index)
    if log.fixes is None or log.truth is None:
        raise ValueError("a simulated log has fixes and a truth")
    rows = []
    for white, sigma, correlated in TREATMENTS.values():
        fixes = replace(log.fixes, variances=np.full_like(log.fixes.variances, white**2))
        settings = Settings(wander=FixWander(sigma, correlated))
        found = run(replace(log, fixes=fixes), robot, variant, settings=settings)
        rows.append(pose_scores(found.trajectory, log))
    return np.array(rows)


def pose_scores(found: Trajectory, log: Log) -> list[float]:
    """NEES of the pose, RMS errors of position [m] and yaw [deg], from `SETTLED` on."""
    if log.truth is None:
        raise ValueError("a simulated log has a truth")
    truth = log.truth.poses
    settled = found.stamps > log.start + round(SETTLED * 1e9)
    off = found.poses[settled] - interpolate_poses(truth, found.stamps[settled])
    nees = pose_nees(found, truth)
    return [
        float(nees[round(len(nees) * SETTLED / DURATION) :].mean()),
        float(np.sqrt(np.mean(off[:, :2] ** 2) * 2.0)),
        float(np.degrees(np.sqrt(np.mean(wrap_angle(off[:, 2]) ** 2)))),
    ]


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 25, VARIANTS)
    arguments = parser.parse_args()
    jobs = [(name, index) for name in arguments.variants for index in range(arguments.runs)]
    found = np.array(spread(score, jobs, arguments.workers))
    found = found.reshape(len(arguments.variants), arguments.runs, len(TREATMENTS), 3)
    print(f"{arguments.runs} runs of {DURATION:.0f} s, {RATE:g} fixes a second\n")
    rows = []
    for variant, of_variant in zip(arguments.variants, found, strict=True):
        for number, name in enumerate(TREATMENTS):
            scores = [
                told(*bootstrap(mean_of_runs, of_variant[:, number, [column]]), form)
                for column, form in ((0, ".1f"), (1, ".2f"), (2, ".2f"))
            ]
            rows.append([f"`{variant}`", name, *scores])
    heads = ("NEES, ideal 3", "position, m", "yaw, deg")
    table(("variant", "fixes taken for", *heads), rows)


def mean_of_runs(samples: Floats) -> Floats:
    """Mean over the runs (..., n, 1)."""
    return np.asarray(samples[..., 0].mean(axis=-1))


if __name__ == "__main__":
    main()
