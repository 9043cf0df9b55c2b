"""Changes of a filter that its kernels report, for marks and the smoother.

A kernel of a shape with `FilterShape.reports` stores the numbers of each change in rows of the workspace.
Which changes these are, and of which states, is the same in each call (`Event`). `tell` passes them on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats


class Event(NamedTuple):
    """One change.

    Attributes:
        kind: "renewed": new fast slip, upper triangle (6) of its covariance; "inflated": upper triangle
            of a covariance that is added to states; "motion": likewise, an error of the motion;
            "updated": see `Updated`; "projected": change (n,) of the state by its bounds; "moved": see
            `moved_values`.
        states: n states that the values are of.
        fixed: states that an update does not move.
        values: the numbers.
    """

    kind: str
    states: tuple[int, ...]
    fixed: tuple[int, ...]
    values: tuple[Any, ...]


class Updated(NamedTuple):
    """Scalar update.

    Attributes:
        z: innovation.
        r: variance of the measurement noise.
        S: variance of the innovation.
        is_sharp: the noise is so small that rounding counts.
        h: (size,) Jacobian of the predicted measurement.
        cross: (size,) covariance of the state with the innovation.
        gain: (size,) Kalman gain.
        fixed: states that it does not move.
    """

    z: float
    r: float
    S: float
    is_sharp: bool
    h: Floats
    cross: Floats
    gain: Floats
    fixed: tuple[int, ...]


class Moved(NamedTuple):
    """Step of the filter.

    Attributes:
        yaw: yaw before it [rad].
        step: (3,) increment of the pose.
        by_state: (3, size) its derivative by all states but the pose.
        with_state: (3, size) the same times the covariance before the step.
        F: (size, size) transition.
        Q: (size, size) process noise.
    """

    yaw: float
    step: Floats
    by_state: Floats
    with_state: Floats
    F: Floats
    Q: Floats


class Listener(Protocol):
    """Receiver of the changes of a filter."""

    def renewed(self, covariance: Floats) -> None:
        """New fast slip of this covariance (3, 3), independent of the one before."""

    def inflated(self, states: Sequence[int], covariance: Floats, yaw: float | None = None) -> None:
        """Inflation of n states by a covariance (n, n); with a yaw [rad], of the motion."""

    def updated(self, of: Updated) -> None:
        """Scalar update."""

    def projected(self, change: Floats) -> None:
        """Projection of the state to its bounds by this change (size,)."""

    def moved(self, of: Moved) -> None:
        """Step."""


def tell(
    events: Sequence[Event], values: Floats, size: int, yaw: float, listener: Listener
) -> None:
    """Pass the changes of one call of a kernel on.

    Args:
        events: the changes that the kernel reports.
        values: (m,) their numbers.
        size: number of states of the filter.
        yaw: yaw before the call [rad].
        listener: receiver.
    """
    begin = 0
    for event in events:
        states, end = event.states, begin + len(event.values)
        of_event, begin = values[begin:end], end
        match event.kind:
            case "renewed":
                listener.renewed(_symmetric(of_event, 3))
            case "inflated" | "motion":
                if of_event.any():
                    at = yaw if event.kind == "motion" else None
                    listener.inflated(states, _symmetric(of_event, len(states)), at)
            case "updated":
                z, r, inverse_S, is_sharp = of_event[:4].tolist()
                if inverse_S > 0.0:
                    vectors = np.zeros((3, size))
                    vectors[:, states] = of_event[4:].reshape(3, -1)
                    h, cross, gain = vectors
                    of = Updated(z, r, 1.0 / inverse_S, is_sharp > 0.0, h, cross, gain, event.fixed)
                    listener.updated(of)
            case "projected":
                if of_event.any():
                    change = np.zeros(size)
                    change[list(states)] = of_event
                    listener.projected(change)
            case "moved":
                listener.moved(_moved(of_event, list(states), size))


def moved_values(
    yaw: Any,
    step: Sequence[Any],
    by_yaw: Sequence[Any],
    decay: Sequence[Any],
    back: Sequence[Any],
    rows: Sequence[Sequence[Any]],
) -> list[Any]:
    """Numbers of a step, in the order of `_moved`.

    Args:
        yaw: yaw before the step.
        step: (3,) increment of the pose.
        by_yaw: (2,) derivative of its x and y by the yaw.
        decay: (3,) factors on the slip.
        back: (2,) factors that turn gravity back: cosine and sine, times its decay.
        rows: (10, n) by state: derivatives of the increment (3), the same times the covariance (3), noise
            of the pose with the states (3), noise of each state.
    """
    return [yaw, *step, *by_yaw, *decay, *back, *(value for row in rows for value in row)]


def _moved(values: Floats, states: list[int], size: int) -> Moved:
    yaw, step, by_yaw, decay = values.item(0), values[1:4].copy(), values[4:6], values[6:9]
    cos, sin = values[9:11]
    rows = np.zeros((10, size))
    rows[:, states] = values[11:].reshape(10, -1)
    by_state, with_state, Q, F = rows[:3], rows[3:6], np.zeros((size, size)), np.eye(size)
    F[s.POSE] += by_state
    F[s.POSITION, s.YAW] += by_yaw
    F[s.SLIP, s.SLIP] = np.diag(decay)
    F[s.GRAVITY, s.GRAVITY] = np.array([[cos, sin], [-sin, cos]])
    Q[s.POSE], Q[:, s.POSE] = rows[6:9], rows[6:9].T
    Q[np.diag_indices(size)] += rows[9]
    return Moved(yaw, step, by_state, with_state, F, Q)


def _symmetric(upper: Floats, n: int) -> Floats:
    """Matrix (n, n) of its upper triangle, row by row."""
    found = np.zeros((n, n))
    found[np.triu_indices(n)] = upper
    return found + np.triu(found, 1).T
