"""Trajectory files in the TUM and KITTI formats, for `evo` and others.

TUM: one pose a line, `t x y z qx qy qz qw`, t in seconds. KITTI: one pose a line, the upper three rows of
its 4x4 matrix in sequence, and the times in a separate file.
"""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import numpy as np

from icreckon.estimator.base.frames import quaternion_to_yaw, yaw_to_quaternion
from icreckon.estimator.log.series import PoseSeries
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.base.outputs import written_beside

NANOSECONDS = 1_000_000_000
TIMES_SUFFIX = ".times"


def write_tum(path: Path, poses: PoseSeries, *, overwrite: bool = False) -> Path:
    """Write planar poses as a TUM file, 9 decimals each; the stamps are exact.

    Args:
        path: the file.
        poses: the poses.
        overwrite: whether an existing file may be replaced.

    Returns:
        The path.

    Raises:
        ReplayError: the file exists, or cannot be written.
    """
    quaternions = yaw_to_quaternion(poses.poses[:, 2])
    with written_beside(path, overwrite=overwrite) as new:
        try:
            with new.open("w", encoding="ascii", newline="\n") as file:
                # One row at a time: lists of all rows would take three times the memory of the poses.
                for stamp, (x, y, _), (_, _, qz, qw) in zip(
                    map(int, poses.stamps), poses.poses, quaternions, strict=True
                ):
                    file.write(
                        f"{_seconds(stamp)} {x:.9f} {y:.9f} 0.000000000 "
                        f"0.000000000 0.000000000 {qz:.9f} {qw:.9f}\n"
                    )
        except OSError as problem:
            raise ReplayError(f"{path}: cannot be written: {problem.strerror}") from None
    return path


def write_kitti(path: Path, poses: PoseSeries, *, overwrite: bool = False) -> Path:
    """Write planar poses as a KITTI file, 9 decimals each, and a file of their times.

    The axes are those of the poses (x forward, y left, z up), not those of KITTI's cameras. KITTI files
    have no times. They go to the same path with the suffix `.times`, one a line, in seconds with 9
    decimals.

    Args:
        path: the file.
        poses: the poses.
        overwrite: whether existing files may be replaced.

    Returns:
        The path.

    Raises:
        ReplayError: a file exists, or cannot be written.
    """
    x, y, yaw = poses.poses.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    none, one = np.zeros_like(x), np.ones_like(x)
    rows = np.column_stack([cos, -sin, none, x, sin, cos, none, y, none, none, one, none])
    matrices = (" ".join(f"{value + 0.0:.9f}" for value in row) for row in rows.tolist())
    times = (_seconds(stamp) for stamp in poses.stamps.tolist())
    for place, lines in ((path, matrices), (path.with_suffix(TIMES_SUFFIX), times)):
        with written_beside(place, overwrite=overwrite) as new:
            try:
                with new.open("w", encoding="ascii", newline="\n") as file:
                    file.writelines(f"{line}\n" for line in lines)
            except OSError as problem:
                raise ReplayError(f"{place}: cannot be written: {problem.strerror}") from None
    return path


def read_tum(path: Path) -> PoseSeries:
    """Read a TUM file as planar poses; z, roll and pitch are ignored.

    Stamps are exact to 1 ns. Lines that start with `#` and empty lines are skipped.

    Args:
        path: the file.

    Raises:
        ReplayError: no such file, a line that is not eight finite numbers, a zero quaternion or
            stamps that do not increase.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise ReplayError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise ReplayError(f"{path}: cannot be read: {problem}") from None
    stamps: list[int] = []
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        stamp, row = _parse(words, f"{path}, line {number}")
        if stamps and stamp <= stamps[-1]:
            raise ReplayError(f"{path}, line {number}: the stamp {words[0]} is not after the last")
        stamps.append(stamp)
        rows.append(row)
    values = np.array(rows, dtype=float).reshape(-1, 7)
    quaternions = values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    poses = np.column_stack([values[:, :2], quaternion_to_yaw(quaternions)])
    return PoseSeries(np.array(stamps, dtype=np.int64), poses)


def _seconds(stamp: int) -> str:
    whole, rest = divmod(abs(stamp), NANOSECONDS)
    return f"{'-' if stamp < 0 else ''}{whole}.{rest:09d}"


def _parse(words: list[str], where: str) -> tuple[int, list[float]]:
    refusal = ReplayError(
        f"{where}: expected eight finite numbers t x y z qx qy qz qw, found {' '.join(words)!r}"
    )
    if len(words) != 8:
        raise refusal
    try:
        stamp = (Decimal(words[0]) * NANOSECONDS).to_integral_value()
        row = [float(word) for word in words[1:]]
        possible = abs(stamp) < 2**63
    except (ValueError, ArithmeticError):
        raise refusal from None
    if not (possible and np.isfinite(row).all() and any(row[3:])):
        raise refusal
    return int(stamp), row
