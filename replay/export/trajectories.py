"""Trajectory files in the TUM and KITTI formats, for `evo` and others.

TUM: one pose a line, `t x y z qx qy qz qw`, t in seconds. KITTI: one pose a line, the upper three rows of
its 4x4 matrix in sequence, and the times in a separate file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from icreckon.estimator.log.series import PoseSeries
from icreckon.replay.base.outputs import new_file

NANOSECONDS = 1_000_000_000
TIMES_SUFFIX = ".times"


def write_tum(path: Path, poses: PoseSeries) -> Path:
    """Write poses as a TUM file, 9 decimals each; the stamps are exact.

    Returns:
        The path.

    Raises:
        ReplayError: the file exists, or cannot be written.
    """
    rows = zip(map(int, poses.stamps), poses.positions, poses.quaternions, strict=True)
    with new_file(path) as new, new.open("w", encoding="ascii", newline="\n") as file:
        # One row at a time: lists of all rows would take three times the memory of the poses.
        for stamp, place, quaternion in rows:
            numbers = " ".join(f"{value + 0.0:.9f}" for value in (*place, *quaternion))
            file.write(f"{_seconds(stamp)} {numbers}\n")
    return path


def write_kitti(path: Path, poses: PoseSeries) -> Path:
    """Write poses as a KITTI file, 9 decimals each, and a file of their times.

    The axes are those of the poses (x forward, y left, z up), not those of KITTI's cameras. KITTI files
    have no times. They go to the same path with the suffix `.times`, one a line, in seconds with 9
    decimals.

    Returns:
        The path.

    Raises:
        ReplayError: a file exists, or cannot be written.
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(poses.quaternions).as_matrix()
    rows = np.concatenate([turns, poses.positions[:, :, None]], axis=2).reshape(-1, 12)
    matrices = (" ".join(f"{value + 0.0:.9f}" for value in row) for row in rows.tolist())
    times = (_seconds(stamp) for stamp in poses.stamps.tolist())
    for place, lines in ((path, matrices), (path.with_suffix(TIMES_SUFFIX), times)):
        with new_file(place) as new, new.open("w", encoding="ascii", newline="\n") as file:
            file.writelines(f"{line}\n" for line in lines)
    return path


def _seconds(stamp: int) -> str:
    whole, rest = divmod(abs(stamp), NANOSECONDS)
    return f"{'-' if stamp < 0 else ''}{whole}.{rest:09d}"
