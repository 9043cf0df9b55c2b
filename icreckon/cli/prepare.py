"""`icreckon prepare`: compile ahead, so that nothing waits for the compiler later."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import msgspec

from icreckon.cli.console import messages, progress
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.batch.replay import run_side_by_side
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.tracing.kernel_cache import cache_folder, keeps_kernels
from icreckon.simulation.running import batch_engine
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import load_study, study_names

# Kernels depend on the motion model and on what is uncertain, not on the robot.
ROBOT = "auriga-alpha"
SECONDS = 5.0


def run_prepare() -> None:
    """Compile all filters; the body of `icreckon prepare`."""
    if not keeps_kernels():
        raise EstimatorError(
            f"{cache_folder()} cannot be written, so nothing that is compiled would be kept; set "
            "NUMBA_CACHE_DIR to a folder that can"
        )
    robot = load_robot(ROBOT)
    steps: list[tuple[str, Callable[[], object]]] = [
        (f"{name}, streaming", partial(PoseEstimator, robot, name)) for name in VARIANTS
    ]
    steps += [(f"{name}, long logs", partial(_long_log, name)) for name in VARIANTS]
    steps += [(f"study {name}", partial(_study, name)) for name in study_names()]
    with progress("compiling") as report:
        for number, (title, compile_step) in enumerate(steps):
            messages().print(f"compiling {title}", markup=False)
            compile_step()
            report((number + 1) / len(steps))
    files = [path for path in cache_folder().rglob("*.kernel") if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    messages().print(
        f"ready: {len(files)} compiled functions, {size / 1e6:.0f} MB in {cache_folder()}",
        markup=False,
        soft_wrap=True,
    )


def _long_log(variant: str) -> None:
    robot = load_robot(ROBOT)
    run_side_by_side(simulate(Scenario(duration=SECONDS, fix_rate=1.0), robot), robot, [variant])


def _study(name: str) -> None:
    """Run the first seconds of each cell: the shapes of filters differ between cells."""
    for cell in expand(load_study(name)).cells:
        short = msgspec.structs.replace(cell.scenario, duration=SECONDS, outages=())
        batch_engine.block(replace(cell, scenario=short), cell.filters, 0, 1)
