"""The folder that a study leaves behind: tables, figures, and the page that shows them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path

from simulation import study as computed
from simulation.study_blocks import write_files
from simulation.study_figures import study_figures
from simulation.study_page import study_page
from simulation.study_plan import Study
from simulation.study_results import Results
from simulation.study_runner import Report

PAGE = "report.html"


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
    """Run a study, or continue it, and leave its tables, figures and page in a folder.

    Arguments, results and errors are those of `simulation.study.run_study`.
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
    figures = study_figures(results)
    files = {f"{figure.name}.png": figure.png for figure in figures}
    write_files(folder, {**files, PAGE: study_page(results, figures).encode()})
