"""Export of a comparison's trajectories and tables to a folder.

TUM and KITTI files are for `evo` and others. TUM: one pose a line, `t x y z qx qy qz qw`, t in seconds.
KITTI: one pose a line, the upper three rows of its 4x4 matrix in sequence, and the times in a separate
file.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.base.outputs import new_file
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.results import Results
from icreckon.replay.comparison.scores import truth_of
from icreckon.replay.export.formats import DEFAULT_FORMATS
from icreckon.replay.export.geojson import write_geojson
from icreckon.replay.export.replay_bag import write_replay_bag
from icreckon.replay.export.tables import Format, pose_columns, run_columns, write_table

ODOMETRY_FILE = "odometry.mcap"
ROS1_FILE = "odometry.bag"
GEOJSON_FILE = "paths.geojson"
TRUTH = "ground_truth"
TIMES_SUFFIX = ".times"


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
    TUM and KITTI files have no heights if the truth has none: programs that compare them would take each
    height for an error.
    """
    truth, start = comparison.log.truth, comparison.log.start
    if verdict is not None:
        truth = truth_of(comparison, verdict["best"]).truth
        comparison = replace(comparison, log=replace(comparison.log, truth=truth))
    paths = {name: run.trajectory.pose_series for name, run in comparison.runs.items()}
    if truth is not None:
        paths[TRUTH] = truth.poses
        if truth.poses.spatial is None:
            paths = {name: replace(poses, spatial=None) for name, poses in paths.items()}
    for name, poses in paths.items():
        if "tum" in formats:
            write_tum(folder / f"{name}.tum", poses)
        if "kitti" in formats:
            write_kitti(folder / f"{name}.kitti", poses)
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
    """Write poses as a TUM file, 9 decimals each; the stamps are exact.

    Raises:
        ReplayError: the file exists, or cannot be written.
    """
    rows = zip(map(int, poses.stamps), poses.positions, poses.quaternions, strict=True)
    with new_file(path) as new, new.open("w", encoding="ascii", newline="\n") as file:
        # One row at a time: lists of all rows would take three times the memory of the poses.
        for stamp, position, quaternion in rows:
            # The sum turns -0.0 into 0.0.
            numbers = " ".join(f"{value + 0.0:.9f}" for value in (*position, *quaternion))
            file.write(f"{_seconds(stamp)} {numbers}\n")
    return path


def write_kitti(path: Path, poses: PoseSeries) -> Path:
    """Write poses as a KITTI file, 9 decimals each, and a file of their times [s].

    The axes are those of the poses (x forward, y left, z up), not those of KITTI's cameras. The times,
    one a line, go to the same path with the suffix `.times`.

    Raises:
        ReplayError: a file exists, or cannot be written.
    """
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_quat(poses.quaternions).as_matrix()
    rows = np.concatenate([rotations, poses.positions[:, :, None]], axis=2).reshape(-1, 12)
    # The sum turns -0.0 into 0.0.
    matrices = (" ".join(f"{value + 0.0:.9f}" for value in row) for row in rows.tolist())
    times = (_seconds(stamp) for stamp in poses.stamps.tolist())
    for file_path, lines in ((path, matrices), (path.with_suffix(TIMES_SUFFIX), times)):
        with new_file(file_path) as new, new.open("w", encoding="ascii", newline="\n") as file:
            file.writelines(f"{line}\n" for line in lines)
    return path


def _seconds(stamp: int) -> str:
    """Format a stamp [ns] in seconds, exactly: a float would round it."""
    seconds, nanoseconds = divmod(abs(stamp), NANOSECONDS)
    return f"{'-' if stamp < 0 else ''}{seconds}.{nanoseconds:09d}"
