"""Export of a run as a CSV or Parquet table, or columns of a data frame.

A row for each pair of track speeds. Column names end with units. Unknown values are empty (null).
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.scores import nees
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.motion.icr import IndexValues
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.outputs import Run, icr_points
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.base.outputs import new_file
from icreckon.replay.base.units import column_name
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.fixes import OF_FIXES
from icreckon.replay.comparison.holes import true_poses_at

Format = Literal["csv", "parquet"]

# Names of the upper triangles of both covariances, row by row.
POSE_COVARIANCES = ("x_x_m2", "x_y_m2", "x_yaw_m_rad", "y_y_m2", "y_yaw_m_rad", "yaw_yaw_rad2")
TWISTS = ("v_x_v_x_m2", "v_x_v_y_m2", "v_x_w_m_rad", "v_y_v_y_m2", "v_y_w_m_rad", "w_w_rad2")
TWIST_COVARIANCES = tuple(f"{entry}_s2" for entry in TWISTS)
ENCODING = "BYTE_STREAM_SPLIT"  # compresses noise: bytes of equal significance are grouped


def run_columns(run: Run, robot: Robot, start: int | None = None) -> dict[str, Any]:
    """Columns (n,) of a run by name, float64 if precision matters, otherwise float32.

    They are input of a data frame, `pandas.DataFrame(run_columns(run, robot))`, with units in their
    names: `stamp_ns`, `t_s`, pose, twist, their covariances, ICRs, states with their standard deviations,
    and innovations over theirs.

    Args:
        run: the run.
        robot: the robot, for its gauge.
        start: stamp of `t_s` = 0 [ns]; the run's first by default.
    """
    trajectory = run.trajectory
    start = int(trajectory.stamps[0]) if start is None else start
    columns = pose_columns(trajectory.pose_series, start)
    single: dict[str, Any] = {}  # columns in single precision
    single |= zip(("v_x_m_s", "v_y_m_s", "w_rad_s"), trajectory.twists.T, strict=True)
    upper_triangle = list(zip(*np.triu_indices(3), strict=True))
    for names, covariances in (
        (POSE_COVARIANCES, trajectory.pose_covariances),
        (TWIST_COVARIANCES, trajectory.twist_covariances),
    ):
        for name, (row, column) in zip(names, upper_triangle, strict=True):
            single[f"cov_{name}"] = covariances[:, row, column]
    if trajectory.spatial_sigmas is not None:
        names = ("sigma_z_m", "sigma_roll_rad", "sigma_pitch_rad")
        single |= zip(names, trajectory.spatial_sigmas.T, strict=True)
    single |= zip(("zeta_m", "epsilon_m", "eta"), run.indices.T, strict=True)
    icrs = icr_points(IndexValues(*run.indices.T), robot.vehicle.track_gauge)
    for side, point in icrs._asdict().items():
        single[f"{side}_icr_x_m"], single[f"{side}_icr_y_m"] = point
    for index in (*range(s.SLIP.start, s.SLIP.stop), *range(s.LEARNT.start, s.GRAVITY.stop)):
        name = run.state_names[index]
        if name:
            single[column_name(name)] = run.states[:, index]
            single[column_name(name, "sigma")] = run.state_sigmas[:, index]
    for index, name in enumerate(run.innovation_names):
        single[f"innovation_{name}"] = run.innovations[:, index]
    return columns | {name: np.asarray(value, np.float32) for name, value in single.items()}


def pose_columns(series: PoseSeries, start: int) -> dict[str, Any]:
    """Columns (n,) of poses alone, such as the truth; `t_s` is since `start` [ns]."""
    columns = {
        "stamp_ns": series.stamps,
        "t_s": (series.stamps - start) * NANOSECOND,
        **dict(zip(("x_m", "y_m", "yaw_rad"), series.poses.T, strict=True)),
    }
    if series.spatial is not None:
        columns |= dict(zip(("z_m", "roll_rad", "pitch_rad"), series.spatial.T, strict=True))
    return columns


def write_table(path: Path, form: Format, columns: dict[str, Any]) -> Path:
    """Write columns (n,) as a new table, "csv" or "parquet", or raise a ReplayError."""
    import pyarrow as pa
    from pyarrow import csv, parquet

    contiguous = {name: np.ascontiguousarray(values) for name, values in columns.items()}
    # From pandas: NaN is null.
    table = pa.table({key: pa.array(one, from_pandas=True) for key, one in contiguous.items()})
    with new_file(path) as new:
        if form == "csv":
            csv.write_csv(table, new)
        else:
            parquet.write_table(
                table, new, compression="zstd", use_dictionary=False, column_encoding=ENCODING
            )
    return path


def columns_of(comparison: Comparison, robot: Robot, variant: str) -> dict[str, NDArray[Any]]:
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
        failure = comparison.failed.get(variant)
        others = f"there are {', '.join(comparison.runs)}"
        why = others if failure is None else f"it failed: {failure.reason}"
        raise ReplayError(f"the comparison has no run {variant!r}; {why}")
    run = comparison.runs[variant]
    columns: dict[str, NDArray[Any]] = run_columns(run, robot, comparison.log.start)
    if comparison.log.truth is None:
        return columns
    truth = comparison.truths[variant].truth
    poses = true_poses_at(truth, run.stamps)
    poses[:, 2] = wrap_angle(poses[:, 2])
    errors = run.trajectory.poses - poses
    errors[:, 2] = wrap_angle(errors[:, 2])
    x_error, y_error, yaw_error = errors.T
    # The covariance lacks the errors of fixes, so there is no NEES against a truth of fixes.
    normalised = np.full(len(errors), np.nan)
    if truth.source != OF_FIXES:
        normalised = nees(errors, run.trajectory.pose_covariances)
    columns |= zip(("true_x_m", "true_y_m", "true_yaw_rad"), poses.T, strict=True)
    columns |= {"position_error_m": np.hypot(x_error, y_error), "yaw_error_rad": yaw_error}
    return columns | {"nees_pose": normalised}
