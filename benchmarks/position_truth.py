"""Sample logs scored and calibrated by their truth, and by its positions alone: two tables in Markdown.

    python benchmarks/position_truth.py DATA

DATA is the folder of the sample logs, see accuracy.py. The headings of the lidar maps are left out, and
found from the path. Drift is that of `constant-online`, without fixes, from the shipped robot files.
Calibrations start from the shipped robot files, too.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from _logs import ASPHALT, GRASS
from _study import table
from accuracy import HALVED

from icreckon.estimator.calibration import calibrate
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.replay.comparison.compare import compare
from icreckon.replay.comparison.drift_table import drift_scores, paired_drifts
from icreckon.replay.comparison.results import comparison_drifts
from icreckon.replay.reading.read_log import read_log

VARIANT = "constant-online"
LOGS = {
    "Warthog, grass, 15h56": ("warthog", GRASS[0]),
    "Warthog, grass, July": ("warthog", GRASS[2]),
    "Warthog, asphalt": ("warthog", ASPHALT),
    "Marmotte (tracks)": HALVED["Marmotte"],
    "Husky, deflated tyres": HALVED["Husky"],
}
PARAMETERS = ("sprocket_radius", "effective_track", "imu.gyro_scale", "indices.zeta1")


def without_headings(log: Log) -> Log:
    """The log with a truth of positions alone."""
    if log.truth is None:
        raise ValueError(f"{log.name} has no truth")
    return replace(log, truth=log.truth.positions_alone())


def drift_row(log: Log, robot: Robot) -> list[str]:
    """Drift after 10, 30 and 60 s, and lag of the truth."""
    found = compare(log, robot, [VARIANT])
    drifts = paired_drifts(comparison_drifts(found))
    scores = drift_scores(drifts, VARIANT, VARIANT)
    alignment = found.alignment
    lag = "-"
    if alignment is not None and alignment.lag is not None:
        lag = f"{alignment.lag:.2f} ± {alignment.lag_sigma or np.nan:.2f}"
    return [*(f"{scores[f'drift_percent_{time}_mean']:.2f}" for time in ("10s", "30s", "60s")), lag]


def calibration_row(log: Log, robot: Robot) -> list[str]:
    """Calibrated parameters with their standard errors."""
    found = calibrate([log], robot)
    rows = [found.parameter(name) for name in PARAMETERS]
    return [f"{one.value:.5f} ± {one.sigma or np.nan:.5f}" for one in rows]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    drifts, calibrations = [], []
    for name, (robot_name, folder) in LOGS.items():
        robot = load_robot(robot_name)
        log = read_log(data / folder, robot)
        for what, one in (("poses", log), ("positions", without_headings(log))):
            drifts.append([name, what, *drift_row(one, robot)])
            calibrations.append([name, what, *calibration_row(one, robot)])
    table(("log", "truth", "drift 10 s, %", "30 s, %", "60 s, %", "lag of the truth, s"), drifts)
    print()
    table(("log", "truth", *PARAMETERS), calibrations)


if __name__ == "__main__":
    main()
