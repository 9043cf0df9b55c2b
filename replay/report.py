"""The folder that a comparison leaves behind."""

from __future__ import annotations

from pathlib import Path

from replay.bag_writer import write_odometry
from replay.comparison import Comparison
from replay.figures import write_figure
from replay.results import Results, write_results
from replay.trajectory_files import write_tum

RESULTS_FILE = "results.json"
FIGURE_FILE = "figure.png"
ODOMETRY_FILE = "odometry.mcap"
TRUTH_FILE = "ground_truth.tum"


def write_report(folder: Path, comparison: Comparison, results: Results) -> None:
    """Write results, figure, trajectories (TUM) and odometry (MCAP) of a comparison.

    Args:
        folder: where to; it is there already.
        comparison: the runs.
        results: what `summarise` made of them.
    """
    truth = comparison.log.truth
    for name, one in comparison.runs.items():
        write_tum(folder / f"{name}.tum", one.trajectory.pose_series)
    if truth is not None:
        write_tum(folder / TRUTH_FILE, truth.poses)
    trajectories = {name: one.trajectory for name, one in comparison.runs.items()}
    write_odometry(folder / ODOMETRY_FILE, trajectories, None if truth is None else truth.poses)
    write_figure(folder / FIGURE_FILE, results)
    write_results(folder / RESULTS_FILE, results)
