"""`icreckon prepare`: compile ahead, so that nothing waits for the compiler later."""

from collections.abc import Iterable
from concurrent.futures import as_completed
from dataclasses import replace
from typing import Annotated

import msgspec
from typer import Option

from icreckon.cli.common.compiling import SECONDS, by_model, compile_streaming
from icreckon.cli.common.console import progress, say, worker_count
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.worker_processes import worker_processes
from icreckon.estimator.robot.variants import VARIANTS
from icreckon.estimator.tracing.kernel_cache import cache_folder, kernel_files, why_not_kept
from icreckon.simulation.contact.of_robot import robot_remarks
from icreckon.simulation.running import batch_engine
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import load_study, study_names

MOST_WORKERS = 4  # each process takes up to half a gigabyte: unasked, no more than these


def command(
    workers: Annotated[
        int | None, Option(min=1, help="Processes (default: as cores, 4 at most).")
    ] = None,
) -> None:
    """Compile all filters ahead, for an image or a first drive.

    What is compiled is kept for all later processes of this version, in $NUMBA_CACHE_DIR/icreckon or
    the user's cache folder.
    """
    if why_not_kept():
        raise EstimatorError(
            f"{cache_folder()} cannot be written, so nothing that is compiled would be kept; set "
            "NUMBA_CACHE_DIR to a folder that can"
        )
    # First those that compile most: one of streaming, one of studies.
    streams = [("streaming", compile_streaming, names) for names in reversed(by_model(VARIANTS))]
    studies = [("study", _run_study, [name]) for name in study_names()]
    tasks = [streams[0], *studies, *streams[1:]]
    count = min(workers or min(worker_count(None), MOST_WORKERS), len(tasks))
    say(f"compiling with {count} processes")
    with progress("compiling") as report, worker_processes(count) as pool:
        submitted = {pool.submit(task, names): (kind, names) for kind, task, names in tasks}
        for number, done in enumerate(as_completed(submitted), start=1):
            done.result()
            kind, names = submitted[done]
            say(f"compiled for {kind}: {', '.join(names)}")
            report(number / len(tasks))
    files = kernel_files()
    size = sum(path.stat().st_size for path in files)
    say(f"ready: {len(files)} compiled functions, {size / 1e6:.0f} MB in {cache_folder()}")


def _run_study(names: Iterable[str]) -> None:
    """Run the first seconds of each cell: the shapes of filters differ between cells."""
    (name,) = names
    cells = expand(load_study(name)).cells
    robot_remarks(cells[0].robot, cells[0].scenario.truth)
    for cell in cells:
        short = msgspec.structs.replace(cell.scenario, duration=SECONDS, outages=())
        batch_engine.block(replace(cell, scenario=short), cell.filters, 0, 1)
