"""Result folder of a study: tables, figures and page."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from icreckon.report.pages import Picture, render, unless_missing
from icreckon.report.study import text as study_text
from icreckon.simulation.running import run_study as computed
from icreckon.simulation.running.runner import Report
from icreckon.simulation.running.store import write_files
from icreckon.simulation.study.plan import Study
from icreckon.simulation.study.results import Results

PAGE = "page.html"
PROVENANCE = ("versions", "seed", "engine", "runs", "true_motions", "format")


def run_study(
    study: Study,
    folder: str | Path,
    *,
    workers: int | None = None,
    executor: Executor | None = None,
    overwrite: bool = False,
    report: Report | None = None,
    remark: Callable[[str], None] | None = None,
) -> Results:
    """Run or continue a study, and write its tables, figures and page to a folder.

    Args:
        study: the study, from `load_study` or made in code.
        folder: folder of blocks and results; if it has blocks of the same study, the study continues.
        workers: number of threads or processes; None for one per core.
        executor: executor to run on instead.
        overwrite: True if another study in the folder may be deleted.
        report: called at the start and after each block.
        remark: called with warnings, as text.

    Returns:
        Content of `results.json`, with NaN for null.

    Raises:
        SimulationError: an invalid study, a swept key that changes nothing, ground that a vehicle cannot
            drive on, or a folder with other content.
        EstimatorError: no such robot.
    """
    results = computed.run_study(
        study,
        folder,
        workers=workers,
        executor=executor,
        overwrite=overwrite,
        report=report,
        remark=remark,
    )
    figures: list[Picture] = []
    with unless_missing():
        from icreckon.report.study.figures import study_figures

        figures = study_figures(results)
    files = {f"{figure.name}.png": figure.png for figure in figures}
    write_files(Path(folder), {**files, PAGE: study_page(results, figures).encode()})
    return results


def study_page(results: Results, figures: Sequence[Picture]) -> str:
    """Render the page as HTML."""
    return render(
        "study.html",
        title=results["name"],
        subtitle=results["description"].strip(),
        failures=study_text.failures(results),
        caveats=[*results["remarks"], *study_text.same_results(results)],
        headline=study_text.headline(results),
        tables=study_text.summary_tables(results),
        error=study_text.ERROR,
        notes=study_text.notes(results),
        figures=figures,
        configuration=_without_empty(results["configuration"]),
        robot=_without_empty(results["robot"]),
        provenance=_without_empty({key: results[key] for key in PROVENANCE}),
    )


def _without_empty(data: Any) -> Any:
    """Remove keys whose value is None, an empty table or list, but for cases."""
    if not isinstance(data, dict):
        return data
    nested = {key: one if key == "cases" else _without_empty(one) for key, one in data.items()}
    return {key: value for key, value in nested.items() if value not in (None, {}, [])}
