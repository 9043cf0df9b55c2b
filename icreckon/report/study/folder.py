"""Result folder of a study: tables, figures and page."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path

from icreckon.report.drawing import unless_missing
from icreckon.report.pages import Picture
from icreckon.report.study.page import study_page
from icreckon.simulation.running import run_study as computed
from icreckon.simulation.running.runner import Report
from icreckon.simulation.running.store import write_files
from icreckon.simulation.study.plan import Study
from icreckon.simulation.study.results import Results

PAGE = "page.html"


def run_study(
    study: Study,
    folder: str | Path,
    *,
    engine: str | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    cluster: str | None = None,
    overwrite: bool = False,
    report: Report | None = None,
    remark: Callable[[str], None] | None = None,
) -> Results:
    """Run or continue a study, and write its tables, figures and page to a folder.

    Arguments, results and errors are those of `icreckon.simulation.running.run_study.run_study`.
    """
    results = computed.run_study(
        study,
        folder,
        engine=engine,
        workers=workers,
        executor=executor,
        cluster=cluster,
        overwrite=overwrite,
        report=report,
        remark=remark,
    )
    write_study_page(Path(folder), results)
    return results


def write_study_page(folder: Path, results: Results) -> None:
    """Write figures and page of a study.

    Raises:
        SimulationError: the folder cannot be written.
    """
    figures: list[Picture] = []
    with unless_missing():
        from icreckon.report.study.figures import study_figures

        figures = study_figures(results)
    files = {f"{figure.name}.png": figure.png for figure in figures}
    write_files(folder, {**files, PAGE: study_page(results, figures).encode()})
