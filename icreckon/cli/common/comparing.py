"""Steps of several commands: load the robot, read a log, compare, report."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from icreckon.cli.common.compiling import compile_side_by_side
from icreckon.cli.common.console import progress, worker_count, working
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, load_robot, robot_names
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.tracing.kernel_cache import kernel_files, warn_unless_kept
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.comparison.compare import DEFAULT_VARIANTS, compare
from icreckon.replay.comparison.fixes import LogPart
from icreckon.replay.comparison.many import Case, CaseScores, case_scores
from icreckon.replay.comparison.results import Results, summarise
from icreckon.replay.export.folder import write_exports
from icreckon.replay.export.formats import DEFAULT_FORMATS, check_formats
from icreckon.replay.reading.gather import source_name
from icreckon.replay.reading.read_log import read_log
from icreckon.report.replay.folder import write_views

# Functions that all streaming filters compile, and those of a kind of motion model: linear, or not.
SHARED_KERNELS, KERNELS_OF_A_KIND = 8, 9


def compare_and_write(
    log: Log,
    robot: Robot,
    folder: Path,
    *,
    origin: dict[str, Any],
    variants: list[str] | None = None,
    fixes: LogPart | None = None,
    smooth: bool = False,
    formats: Sequence[str] = DEFAULT_FORMATS,
    workers: int | None = None,
    case: Case | None = None,
) -> tuple[Results, CaseScores | None]:
    """Run the variants over a log, and write a report.

    The arguments are those of `compare` and `write_report`, `origin` those of `summarise`; `folder`
    must exist. If several logs or robots are compared, a labelled `case` has scores for
    `summarise_many`, next to the results.
    """
    check_formats(formats, log)
    if log.start < 0 and {*formats} & {"mcap", "ros1"}:
        raise ReplayError(
            f"stamps begin at {log.start * NANOSECOND:.6g} s, and bags have none below zero: give "
            "--formats tum,csv (or another without mcap and ros1), or add to the column of times"
        )
    warn_unless_kept()
    title = f"filtering {log.duration:.0f} s of {log.name}"
    variants = variants or [*DEFAULT_VARIANTS]
    with progress(title, compiles=kernels_of(variants)) as report:
        count = worker_count(workers)
        if count > 1 and not kernel_files():
            compile_side_by_side(variants, count)
        comparison = compare(
            log, robot, variants, fixes=fixes, smooth=smooth, workers=count, progress=report
        )
    with working(f"scoring {log.name}"):
        summary = summarise(comparison, robot, **origin)
        scored = None if case is None else case_scores(case, comparison, summary)
    with working("writing trajectories, tables and odometry"):
        write_exports(folder, comparison, robot, formats, summary["verdict"])
    # Free the runs: for a long log they take most of the memory.
    del comparison
    with working("writing page and figure"):
        write_views(folder, summary)
    return summary, scored


def kernels_of(variants: Iterable[str]) -> int:
    """Number of functions that streaming filters of these variants compile."""
    kinds = {find_variant(name).model == "linear" for name in variants}
    return SHARED_KERNELS + KERNELS_OF_A_KIND * len(kinds)


def read(files: list[Path], robot: Robot, definitions: Definitions) -> Log:
    """Read a log, with a progress bar."""
    with progress(f"reading {source_name(files)}") as report:
        return read_log(files, robot, definitions=definitions, progress=report)


def the_robot(name: str | None, paths: Sequence[Path]) -> tuple[str, Robot]:
    """Load the robot of the option --robot; return the option and the robot.

    Raises:
        IcreckonError: the option is missing, or is no robot; the message names `paths`, the logs.
    """
    if name is None:
        raise ReplayError(
            f"what is the robot? Give --robot with a name ({', '.join(robot_names())}) or with a robot "
            f"file, which `icreckon inspect {' '.join(map(str, paths))} --write robot.toml` proposes"
        )
    return name, load_robot(name)
