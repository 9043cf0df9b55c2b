"""Export of a comparison's trajectories and tables to a folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.export.formats import DEFAULT_FORMATS
from icreckon.replay.export.geojson import write_geojson
from icreckon.replay.export.replay_bag import write_replay_bag
from icreckon.replay.export.tables import Format, write_poses, write_run
from icreckon.replay.export.trajectories import write_kitti, write_tum

ODOMETRY_FILE = "odometry.mcap"
ROS1_FILE = "odometry.bag"
GEOJSON_FILE = "paths.geojson"
TRUTH = "ground_truth"


def write_exports(
    folder: Path, comparison: Comparison, robot: Robot, formats: Sequence[str] = DEFAULT_FORMATS
) -> None:
    """Write a comparison's trajectories in some formats; arguments as `write_report`."""
    truth, start = comparison.log.truth, comparison.log.start
    paths: dict[str, PoseSeries] = {
        name: one.trajectory.pose_series for name, one in comparison.runs.items()
    }
    if truth is not None:
        paths[TRUTH] = truth.poses
        if truth.poses.spatial is None:
            # Programs that compare both would take each height for an error.
            paths = {name: replace(poses, spatial=None) for name, poses in paths.items()}
    for name, poses in paths.items():
        if "tum" in formats:
            write_tum(folder / f"{name}.tum", poses)
        if "kitti" in formats:
            write_kitti(folder / f"{name}.kitti", poses)
    tables: tuple[Format, ...] = ("csv", "parquet")
    for form in (kind for kind in tables if kind in formats):
        for name, one in comparison.runs.items():
            write_run(folder / f"{name}.{form}", form, one, robot, start)
        if truth is not None:
            write_poses(folder / f"{TRUTH}.{form}", form, truth.poses, start)
    if "mcap" in formats:
        write_replay_bag(folder / ODOMETRY_FILE, "mcap", comparison, robot)
    if "ros1" in formats:
        write_replay_bag(folder / ROS1_FILE, "ros1", comparison, robot)
    if "geojson" in formats:
        write_geojson(folder / GEOJSON_FILE, comparison)
