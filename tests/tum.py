"""A reader of trajectories in the TUM format, as strict as readers of others may be."""

from decimal import Decimal
from pathlib import Path

import numpy as np

from icreckon.estimator.base.frames import quaternion_to_yaw
from icreckon.estimator.log.series import PoseSeries
from icreckon.replay.base.errors import ReplayError

NANOSECONDS = 1_000_000_000


def read_tum(path: Path) -> PoseSeries:
    """Read a TUM file as planar poses; z, roll and pitch are ignored.

    Stamps are exact to 1 ns. Lines that start with `#` and empty lines are skipped.
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
