"""Columns of a run and its errors against the truth, as input of a data frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.scores import nees, regular
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.outputs import Run
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.fixes import OF_FIXES
from icreckon.replay.comparison.plot_series import true_poses_at
from icreckon.replay.comparison.scores import truths_of
from icreckon.replay.export.tables import run_columns

Column = NDArray[Any]


def columns_of(comparison: Comparison, robot: Robot, variant: str) -> dict[str, Column]:
    """Columns of a run, and its errors against the truth, for `pandas.DataFrame`.

    Columns are those of the tables that `write_report` writes: `stamp_ns`, `t_s` since the log's start,
    pose, twist, their covariances, ICRs, states and innovations, units in their names. With a truth,
    interpolated to the rows, there are also `true_x_m`, `true_y_m`, `true_yaw_rad`, `position_error_m`,
    `yaw_error_rad` and `nees_pose` (3 is ideal). All are NaN in holes of the truth, yaw and NEES also
    without headings, and the NEES against fixes and where the covariance is singular.

    Args:
        comparison: the runs, from `compare`.
        robot: the robot, for its gauge.
        variant: name of a run of the comparison.

    Raises:
        ReplayError: the comparison has no such run.
    """
    if variant not in comparison.runs:
        lost = comparison.failed.get(variant)
        why = (
            f"there are {', '.join(comparison.runs)}"
            if lost is None
            else f"it failed: {lost.reason}"
        )
        raise ReplayError(f"the comparison has no run {variant!r}; {why}")
    one = comparison.runs[variant]
    columns: dict[str, Column] = run_columns(one, robot, comparison.log.start)
    if comparison.log.truth is not None:
        columns |= _truth_columns(comparison, variant, one)
    return columns


def _truth_columns(comparison: Comparison, variant: str, one: Run) -> dict[str, Column]:
    """Truth and errors at the rows of a run, NaN where the truth does not show them."""
    truth = truths_of(comparison)[variant].truth
    poses = true_poses_at(truth, one.stamps)
    poses[:, 2] = wrap_angle(poses[:, 2])
    apart = one.trajectory.poses - poses
    apart[:, 2] = wrap_angle(apart[:, 2])
    covariances = one.trajectory.pose_covariances
    # Errors of fixes are not known to the filter's covariance.
    judged = regular(covariances) & (truth.source != OF_FIXES)
    normalised = np.full(len(apart), np.nan)
    normalised[judged] = nees(apart[judged], covariances[judged])
    return {
        "true_x_m": poses[:, 0],
        "true_y_m": poses[:, 1],
        "true_yaw_rad": poses[:, 2],
        "position_error_m": np.hypot(apart[:, 0], apart[:, 1]),
        "yaw_error_rad": apart[:, 2],
        "nees_pose": normalised,
    }
