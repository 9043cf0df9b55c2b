"""Compilation ahead, in processes: each compiles one function at a time."""

from collections.abc import Iterable

from icreckon.estimator.base.worker_processes import worker_processes
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.streaming.run import run
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

# Kernels depend on the motion model and on what is uncertain, not on the robot.
ROBOT, SECONDS = "auriga-alpha", 5.0


def by_model(names: Iterable[str]) -> list[list[str]]:
    """Names of variants in groups that share what a streaming filter compiles."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(find_variant(name).model, []).append(name)
    return [*groups.values()]


def compile_streaming(names: Iterable[str]) -> None:
    """Compile what streaming filters of these variants need."""
    robot = load_robot(ROBOT)
    # Of the truths, the one that compiles nearly nothing.
    scenario = Scenario(duration=SECONDS, fix_rate=1.0, truth="kinematic")
    for name in names:
        run(simulate(scenario, robot), robot, name)


def compile_side_by_side(names: Iterable[str], workers: int) -> None:
    """Compile what streaming filters of these variants need, in processes."""
    groups = by_model(names)
    with worker_processes(min(workers, len(groups))) as pool:
        for _ in pool.map(compile_streaming, groups):
            pass
