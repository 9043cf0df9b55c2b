"""A process that shares a compile cache with others: does some tasks in order, prints a digest of each.

Run as `python cache_worker.py TASK...`; what a task computes does not depend on what was done before.
"""

import hashlib
import sys

import numpy as np

from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.streaming.run import run
from icreckon.simulation.running import batch_engine as study_batch
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import Study

# Fixes that come between IMU samples, fixes at IMU samples, and none: other kernels for each.
FIXES = {"between": 3.0, "at": 1.0, "none": 0.0}


def study(variant: str, fixes: str) -> bytes:
    scenario = Scenario(duration=6.0, truth_rate=10.0, fix_rate=FIXES[fixes], truth="kinematic")
    made = Study(name="cache", scenario=scenario, variants=(variant,), runs=2, truths=1, seed=4)
    cell = expand(made).cells[0]
    found = study_batch.block(cell, cell.filters, 0, 2)
    return b"".join(scores.values.tobytes() for scores in found.values())


def recorded() -> Log:
    return simulate(
        Scenario(duration=6.0, fix_rate=1.0, seed=7, truth="kinematic"), load_robot("auriga-alpha")
    )


def replay(variant: str) -> bytes:
    found = run_side_by_side(recorded(), load_robot("auriga-alpha"), [variant])[variant]
    return np.ascontiguousarray(found.states).tobytes()


def stream(variant: str) -> bytes:
    found = run(recorded(), load_robot("auriga-alpha"), variant)
    return np.ascontiguousarray(found.states).tobytes()


TASKS = {"study": study, "replay": replay, "stream": stream}

if __name__ == "__main__":
    for text in sys.argv[1:]:
        kind, *arguments = text.split(":")
        digest = hashlib.sha256(TASKS[kind](*arguments)).hexdigest()
        sys.stdout.write(f"{text} {digest}\n")
