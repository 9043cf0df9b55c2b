"""An engine for tests of what is around engines: numbers from seed, cell and run, in no time."""

import os
import time
from pathlib import Path

import numpy as np

from icreckon import Scenario, Study, Sweep
from icreckon.simulation.running import engines
from icreckon.simulation.study.failures import unscored
from icreckon.simulation.study.statistics import statistics

STUDY = Study(
    name="tiny",
    scenario=Scenario(duration=10.0, outages=((5.0, 10.0),)),
    variants=("constant-online", "inertia-online"),
    sweep=Sweep(grid={"gyro.factor": [1.0, 10.0]}),
    runs=10,
    truths=5,
    horizons=(5.0,),
)


def install(patch, *, threads=True):
    """Run studies by an engine of no time; figures, which take longest, stay blank."""
    patch.setattr("matplotlib.figure.Figure.savefig", lambda *_, **__: None)
    engine = engines.Engine("stub", "study_stub", block_runs=4, threads=threads)
    patch.setattr(engines, "ENGINES", [engine])


def contents(folder):
    """What a study leaves, but for its blocks."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


# A file that is named here: the first worker that finds it takes it away, and dies.
DEADLY = "STUDY_STUB_DEADLY"
# Seconds that a block takes.
PACE = "STUDY_STUB_PACE"


def block(cell, filters, first_run, count):
    deadly = os.environ.get(DEADLY)
    if deadly is not None:
        try:
            Path(deadly).unlink()
        except FileNotFoundError:
            pass
        else:
            os._exit(9)
    time.sleep(float(os.environ.get(PACE, "0")))
    names = [one.name for one in statistics(cell.horizons)]
    found = unscored(len(filters), count, cell.horizons)
    for number, row in np.ndindex(found.reasons.shape):
        run = first_run + row
        truth = np.random.default_rng([cell.scenario.seed, run % cell.truths])
        own = np.random.default_rng([cell.scenario.seed, run, cell.index, number])
        values = truth.gamma(4.0, 0.5, len(names)) + own.gamma(2.0, 0.5, len(names))
        found.values[number, row] = values
    found.values[..., names.index("rejected_gyro")] = np.nan
    return found
