"""A reader of trajectories in the TUM format."""

from decimal import Decimal
from pathlib import Path

import numpy as np

from icreckon.estimator.base.frames import quaternion_to_yaw
from icreckon.estimator.log.series import PoseSeries


def read_tum(path: Path) -> PoseSeries:
    """Read a TUM file as planar poses; stamps are exact to 1 ns, z, roll and pitch are ignored."""
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    stamps = [int(Decimal(words[0]) * 10**9) for words in lines]
    values = np.array([words[1:] for words in lines], dtype=float).reshape(-1, 7)
    poses = np.column_stack([values[:, :2], quaternion_to_yaw(values[:, 3:])])
    return PoseSeries(np.array(stamps, dtype=np.int64), poses)
