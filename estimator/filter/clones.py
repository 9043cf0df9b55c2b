"""How far the robot has moved since a mark, with a covariance that knows what the two poses share.

A mark begins a pose of its own: that of base_link in the axes that base_link had at the mark. It is
moved by the same steps as the filter's pose, with the same noise, and its covariance with the filter's
state and with the other marks is carried along (after Roumeliotis and Burdick, Stochastic cloning, ICRA
2002). The pose in odom has no part in it, so neither has what is not known of that: a fix that turns the
whole path does not bend the motion, as it would bend that from a clone of the pose in odom.

Like the pose, it is moved by fixes, and by nothing else but its own steps.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import msgspec
import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError

# Each costs time in every step, and space in every checkpoint of the history.
MOST_MARKS = 20


class RelativeMotion(NamedTuple):
    """Where base_link was at one stamp, as seen from base_link at another.

    Attributes:
        from_stamp: of the axes that it is given in [ns].
        to_stamp: of the pose that is given [ns].
        pose: (3,) x forward, y left [m], yaw [rad] of base_link at `to_stamp` in base_link at
            `from_stamp`; yaw counts full turns.
        covariance: (3, 3) of the error of these three numbers, truth less estimate.
    """

    from_stamp: int
    to_stamp: int
    pose: Floats
    covariance: Floats

    @property
    def end_covariance(self) -> Floats:
        """(3, 3) of the error xi with truth = pose (+) Exp(xi), in base_link's axes at `to_stamp`.

        GTSAM's `BetweenFactorPose2` takes this one, and g2o's `EDGE_SE2` its inverse.
        """
        turn = _turns(-self.pose[2:])[0]
        return np.asarray(turn @ self.covariance @ turn.T)


class Marks(msgspec.Struct, frozen=True):
    """The motion since each of m marks; nothing in it is ever changed.

    Attributes:
        stamps: of the marks [ns].
        poses: (m, 3) of base_link in base_link at each mark.
        cross: (3m, SIZE) covariance of `poses` with the filter's state.
        covariance: (3m, 3m) of `poses`.
    """

    stamps: tuple[int, ...]
    poses: np.ndarray[Any, Any]
    cross: np.ndarray[Any, Any]
    covariance: np.ndarray[Any, Any]

    def __post_init__(self) -> None:
        m = len(self.stamps)
        shapes = (self.poses.shape, self.cross.shape, self.covariance.shape)
        if shapes != ((m, 3), (3 * m, s.SIZE), (3 * m, 3 * m)):
            raise ValueError(f"{m} marks with arrays of shapes {shapes}")

    @classmethod
    def none(cls) -> Marks:
        """No marks yet."""
        return cls((), np.zeros((0, 3)), np.zeros((0, s.SIZE)), np.zeros((0, 0)))

    def begun(self, stamp: int, motion: Floats, by_state: Floats, P: Floats) -> Marks:
        """With one more.

        Args:
            stamp: of the mark [ns].
            motion: (3,) how far the robot has moved since then.
            by_state: (3, SIZE) derivative of that by the filter's state.
            P: (SIZE, SIZE) the filter's covariance.
        """
        cross = by_state @ P
        with_others = self.cross @ by_state.T
        return Marks(
            (*self.stamps, stamp),
            np.vstack([self.poses, motion]),
            np.vstack([self.cross, cross]),
            np.block([[self.covariance, with_others], [with_others.T, cross @ by_state.T]]),
        )

    def without(self, stamp: int) -> Marks | None:
        """Without the one of this stamp [ns], if there; None when none is left."""
        keep = [index for index, other in enumerate(self.stamps) if other != stamp]
        if not keep:
            return None
        rows = (3 * np.array(keep)[:, None] + np.arange(3)).ravel()
        return Marks(
            tuple(self.stamps[index] for index in keep),
            self.poses[keep],
            self.cross[rows],
            self.covariance[np.ix_(rows, rows)],
        )

    def moved(
        self, yaw: float, step: Floats, by_state: Floats, P: Floats, F: Floats, Q: Floats
    ) -> Marks:
        """After a step of the filter.

        Args:
            yaw: of the filter's pose before the step [rad].
            step: (3,) what the step adds to that pose.
            by_state: (3, SIZE) derivative of `step` by all but the pose.
            P: (SIZE, SIZE) the filter's covariance before the step.
            F: (SIZE, SIZE) transition of the filter's state.
            Q: (SIZE, SIZE) noise of the step.
        """
        turns = _turns(self.poses[:, 2] - yaw)
        steps = turns @ step
        turn = turns.reshape(-1, 3)
        own = np.eye(len(turn))
        first = np.arange(0, len(turn), 3)
        own[first, first + 2] = -steps[:, 1]
        own[first + 1, first + 2] = steps[:, 0]
        by_state = turn @ by_state
        carried, moved = own @ self.cross, by_state @ P
        mixed = carried @ by_state.T
        covariance = own @ self.covariance @ own.T + mixed + mixed.T + moved @ by_state.T
        covariance += turn @ Q[s.POSE, s.POSE] @ turn.T
        return Marks(
            self.stamps,
            self.poses + steps,
            (carried + moved) @ F.T + turn @ Q[s.POSE],
            0.5 * (covariance + covariance.T),
        )

    def renewed(self, states: slice = s.FAST_SLIP) -> Marks:
        """After states were drawn anew: the fast slip, or a pose that was lost."""
        cross = self.cross.copy()
        cross[:, states] = 0.0
        return Marks(self.stamps, self.poses, cross, self.covariance)

    def updated(
        self,
        residual: float,
        row: Floats,
        cross: Floats,
        gain: Floats,
        expected: float,
        *,
        kept: bool,
    ) -> Marks:
        """After a scalar update of the filter, see `IcrEkf.update_scalar`.

        Args:
            residual: measured less predicted.
            row: (SIZE,) Jacobian of the prediction.
            cross: (SIZE,) the filter's covariance times `row`.
            gain: (SIZE,) that the filter has used.
            expected: variance of the residual.
            kept: whether the poses are not to be moved; their covariance takes it into account.
        """
        own = self.cross @ row
        own_gain = np.zeros_like(own) if kept else own / expected
        half = np.outer(own_gain, own - 0.5 * expected * own_gain)
        return Marks(
            self.stamps,
            self.poses + residual * own_gain.reshape(-1, 3),
            self.cross - np.outer(own, gain) - np.outer(own_gain, cross - expected * gain),
            self.covariance - (half + half.T),
        )

    def between(self, from_stamp: int, to_stamp: int | None, now: int) -> RelativeMotion:
        """From one mark to another.

        Args:
            from_stamp: of a mark [ns].
            to_stamp: of another [ns], or None for now.
            now: stamp of the filter's estimate [ns].

        Raises:
            EstimatorError: there is no such mark.
        """
        start = self.place(from_stamp)
        pose = self.poses[start]
        rows = slice(3 * start, 3 * start + 3)
        if to_stamp is None:
            return RelativeMotion(from_stamp, now, pose.copy(), self.covariance[rows, rows].copy())
        # The way from the first mark to now, and back to the second.
        end = self.place(to_stamp)
        back = self.poses[end]
        turn = _turns(np.array([pose[2] - back[2]]))[0]
        x, y, _ = turn @ back
        jacobian = np.zeros((3, len(self.cross)))
        jacobian[:, rows] += np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
        by_end = -turn
        by_end[:2, 2] = -y, x
        jacobian[:, 3 * end : 3 * end + 3] += by_end
        covariance = jacobian @ self.covariance @ jacobian.T
        relative = np.array([pose[0] - x, pose[1] - y, pose[2] - back[2]])
        return RelativeMotion(from_stamp, to_stamp, relative, covariance)

    def place(self, stamp: int) -> int:
        """Which of the marks is that of a stamp [ns].

        Raises:
            EstimatorError: none is.
        """
        if stamp not in self.stamps:
            raise EstimatorError(
                f"there is no mark at {stamp}; there are marks at {list(self.stamps)}"
            )
        return self.stamps.index(stamp)


def _turns(angles: Floats) -> Floats:
    """(n, 3, 3) what rotations by (n,) angles [rad] do to x, y and yaw."""
    turns = np.zeros((len(angles), 3, 3))
    for turn, angle in zip(turns, angles.tolist(), strict=True):
        cos, sin = math.cos(angle), math.sin(angle)
        turn[:] = (cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)
    return turns
