"""Detection of lost filters, whose estimates are not finite or absurd."""

import math
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.streaming.outputs import Run

FURTHEST = 1e8  # no position is further from its origin, not even in UTM coordinates [m]
FASTEST = 1e3  # no ground robot is faster [m/s, rad/s]
ROUNDING = 1e-6  # rounding makes variances negative by no more than this, in single precision too
USABLE, NOT_FINITE, NEGATIVE, ABSURD = range(4)
REASONS = {
    NOT_FINITE: "estimate is not finite",
    NEGATIVE: "estimate has negative variances",
    ABSURD: f"estimate is absurd (beyond {FURTHEST:.0e} m, {FASTEST:.0e} m/s or rad/s)",
}


class LostFilter(EstimatorError):
    """A filter without a usable estimate at some time of a run.

    Args:
        variant: name of the filter.
        reason: what happened, and when.
        seconds: time since the start of the log [s]; None if it is not known.
    """

    def __init__(self, variant: str, reason: str, seconds: float | None = None) -> None:
        super().__init__(variant, reason, seconds)
        self.variant, self.reason, self.seconds = variant, reason, seconds

    def __str__(self) -> str:
        return f"{self.variant}: {self.reason}"


def reason_of(kind: int, seconds: float) -> str:
    """Message of a kind of loss that begins some seconds after the start."""
    return f"{REASONS[kind]} from {seconds:.1f} s on"


def loss_kinds(path: Trajectory, *, finite: Any = True, negative: Any = False) -> Any:
    """Kind of loss (n, ...) of each row of a path: `USABLE` or a key of `REASONS`.

    Arrays of the path may have an axis for filters after the first. `finite` (n, ...) is False if another
    value of the row is not finite, `negative` (n, ...) True if another variance is negative.
    """
    for values in (path.poses, path.twists):
        finite = finite & np.isfinite(values).all(axis=-1)
    for covariances in (path.pose_covariances, path.twist_covariances):
        finite = finite & np.isfinite(covariances).all(axis=(-2, -1))
        variances = np.diagonal(covariances, axis1=-2, axis2=-1)
        negative = negative | (variances < -ROUNDING).any(axis=-1)
    is_absurd = (np.abs(path.poses[..., :2]) > FURTHEST).any(axis=-1)
    is_absurd |= (np.abs(path.twists) > FASTEST).any(axis=-1)
    return np.select([~finite, negative, is_absurd], [NOT_FINITE, NEGATIVE, ABSURD], USABLE)


def loss_of(run: Run, start: int) -> LostFilter | None:
    """Loss of a filter, at a time since `start` [ns]; None if rows and NIS are usable."""
    if not len(run.trajectory.stamps):
        tracks = run.health.sensors.get("tracks")
        counts = {} if tracks is None else tracks.rejected
        rejected = ", ".join(f"{count} x {reason}" for reason, count in counts.items())
        suffix = f": rejected {rejected}" if rejected else ""
        return LostFilter(run.variant, f"no track speeds were used{suffix}")
    # The root of a negative variance is NaN.
    sigmas = run.state_sigmas
    finite = np.isfinite(run.states).all(axis=1) & ~np.isinf(sigmas).any(axis=1)
    kinds = loss_kinds(run.trajectory, finite=finite, negative=np.isnan(sigmas).any(axis=1))
    lost_rows = np.flatnonzero(kinds)
    if not len(lost_rows):
        sums = {name: sensor.nis_sum for name, sensor in run.health.sensors.items()}
        bad = [f"{name} ({nis:.3g})" for name, nis in sums.items() if not 0.0 <= nis < math.inf]
        return LostFilter(run.variant, f"impossible NIS of {', '.join(bad)}") if bad else None
    first = lost_rows[0]
    seconds = float((run.stamps[first] - start) * NANOSECOND)
    return LostFilter(run.variant, reason_of(int(kinds[first]), seconds), seconds)


def stopped_by(problem: Exception, so_far: Run, start: int, stamp: int) -> LostFilter:
    """Loss of a filter by an exception at a stamp, or by an unusable row before it."""
    seconds = (stamp - start) * NANOSECOND
    reason = f"stopped at {seconds:.1f} s by {described(problem)}"
    return loss_of(so_far, start) or LostFilter(so_far.variant, reason, seconds)


def described(problem: BaseException) -> str:
    """Type and message of an exception, in one line."""
    return " ".join(f"{type(problem).__name__}: {problem}".split())
