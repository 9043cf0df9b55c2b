"""Stochastic clones: motion of the robot since a mark, with its covariance.

A mark begins a relative pose: that of base_link in the axes that base_link had at the mark. Each step
moves it as the filter's pose, with the same noise. Its covariance with the filter's state and with the
other clones is propagated (after Roumeliotis and Burdick, Stochastic cloning, ICRA 2002). It does not
depend on the pose in odom or its uncertainty: a fix that rotates the whole path does not change the
relative motion, as it would with a clone of the pose in odom.

Only steps and fixes move a clone, as they move the pose.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.filter.changes import Moved, Updated

# Least variance of a motion in any direction [m², rad²]: a robot that stands has a variance of zero, and
# rounding may make the variance between two marks negative.
LEAST_VARIANCE = 1e-8
MOST_MARKS = 20  # each clone costs time in every step, and space in every checkpoint of the history


class RelativeMotion(NamedTuple):
    """Pose of base_link at one stamp, in the axes of base_link at another.

    Attributes:
        from_stamp: stamp of the axes [ns].
        to_stamp: stamp of the pose [ns].
        pose: (3,) x forward, y left [m], yaw [rad] of base_link at `to_stamp` in base_link at
            `from_stamp`; yaw counts full turns.
        covariance: (3, 3) covariance of the error of `pose`, truth less estimate.
    """

    from_stamp: int
    to_stamp: int
    pose: Floats
    covariance: Floats

    @property
    def end_covariance(self) -> Floats:
        """Covariance (3, 3) of the error xi in truth = pose (+) Exp(xi), at `to_stamp`.

        GTSAM's `BetweenFactorPose2` takes this covariance, and g2o's `EDGE_SE2` its inverse.
        """
        turn = _rotations(-self.pose[2:])[0]
        return np.asarray(turn @ self.covariance @ turn.T)


class Clones(msgspec.Struct, frozen=True):
    """Motion since each of m marks, each computed separately; immutable."""

    stamps: tuple[int, ...]  # stamps of the marks [ns]
    poses: np.ndarray[Any, Any]  # (m, 3) poses of base_link in base_link at each mark
    cross: np.ndarray[Any, Any]  # (3m, n) covariance of `poses` with the filter's state
    covariance: np.ndarray[Any, Any]  # (3m, 3m) covariance of `poses`

    def __post_init__(self) -> None:
        m = len(self.stamps)
        shapes = (self.poses.shape, self.cross.shape, self.covariance.shape)
        size = self.cross.shape[-1] if self.cross.shape[-1:] == (s.WANDER.stop,) else s.SIZE
        if shapes != ((m, 3), (3 * m, size), (3 * m, 3 * m)):
            raise ValueError(f"{m} marks with arrays of shapes {shapes}")

    @classmethod
    def none(cls, size: int = s.SIZE) -> Clones:
        """Make an empty set, of a filter with the given number of states."""
        return cls((), np.zeros((0, 3)), np.zeros((0, size)), np.zeros((0, 0)))

    def begun(self, stamp: int, motion: Floats, by_state: Floats, P: Floats) -> Clones:
        """Add a clone at a stamp [ns].

        The motion (3,) since then has the derivative `by_state` (3, SIZE) by the state of covariance P.
        """
        cross = by_state @ P
        with_others = (_by_clone(self.cross) @ by_state.T).reshape(-1, 3)
        own = cross @ by_state.T
        covariance = [[self.covariance, with_others], [with_others.T, 0.5 * (own + own.T)]]
        poses, cross = np.vstack([self.poses, motion]), np.vstack([self.cross, cross])
        return Clones((*self.stamps, stamp), poses, cross, np.block(covariance))

    def without(self, stamp: int) -> Clones | None:
        """Remove the clone of a stamp [ns], if there is one; None if none is left."""
        keep = [index for index, other in enumerate(self.stamps) if other != stamp]
        if not keep:
            return None
        rows = (3 * np.array(keep)[:, None] + np.arange(3)).ravel()
        stamps = tuple(self.stamps[index] for index in keep)
        covariance = self.covariance[np.ix_(rows, rows)]
        return Clones(stamps, self.poses[keep], self.cross[rows], covariance)

    def moved(self, move: Moved) -> Clones:
        """Propagate over a step of the filter."""
        step, F, Q = move.step, move.F, move.Q
        turns = _rotations(self.poses[:, 2] - move.yaw)
        steps = turns @ step
        by_state, with_state = turns @ move.by_state, turns @ move.with_state
        carried = _after_steps(self.cross, steps)
        # Half of what the step adds to the covariance; the other half is its transpose.
        with_noise = turns @ (0.5 * Q[s.POSE, s.POSE])
        with_step = np.concatenate([_by_clone(carried) + 0.5 * with_state, with_noise], 2)
        by_step = np.concatenate([by_state, turns], 2)
        half = with_step[:, None] @ by_step.transpose(0, 2, 1)
        half = half.transpose(0, 2, 1, 3).reshape(self.covariance.shape)
        covariance = _after_steps(_after_steps(self.covariance, steps).T, steps) + (half + half.T)
        cross = (_by_clone(carried) + with_state) @ F.T + turns @ Q[s.POSE]
        cross, covariance = cross.reshape(self.cross.shape), 0.5 * (covariance + covariance.T)
        return Clones(self.stamps, self.poses + steps, cross, covariance)

    def renewed(self, states: slice | list[int] = s.FAST_SLIP) -> Clones:
        """Clear the correlation with replaced states: a new fast slip, or a lost pose."""
        cross = self.cross.copy()
        cross[:, states] = 0.0
        return Clones(self.stamps, self.poses, cross, self.covariance)

    def faded(self, states: slice, factor: float) -> Clones:
        """Scale the correlation with states that fade."""
        cross = self.cross.copy()
        cross[:, states] *= factor
        return Clones(self.stamps, self.poses, cross, self.covariance)

    def inflated(self, yaw: float, states: tuple[int, ...], covariance: Floats) -> Clones:
        """Inflate n states by a covariance (n, n) of the motion, which moves all poses."""
        size = self.cross.shape[1]
        added = np.zeros((size, size))
        added[np.ix_(states, states)] = covariance
        turns = _rotations(self.poses[:, 2] - yaw).reshape(-1, 3)
        cross = turns @ added[s.POSE]
        with_pose = (turns @ added[s.POSE, s.POSE]).reshape(-1, 3)
        own = np.block([[with_pose @ turn.T for turn in turns.reshape(-1, 3, 3)]])
        total = self.covariance + 0.5 * (own + own.T)
        return Clones(self.stamps, self.poses, self.cross + cross, total)

    def updated(self, update: Updated, *, fixed: bool, inflation: float = 0.0) -> Clones:
        """Update with a scalar measurement, after the filter.

        Poses do not move if they are `fixed`. `inflation`, a share of their variances, covers rounding.
        """
        z, S, state_gain = update.z, update.S, update.gain
        with_innovation = self.cross @ update.h
        poses, covariance = self.poses, self.covariance
        # Valid for any gain of the state: with fixed states it is not the optimal `update.cross / S`.
        cross = self.cross - with_innovation[:, None] * state_gain
        if not fixed:
            gain = with_innovation / S
            half = np.outer(gain, with_innovation - 0.5 * S * gain)
            poses, covariance = poses + z * gain.reshape(-1, 3), covariance - (half + half.T)
            cross -= np.outer(gain, update.cross - S * state_gain)
        if inflation:
            covariance = covariance + inflation * np.diag(self.covariance.diagonal())
        return Clones(self.stamps, poses, cross, covariance)

    def between(self, from_stamp: int, to_stamp: int | None, now: int) -> RelativeMotion:
        """Relative motion from one mark to another.

        Args:
            from_stamp: stamp of a mark [ns].
            to_stamp: stamp of another [ns], or None for now.
            now: stamp of the filter's estimate [ns].

        Raises:
            EstimatorError: there is no such mark.
        """
        start = self.place(from_stamp)
        of_start = slice(3 * start, 3 * start + 3)
        if to_stamp is None:
            pose, covariance = self.poses[start], self.covariance[of_start, of_start]
            return RelativeMotion(from_stamp, now, pose.copy(), _regular(covariance))
        # From the first mark to now, and back from there to the second: with the turn between the marks
        # the place is p_start - R(turn) p_end.
        end = self.place(to_stamp)
        to_now, from_end = self.poses[start], self.poses[end]
        turn = to_now[2] - from_end[2]
        rotation = _rotations(np.array([turn]))[0]
        x, y, _ = rotation @ from_end
        jacobian = np.zeros((3, len(self.cross)))
        jacobian[:, of_start] += np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
        by_end = -rotation
        by_end[:2, 2] = -y, x
        jacobian[:, 3 * end : 3 * end + 3] += by_end
        covariance = jacobian @ self.covariance @ jacobian.T
        pose = np.array([to_now[0] - x, to_now[1] - y, turn])
        return RelativeMotion(from_stamp, to_stamp, pose, _regular(covariance))

    def place(self, stamp: int) -> int:
        """Index of the clone of a stamp [ns]; `EstimatorError` if there is none."""
        if stamp not in self.stamps:
            marks = list(self.stamps)
            raise EstimatorError(f"there is no mark at {stamp}; there are marks at {marks}")
        return self.stamps.index(stamp)


def _regular(covariance: Floats) -> Floats:
    """Symmetric covariance (3, 3) with at least `LEAST_VARIANCE` in each direction."""
    variances, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    if variances[0] < LEAST_VARIANCE:
        covariance = axes * np.maximum(variances, LEAST_VARIANCE) @ axes.T
    return np.asarray(0.5 * (covariance + covariance.T))


def _by_clone(rows: Floats) -> Floats:
    """Rows (3m, n) of m clones as (m, 3, n)."""
    return rows.reshape(-1, 3, rows.shape[1])


def _after_steps(rows: Floats, steps: Floats) -> Floats:
    """Covariances (3m, n) of m clones' errors with others, after steps (m, 3)."""
    carried = rows.copy()
    carried[0::3] -= steps[:, 1:2] * rows[2::3]
    carried[1::3] += steps[:, 0:1] * rows[2::3]
    return carried


def _rotations(angles: Floats) -> Floats:
    """Rotations (n, 3, 3) of x, y and yaw by (n,) angles [rad]."""
    turns = np.zeros((len(angles), 3, 3))
    for turn, angle in zip(turns, angles.tolist(), strict=True):
        cos, sin = math.cos(angle), math.sin(angle)
        turn[:] = (cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)
    return turns
