"""Result folder of a comparison."""

from collections.abc import Sequence
from pathlib import Path

from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.base.outputs import write_text
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.results import Results, write_results
from icreckon.replay.export.folder import write_exports
from icreckon.replay.export.formats import DEFAULT_FORMATS
from icreckon.report.pages import unless_missing
from icreckon.report.replay.many_page import many_page
from icreckon.report.replay.page import replay_page

RESULTS_FILE = "results.json"
FIGURE_FILE = "figure.png"
PAGE_FILE = "page.html"


def write_report(
    folder: Path | str,
    comparison: Comparison,
    results: Results,
    robot: Robot,
    formats: Sequence[str] = DEFAULT_FORMATS,
) -> None:
    """Write results, figure, page and trajectories of a comparison.

    `results` are those of `summarise` for the comparison, `formats` names from
    `icreckon.replay.export.formats.FORMATS`.

    Raises:
        ReplayError: the folder does not exist.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ReplayError(f"{folder}: no such folder; make it first")
    write_exports(folder, comparison, robot, formats, results["verdict"])
    write_views(folder, results)


def write_many(folder: Path, results: Results) -> None:
    """Write results and page of several logs; their own are in subfolders."""
    write_results(folder / RESULTS_FILE, results)
    write_text(folder / PAGE_FILE, many_page(results))


def write_views(folder: Path, results: Results) -> None:
    """Write results, figure and page, which do not need the runs."""
    write_results(folder / RESULTS_FILE, results)
    write_text(folder / PAGE_FILE, replay_page(results))
    with unless_missing():
        from icreckon.report.replay.figures import write_figure

        write_figure(folder / FIGURE_FILE, results)
