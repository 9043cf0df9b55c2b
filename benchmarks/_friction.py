"""What the studies with friction as truth share: truth and fixes of a log, errors in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import FixSeries, PoseSeries
from icreckon.estimator.streaming.outputs import Run

ONLINE = ("constant-online", "inertia-online")
# The goal for pose NEES (3 is ideal): between half and twice that.
NEES_GOAL = (1.5, 6.0)


@dataclass(frozen=True)
class Curves:
    """Errors once a second, (n,): position [m] and pose NEES (NaN where it says nothing)."""

    position: Floats
    nees: Floats


def curves(result: Run, log: Log, start: int, seconds: int) -> Curves:
    """The errors of a run at whole seconds since a stamp [ns]; NaN before its first estimate."""
    truth = true_poses(log)
    stamps = start + np.arange(seconds + 1) * round(1.0 / NANOSECOND)
    trajectory = result.trajectory
    at = np.searchsorted(trajectory.stamps, stamps).clip(0, len(trajectory.stamps) - 1)
    errors = interpolate_poses(trajectory.pose_series, stamps) - interpolate_poses(truth, stamps)
    errors[:, 2] = wrap_angle(errors[:, 2])
    covariances = trajectory.pose_covariances[at]
    nees = np.full(len(stamps), np.nan)
    regular = np.linalg.eigvalsh(covariances)[:, 0] > 1e-12
    solved = np.linalg.solve(covariances[regular], errors[regular][..., None])[..., 0]
    nees[regular] = np.einsum("ij,ij->i", errors[regular], solved)
    position = np.hypot(errors[:, 0], errors[:, 1])
    early = stamps < trajectory.stamps[0]
    position[early], nees[early] = np.nan, np.nan
    return Curves(position, nees)


def true_poses(log: Log) -> PoseSeries:
    """The true poses of a simulated log."""
    if log.truth is None:
        raise ValueError(f"log {log.name!r} has no truth")
    return log.truth.poses


def fixes_of(log: Log) -> FixSeries:
    """The fixes of a simulated log."""
    if log.fixes is None:
        raise ValueError(f"log {log.name!r} has no fixes")
    return log.fixes
