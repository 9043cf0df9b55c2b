"""Changes of a filter that its kernels report, for marks and the smoother.

A kernel of a shape with `FilterShape.reports` stores the numbers of each change in rows of the workspace.
The kinds of the changes and their states are the same in each call (`Event`). `Events` reports them to a
listener.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats


class Event(NamedTuple):
    """One change."""

    # "renewed": new fast slip, upper triangle (6) of its covariance; "inflated": upper triangle of a
    # covariance that is added to states; "motion": likewise, an error of the motion; "updated": see
    # `Updated`; "moved": see `moved_values`
    kind: str
    states: tuple[int, ...]  # n states that the values are of
    fixed: tuple[int, ...]  # states that an update does not move
    values: tuple[Any, ...]  # the numbers


class Updated(NamedTuple):
    """Scalar update."""

    z: float  # innovation
    r: float  # variance of the measurement noise
    S: float  # variance of the innovation
    is_sharp: bool  # the noise is so small that rounding counts
    h: Floats  # (size,) Jacobian of the predicted measurement
    cross: Floats  # (size,) covariance of the state with the innovation
    gain: Floats  # (size,) Kalman gain
    fixed: tuple[int, ...]  # states that it does not move


class Moved(NamedTuple):
    """Step of the filter."""

    yaw: float  # yaw before it [rad]
    step: Floats  # (3,) increment of the pose
    by_state: Floats  # (3, size) its derivative by all states but the pose
    with_state: Floats  # (3, size) that derivative times the covariance before the step
    F: Floats  # (size, size) transition
    Q: Floats  # (size, size) process noise


class Listener(Protocol):
    """Receiver of the changes of a filter."""

    def renewed(self, covariance: Floats) -> None:
        """New fast slip of this covariance (3, 3), independent of the one before."""

    def inflated(self, states: Sequence[int], covariance: Floats, yaw: float | None = None) -> None:
        """Inflation of n states by a covariance (n, n); with a yaw [rad], of the motion."""

    def updated(self, change: Updated) -> None:
        """Scalar update."""

    def moved(self, step: Moved) -> None:
        """Step of the filter."""


class Events:
    """Changes that one call of a kernel reports; the values of `events` are not used."""

    def __init__(self, events: Sequence[Event]) -> None:
        self._events = [(event.kind, list(event.states), event.fixed) for event in events]
        self._ends = np.cumsum([len(event.values) for event in events])
        self._begins = np.concatenate([[0], self._ends[:-1]])

    def report(self, values: Floats, size: int, yaw: float, listener: Listener) -> None:
        """Report the changes of a call by their numbers (m,), from a yaw on [rad]."""
        if not self._events:
            return
        is_nonzero = np.logical_or.reduceat(values[: self._ends[-1]] != 0.0, self._begins)
        spans = zip(self._begins.tolist(), self._ends.tolist(), is_nonzero.tolist(), strict=True)
        for (kind, states, fixed), (begin, end, changed) in zip(self._events, spans, strict=True):
            if kind == "renewed":
                listener.renewed(_symmetric(values[begin:end], 3))
            elif not changed:
                continue
            elif kind == "updated":
                z, r, inverse_S, is_sharp = values[begin : begin + 4].tolist()
                if inverse_S > 0.0:  # zero if the update was not made
                    vectors = np.zeros((3, size))
                    vectors[:, states] = values[begin + 4 : end].reshape(3, -1)
                    h, cross, gain = vectors
                    S = 1.0 / inverse_S
                    listener.updated(Updated(z, r, S, is_sharp > 0.0, h, cross, gain, fixed))
            elif kind == "moved":
                listener.moved(_moved(values[begin:end], states, size))
            else:
                motion_yaw = yaw if kind == "motion" else None
                listener.inflated(states, _symmetric(values[begin:end], len(states)), motion_yaw)


def moved_values(
    yaw: Any,
    step: Sequence[Any],
    by_yaw: Sequence[Any],
    decay: Sequence[Any],
    rows: Sequence[Sequence[Any]],
) -> list[Any]:
    """Numbers of a step, in the order of `_moved`.

    Args:
        yaw: yaw before the step [rad].
        step: (4,) increment of pose and height.
        by_yaw: (2,) derivative of its x and y by the yaw.
        decay: (3,) factors on the slip.
        rows: (15, n) of n states. 0 to 3: derivatives of the increment; 4 to 7: these times the
            covariance; 8 to 11: noise of the increment with the states; 12: noise of each state;
            13, 14: transition of gravity.
    """
    return [yaw, *step, *by_yaw, *decay, *(value for row in rows for value in row)]


def _moved(values: Floats, states: list[int], size: int) -> Moved:
    """Step of a filter with `size` states, from the values of `moved_values`."""
    # Value 4 and row 7 are of the height, which is no part of a `Moved` step.
    yaw, step, by_yaw, decay = values.item(0), values[1:4].copy(), values[5:7], values[7:10]
    rows = np.zeros((15, size))
    rows[:, states] = values[10:].reshape(15, -1)
    by_state, with_state, Q, F = rows[:3], rows[4:7], np.zeros((size, size)), np.eye(size)
    F[s.MOVED] += rows[:4]
    F[s.POSITION, s.YAW] += by_yaw
    F[s.SLIP, s.SLIP] = np.diag(decay)
    F[s.GRAVITY] = rows[13:]
    Q[s.MOVED], Q[:, s.MOVED] = rows[8:12], rows[8:12].T
    Q[np.diag_indices(size)] += rows[12]
    return Moved(yaw, step, by_state, with_state, F, Q)


def _symmetric(upper: Floats, n: int) -> Floats:
    """Matrix (n, n) of its upper triangle, row by row."""
    return upper[_entries(n)]


@cache
def _entries(n: int) -> NDArray[np.intp]:
    """Places of all entries of a matrix (n, n) in its upper triangle."""
    places = np.zeros((n, n), np.intp)
    places[np.triu_indices(n)] = np.arange(n * (n + 1) // 2)
    return np.maximum(places, places.T)
