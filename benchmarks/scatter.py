"""Position fixes that scatter more than stated: pose with their covariance believed, and measured.

    python benchmarks/scatter.py [--runs N] [--variants NAMES]

Everyday driving of 300 s with friction as truth, from a known pose. Fixes state a sigma; their errors are
white, or wander as a first-order Gauss-Markov process with a time of 60 s. Each drive is replayed twice:
with the covariance that the fixes state, and with the scatter that the filter measures by default.

NEES of the pose (ideal 3), and RMS errors of position and yaw, from 60 s on, of each run; means over the
runs with 95 % bootstrap intervals. `used`: share of fixes that were used with more than they state.

The second table counts false alarms: drives of 120 s on several grounds whose fixes are as they state,
and that are used with more all the same; with the robot file of the robot, and with one whose effective
track is 1.4 times as large. Position error from 30 s on (RMS), believed and measured, of those drives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from unittest.mock import patch

import msgspec
import numpy as np
from _study import bootstrap, spread, study_parser, table, told
from wander import DURATION, SETTLED, mean_of_runs, pose_scores

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.faults import scattering_fixes
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.streaming.run import run
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import FixSpec
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import Patch, Terrain

SEED = 20_262
# Stated sigma, white noise, wander [m], and rate [Hz].
FIXES = {
    "0.05 m, true": (0.05, 0.05, 0.0, 1.0),
    "0.05 m, white 0.15 m": (0.05, 0.15, 0.0, 1.0),
    "0.05 m, white 0.5 m": (0.05, 0.5, 0.0, 1.0),
    "0.05 m, white 0.5 m, 5 Hz": (0.05, 0.5, 0.0, 5.0),
    "0.05 m, wanders 1.2 m": (0.05, 0.05, 1.2, 1.0),
    "0.05 m, wanders 5 m": (0.05, 0.05, 5.0, 1.0),
    "0.05 m, wanders 5 m, 5 Hz": (0.05, 0.05, 5.0, 5.0),
    "1 m, wanders 5 m": (1.0, 1.0, 5.0, 1.0),
}
VARIANTS = ("gyro", "constant-online", "inertia-online")
SLOPE = Terrain(slope_deg=8.0, uphill_deg=30.0)
CHANGING = tuple(
    Patch(time=(20.0 * k, 20.0 * (k + 1)), friction=friction, rolling_resistance=rolling)
    for k, (friction, rolling) in enumerate(2 * ((0.9, 0.07), (0.6, 0.03), (0.4, 0.1)))
)
HONEST = Scenario(duration=120.0, seed=SEED, fixes=FixSpec(sigma=0.05))
GROUNDS = {
    "everyday": HONEST,
    "aggressive": msgspec.structs.replace(HONEST, trajectory="aggressive"),
    "slope of 8 deg": msgspec.structs.replace(HONEST, terrain=SLOPE),
    "slope of 8 deg, aggressive": msgspec.structs.replace(
        HONEST, terrain=SLOPE, trajectory="aggressive"
    ),
    "changes every 20 s": msgspec.structs.replace(HONEST, patches=CHANGING),
}
TOO_WIDE = 1.4
Job = tuple[str, int, str]


def score(job: Job) -> Floats:
    """Rows believed and measured: NEES, errors of position [m] and yaw [deg], share of fixes [%]."""
    variant, index, name = job
    stated, white, wander, rate = FIXES[name]
    robot = load_robot("auriga-alpha")
    errors = FixSpec(sigma=white, wander_sigma=wander, wander_time=60.0)
    scenario = Scenario(duration=DURATION, seed=SEED, fix_rate=rate, fixes=errors)
    log = simulate(scenario, robot, run_index=index)
    if log.fixes is None or log.truth is None:
        raise ValueError("a simulated log has fixes and a truth")
    fixes = replace(log.fixes, variances=np.full_like(log.fixes.variances, stated**2))
    log = replace(log, fixes=fixes)
    rows = []
    for least in (math.inf, scattering_fixes.FOUND):
        with patch.object(scattering_fixes, "FOUND", least):
            found = run(log, robot, variant)
        share = 100.0 * found.health.scatter.used / len(fixes.stamps)
        rows.append([*pose_scores(found.trajectory, log), share])
    return np.array(rows)


def honest(job: tuple[str, int, str, bool]) -> list[float]:
    """Fixes used with more than they state, and RMS errors of position, believed and measured [m]."""
    variant, index, ground, fits = job
    robot = load_robot("auriga-alpha")
    log = simulate(GROUNDS[ground], robot, run_index=index)
    if not fits:
        wide = msgspec.structs.replace(robot.indices, eta0=TOO_WIDE * robot.indices.eta0)
        robot = msgspec.structs.replace(robot, constant_icr=None, indices=wide)
    if log.truth is None:
        raise ValueError("a simulated log has a truth")
    errors = []
    for least in (math.inf, scattering_fixes.FOUND):
        with patch.object(scattering_fixes, "FOUND", least):
            found = run(log, robot, variant)
        off = found.trajectory.poses - interpolate_poses(log.truth.poses, found.stamps)
        late = found.stamps > log.start + 30_000_000_000
        errors.append(float(np.sqrt((off[late, :2] ** 2).sum(axis=1).mean())))
    return [float(found.health.scatter.used), *errors]


def false_alarms(variants: Sequence[str], runs: range, workers: int) -> None:
    """Print the second table."""
    places = [(ground, fits) for ground in GROUNDS for fits in (True, False)]
    jobs = [(name, index, *place) for place in places for name in variants for index in runs]
    found = np.array(spread(honest, jobs, workers)).reshape(len(places), -1, 3)
    rows = []
    for (ground, fits), of_place in zip(places, found, strict=True):
        hit = of_place[of_place[:, 0] > 0.0]
        errors = ["–", "–"]
        if len(hit):
            errors = [f"{error:.2f}" for error in np.sqrt((hit[:, 1:] ** 2).mean(axis=0))]
        file = "right" if fits else f"effective track times {TOO_WIDE}"
        rows.append([ground, file, f"{len(hit)} of {len(of_place)}", *errors])
    print()
    table(("ground", "robot file", "found", "position believed, m", "measured"), rows)


def main() -> None:
    """Print the table."""
    arguments = study_parser(__doc__, 12, VARIANTS).parse_args()
    runs = range(arguments.runs)
    jobs = [(name, index, case) for name in arguments.variants for case in FIXES for index in runs]
    found = np.array(spread(score, jobs, arguments.workers))
    found = found.reshape(len(arguments.variants), len(FIXES), len(runs), 2, 4)
    print(f"{len(runs)} runs of {DURATION:.0f} s, scored from {SETTLED:.0f} s on\n")
    rows = []
    for variant, of_variant in zip(arguments.variants, found, strict=True):
        for case, of_case in zip(FIXES, of_variant, strict=True):
            scores = [
                told(*bootstrap(mean_of_runs, of_case[:, number, [column]]), form)
                for column, form in ((0, ".1f"), (1, ".2f"), (2, ".1f"))
                for number in range(2)
            ]
            used = f"{of_case[:, 1, 3].mean():.0f} %"
            rows.append([f"`{variant}`", case, *scores, used])
    heads = ("NEES believed", "measured", "position believed, m", "measured")
    heads = (*heads, "yaw believed, deg", "measured", "used")
    table(("variant", "sigma stated, errors", *heads), rows)
    false_alarms(arguments.variants, runs, arguments.workers)


if __name__ == "__main__":
    main()
