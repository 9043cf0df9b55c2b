"""Export of a comparison's trajectories and tables to a folder.

TUM files are for `evo` and others: one pose a line, `t x y z qx qy qz qw`, t in seconds.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.base.outputs import new_file
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.results import Results
from icreckon.replay.export.formats import DEFAULT_FORMATS
from icreckon.replay.export.geojson import write_geojson
from icreckon.replay.export.replay_bag import TRUTH, write_replay_bag
from icreckon.replay.export.tables import Format, pose_columns, run_columns, write_table

ODOMETRY_FILE = "odometry.mcap"
ROS1_FILE = "odometry.bag"
GEOJSON_FILE = "paths.geojson"


def write_exports(
    folder: Path,
    comparison: Comparison,
    robot: Robot,
    formats: Sequence[str] = DEFAULT_FORMATS,
    verdict: Results | None = None,
) -> None:
    """Write the trajectories of all runs and the truth, in formats of `FORMATS`.

    The truth is that of the best variant of a `verdict`, by its lever arm, or else as of the first
    alignment.
    TUM files have no heights if the truth has none: programs that compare them would take each height for
    an error.
    """
    truth, start = comparison.log.truth, comparison.log.start
    if verdict is not None:
        truth = comparison.truths[verdict["best"]].truth
        comparison = replace(comparison, log=replace(comparison.log, truth=truth))
    paths = {name: run.trajectory.pose_series for name, run in comparison.runs.items()}
    if truth is not None:
        paths[TRUTH] = truth.poses
        if truth.poses.spatial is None:
            paths = {name: replace(poses, spatial=None) for name, poses in paths.items()}
    for name, poses in paths.items():
        if "tum" in formats:
            write_tum(folder / f"{name}.tum", poses)
    table_formats: tuple[Format, ...] = ("csv", "parquet")
    for form in table_formats:
        if form not in formats:
            continue
        for name, run in comparison.runs.items():
            write_table(folder / f"{name}.{form}", form, run_columns(run, robot, start))
        if truth is not None:
            write_table(folder / f"{TRUTH}.{form}", form, pose_columns(truth.poses, start))
    if "mcap" in formats:
        write_replay_bag(folder / ODOMETRY_FILE, "mcap", comparison, robot)
    if "ros1" in formats:
        write_replay_bag(folder / ROS1_FILE, "ros1", comparison, robot)
    if "geojson" in formats:
        write_geojson(folder / GEOJSON_FILE, comparison)


def write_tum(path: Path, poses: PoseSeries) -> Path:
    """Write poses as a new TUM file (or ReplayError): 9 decimals each, exact stamps."""
    rows = zip(map(int, poses.stamps), poses.positions, poses.quaternions, strict=True)
    with new_file(path) as new, new.open("w", encoding="ascii", newline="\n") as file:
        # One row at a time: lists of all rows would take three times the memory of the poses.
        for stamp, position, quaternion in rows:
            # The sum turns -0.0 into 0.0.
            numbers = " ".join(f"{value + 0.0:.9f}" for value in (*position, *quaternion))
            # A float would round the stamp.
            seconds, nanoseconds = divmod(abs(stamp), NANOSECONDS)
            sign = "-" if stamp < 0 else ""
            file.write(f"{sign}{seconds}.{nanoseconds:09d} {numbers}\n")
    return path
