"""A study from its plan to its results: `run_study`."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from icreckon.estimator.filter.fault_table import OWN_FAULTS
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.running.engines import BATCH, choose_engine
from icreckon.simulation.running.manifest import as_json, manifest
from icreckon.simulation.running.runner import Report, run_jobs
from icreckon.simulation.running.store import (
    RESULTS,
    BlockStore,
    Job,
    jobs_of,
    open_store,
    write_files,
)
from icreckon.simulation.study.cells import Plan, expand
from icreckon.simulation.study.plan import Study
from icreckon.simulation.study.results import Results, Runs, cell_summaries, study_results
from icreckon.simulation.study.statistics import statistics
from icreckon.simulation.truth.terrain import check_terrain

RESULTS_PARQUET = "results.parquet"
RUNS_PARQUET = "runs.parquet"


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
    """Run or continue a study, and write its tables to a folder.

    Arguments, result and errors are those of `icreckon.run_study`, which writes figures and page, too.
    """
    if OWN_FAULTS:
        names = ", ".join(OWN_FAULTS)
        raise SimulationError(
            f"a study does not watch for faults of your own ({names}); call remove_fault"
        )
    plan = expand(study)
    for cell in plan.cells:
        check_terrain(cell.scenario.terrain, 2.0 * cell.robot.vehicle.half_contact_length)
    chosen = choose_engine(plan)
    identity = manifest(plan, chosen)
    if remark is not None:
        reason = None if chosen is BATCH else BATCH.why_not(plan)
        if reason is not None:
            remark(f"runs are computed one after the other, which is slow: {reason}")
        for warning in identity["remarks"]:
            remark(warning)
    store = open_store(Path(folder), identity, overwrite=overwrite)
    jobs = jobs_of(plan, chosen.block_runs)
    count = workers or os.cpu_count() or 1
    run_jobs(plan, chosen, jobs, store, workers=count, executor=executor, report=report)
    from icreckon.simulation.study.tables import results_parquet, runs_parquet

    gathered = _gathered(plan, jobs, store)
    cells = cell_summaries(gathered)
    results = study_results(gathered, identity, cells)
    files = {
        RESULTS_PARQUET: results_parquet(gathered, cells),
        RUNS_PARQUET: runs_parquet(gathered),
        RESULTS: as_json(results).encode(),
    }
    write_files(store.folder, files)
    return results


def _gathered(plan: Plan, jobs: Sequence[Job], store: BlockStore) -> Runs:
    """Statistics of all blocks; raises a SimulationError if one has been removed."""
    study = plan.study
    shape = (len(plan.labels), len(plan.cells), study.runs, len(statistics(study.horizons)))
    values, reasons = np.empty(shape), np.full(shape[:3], "", dtype=object)
    for job in jobs:
        block = store.read(job)
        if block is None:
            raise SimulationError(
                f"{store.path(job)}: has been removed meanwhile; give the same command again"
            )
        runs = slice(job.first_run, job.first_run + job.count)
        values[:, job.cell, runs], reasons[:, job.cell, runs] = block
    return Runs(plan, values, reasons)
