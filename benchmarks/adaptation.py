"""How soon the filter has adapted when ground or load change under way; friction is the truth.

Everyday driving for 160 s with a position fix each second. At 60 s the ground gets slippery (friction
0.4 instead of 0.92), or soft (rolling resistance 0.15 instead of 0.054), or a load of 80 kg is put on
the rear, 0.3 m behind the middle. Each second the parameters of the filter are tried out: the motion
over the next 5 s by its kinematics alone, at the true track speeds, against the true motion. Every run
is paired with one of the same drive, robot and noise in which it has been so from the start: adapted is
who predicts as well as there. The error is the mean over the runs; it counts as adapted when its mean
over 5 s is within 1.2 times that of the other, for 10 s. `-fixed` variants show what it is worth to
adapt, `--walk` what it takes. Intervals are 95 % bootstrap intervals over the runs.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from _friction import ONLINE, seconds_to_return, smooth, told_seconds, true_poses
from _study import bootstrap, spread, study_parser, table, told

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import compose, relative
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.motion.propagation import step_on_se2
from icreckon.estimator.reference.ekf import IcrEkf
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import DEFAULT_ADAPTATION, find_variant, motion_model
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.run import run
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import Patch, Payload

SEED = 20_245
CHANGE, DURATION = 60, 160
AHEAD, STEP = 5.0, 0.1
# Time before a prediction in which forces build up [s].
BEFORE = 1.0
BACK = 1.2
LAST = float("inf")
RESAMPLES = 500
Job = tuple[str, str, int, float | None]


def changed(name: str, since: float) -> dict[str, Any]:
    """What a scenario must say for a change from a time [s] on."""
    span = (since, LAST)
    match name:
        case "slippery":
            return {"patches": (Patch(time=span, friction=0.4),)}
        case "soft":
            return {"patches": (Patch(time=span, rolling_resistance=0.15),)}
        case _:
            load = Payload(time=span, mass=80.0, position=(-0.3, 0.0, 0.4))
            return {"payloads": (load,)}


CHANGES = ("slippery", "soft", "loaded")


def prediction_errors(result: Run, log: Log, robot: Robot, variant: str) -> Floats:
    """(n,) how far the filter's kinematics are from the true motion after `AHEAD` s [m], each second."""
    if log.truth is None or log.truth.tracks is None:
        raise ValueError("a simulated log has a truth with track speeds")
    poses, tracks = true_poses(log), log.truth.tracks
    second = round(1.0 / NANOSECOND)
    starts = log.start + np.arange(1, DURATION - int(AHEAD)) * second
    ends = starts + int(AHEAD * second)
    true_motion = relative(interpolate_poses(poses, starts), interpolate_poses(poses, ends))
    rows = np.searchsorted(result.stamps, starts).clip(0, len(result.stamps) - 1)
    errors = []
    for start, row, motion in zip(starts, rows, true_motion, strict=True):
        # A new one, since a motion model may remember.
        ekf = IcrEkf(motion_model(robot, find_variant(variant)))
        ekf.x[s.PARAMETERS] = result.states[row, s.PARAMETERS]
        steps = np.arange(-int(BEFORE / STEP), int(AHEAD / STEP))
        at = start + ((steps + 0.5) * STEP * second).astype(np.int64)
        speeds = [np.interp(at - start, tracks.stamps - start, one) for one in tracks.speeds.T]
        pose = np.zeros(3)
        for k, left, right in zip(steps, *(one.tolist() for one in speeds), strict=True):
            ekf.begin_step(STEP, left, right)
            if k < 0:
                continue
            pose = compose(pose, step_on_se2(0.0, ekf.twist_model(left, right).twist * STEP)[0])
        errors.append(np.hypot(*(pose - motion)[:2]))
    return np.array(errors)


def score(job: Job) -> Floats:
    """(2, n) prediction errors of a run where it has always been so, and of one where it changes."""
    name, variant, index, walk = job
    robot = load_robot("auriga-alpha")
    settings = None if walk is None else walking(variant, walk)
    found = []
    for since in (-LAST if name != "loaded" else -1.0, float(CHANGE)):
        scenario = Scenario(
            duration=float(DURATION), seed=SEED, truth_rate=10.0, **changed(name, since)
        )
        log = simulate(scenario, robot, run_index=index)
        found.append(
            prediction_errors(run(log, robot, variant, settings=settings), log, robot, variant)
        )
    return np.array(found)


def walking(variant: str, walk: float) -> Settings:
    """Settings with another random walk of the parameters [1/√s]."""
    default = DEFAULT_ADAPTATION[find_variant(variant).model]
    return Settings(adaptation=msgspec.structs.replace(default, walk=walk))


def seconds_to_adapt(found: Floats) -> float:
    """Seconds from the change until the mean error over runs (n, 2, seconds) is as in the others."""
    mean = smooth(found.mean(axis=0)[:, CHANGE - 1 :])
    return seconds_to_return(mean[1], BACK * mean[0])


def change_row(name: str, variant: str, found: Floats) -> list[str]:
    """A row of the table, of runs (n, 2, seconds)."""
    cells = [name, f"`{variant}`"]
    for first, last in ((0, 10), (10, 40), (40, 90)):
        part = found[:, :, CHANGE - 1 + first : CHANGE - 1 + last].mean(axis=-1)
        cells.append(told(*bootstrap(lambda x: x[..., 1].mean(-1) / x[..., 0].mean(-1), part)))
    settled = found[:, 0, CHANGE - 1 :].mean(axis=-1)
    picks = np.random.default_rng(0).integers(0, len(found), (RESAMPLES, len(found)))
    times = [seconds_to_adapt(found[pick]) for pick in picks]
    low, high = np.percentile(times, (2.5, 97.5), method="nearest")
    adapted = told_seconds(np.array([seconds_to_adapt(found), low, high]))
    return [*cells, adapted, f"{100.0 * settled.mean():.0f}"]


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 8, (*ONLINE, "constant-fixed"))
    parser.add_argument("--changes", nargs="+", choices=CHANGES, default=list(CHANGES))
    parser.add_argument("--walk", type=float, help="of the parameters, the default if left out")
    arguments = parser.parse_args()
    cells = [(name, variant) for name in arguments.changes for variant in arguments.variants]
    jobs = [(*cell, index, arguments.walk) for cell in cells for index in range(arguments.runs)]
    scores = np.array(spread(score, jobs, arguments.workers))
    scores = scores.reshape(len(cells), arguments.runs, *scores.shape[1:])
    print(f"{arguments.runs} pairs of runs of {DURATION} s for each row\n")
    head = ("change", "variant", "error over adapted, 0 to 10 s", "10 to 40 s", "40 to 90 s")
    table(
        (*head, "adapted after, s", "adapted: error after 5 s, cm"),
        [change_row(*cell, found) for cell, found in zip(cells, scores, strict=True)],
    )


if __name__ == "__main__":
    main()
