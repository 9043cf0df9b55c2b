"""Covariance matrix in traced numbers, with postponed updates.

An update with a scalar measurement is stored as the product of two vectors, and subtracted only in
entries that are used. So a step of several updates reads and writes each entry once.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.trace import Real

Vector = dict[int, Real]
States = Iterable[int]  # indices of states
# State that moves in place of fixed ones, and the Jacobian of the predicted measurement.
StandIn = tuple[int, Vector] | None


class ScalarUpdate(NamedTuple):
    """Postponed update with a scalar measurement."""

    gain: Vector  # state -> Kalman gain; none for fixed states
    cross: Vector  # state -> covariance with the innovation, P H'
    inverse_S: Real  # one over the innovation covariance; 0 for no update


class Motion(NamedTuple):
    """Transition and noise of a propagation, F and Q."""

    rows: Sequence[Vector]  # derivatives of the twist, and of the climb
    M_dt: Sequence[Sequence[Real]]  # derivatives of pose and height by twist and climb
    yaws: Sequence[Real]  # derivatives of the pose by the yaw at the start
    faded: dict[int, Vector]  # rows of the transition of all other states
    noise: dict[tuple[int, int], Real]  # covariances that pose and height gain, by pair of states
    own: Vector  # variance that each state gains


class Covariance:
    """Covariance of some states, by their indices; all other states have none.

    Args:
        entries: entries that are not zero, by pair of states, the smaller index first.
    """

    def __init__(self, entries: dict[tuple[int, int], Real]) -> None:
        self._entries = dict(entries)
        self._updates: list[ScalarUpdate] = []
        self._errors: list[tuple[Real, Vector]] = []
        self.states = sorted({state for pair in entries for state in pair})

    def entry(self, a: int, b: int) -> Real:
        """Covariance of two states."""
        value = self._before_updates(a, b)
        for gain, cross, _ in self._updates:
            # Gains are zero or optimal; in both cases this equals the Joseph form. `update` adds what
            # the gain of a stand-in changes to the entries.
            if a in gain:
                value = value - gain[a] * cross.get(b, 0.0)
            elif b in gain:
                value = value - gain[b] * cross.get(a, 0.0)
        return value

    def between(self, a: Vector, b: Vector) -> Real:
        """Covariance of two linear combinations of states."""
        total: Real = 0.0
        for i, by_i in a.items():
            for j, by_j in b.items():
                total = total + self.entry(i, j) * (by_i * by_j)
        return total

    def times(self, row: Vector, *parts: tuple[Real, Vector]) -> Vector:
        """Product with a vector: the sum of `row` and `parts`, each a factor and a vector.

        Products with such a part are computed once for all vectors that have it.
        """
        all_parts = (*parts, (1.0, row))
        result: Vector = {}
        for a in self.states:
            total: Real = 0.0
            for factor, part in all_parts:
                total = total + factor * dot({b: self._stored(a, b) for b in part}, part)
            result[a] = total
        for weight, error in self._errors:
            moved = sum((factor * dot(error, part) for factor, part in all_parts), start=0.0)
            for a, value in error.items():
                result[a] = result[a] + value * (weight * moved)
        for gain, cross, inverse_S in self._updates:
            along_all: Real = 0.0
            along_fixed: Real = 0.0
            for factor, part in all_parts:
                fixed = {b: value for b, value in part.items() if b not in gain}
                along_all = along_all + factor * dot(cross, part)
                along_fixed = along_fixed + factor * dot(cross, fixed)
            along_moved = (along_all - along_fixed) * inverse_S
            for a in self.states:
                if a in gain:
                    result[a] = result[a] - gain[a] * along_all
                else:
                    result[a] = result[a] - cross.get(a, 0.0) * along_moved
        return result

    def add(self, a: int, b: int, value: Real) -> None:
        """Add to the entry of a pair of states."""
        pair = (a, b) if a <= b else (b, a)
        self._entries[pair] = self._entries.get(pair, 0.0) + value

    def add_error(self, error: Vector, weight: Real = 1.0) -> None:
        """Add the covariance of an error that moves some states, times a weight."""
        self._errors.append((weight, error))

    def update(
        self, cross: Vector, inverse_S: Real, fixed: States = (), stand_in: StandIn = None
    ) -> Vector:
        """Update with a scalar measurement; return the Kalman gain of states not fixed.

        Args:
            cross: covariance of the states with the innovation.
            inverse_S: one over the innovation covariance, or 0 for no update.
            fixed: states that the update does not move.
            stand_in: state that it moves in their place, and the Jacobian of the predicted measurement,
                see `reference.ekf.IcrEkf.update_scalar`.
        """
        gain = {i: value * inverse_S for i, value in cross.items() if i not in fixed}
        self._updates.append(ScalarUpdate(gain, cross, inverse_S))
        if stand_in is None:
            return gain
        state, _ = stand_in
        fixed_entries, missing = _missing(cross, fixed, *stand_in)
        added_gain = missing * inverse_S
        for i, value in fixed_entries.items():
            self.add(state, i, -(added_gain * value))
        self.add(state, state, added_gain * missing)
        return gain | {state: gain[state] + added_gain}

    def correct(
        self, x: Any, z: Real, cross: Vector, inverse_S: Real, fixed: States, stand_in: StandIn
    ) -> Vector:
        """Update with a scalar measurement z, and move the states x; see `update`."""
        gain = self.update(cross, inverse_S, fixed, stand_in)
        for i, by in gain.items():
            x[i] = x[i] + by * z
        return gain

    def inflate(self, share: Real) -> Vector:
        """Add a share of the variances before the updates; return additions by state."""
        added = {i: share * self._before_updates(i, i) for i in self.states}
        for i, variance in added.items():
            self.add(i, i, variance)
        return added

    def _stored(self, a: int, b: int) -> Real:
        """Stored entry of a pair of states, without postponed updates and errors."""
        return self._entries.get((a, b) if a <= b else (b, a), 0.0)

    def _before_updates(self, a: int, b: int) -> Real:
        """Entry of a pair of states with the added errors, before the postponed updates."""
        value = self._stored(a, b)
        for weight, error in self._errors:
            if a in error and b in error:
                value = value + weight * (error[a] * error[b])
        return value


def _missing(cross: Vector, fixed: States, state: int, H: Vector) -> tuple[Vector, Real]:
    """Entries of fixed states in P H', and what the stand-in's entry lacks for them.

    The latter, times the stand-in's derivative in H, is the part of fixed states in H P H'.
    """
    fixed_entries = {i: cross[i] for i in fixed if i in cross}
    fixed_row = {i: by for i, by in H.items() if i in fixed_entries}
    return fixed_entries, dot(fixed_entries, fixed_row) / H[state]


def combined(row: Vector, *parts: tuple[Real, Vector]) -> Vector:
    """Sum of a sparse vector and of others times their factors."""
    total = dict(row)
    for factor, part in parts:
        for i, value in part.items():
            total[i] = total.get(i, 0.0) + factor * value
    return total


def dot(a: Vector, b: Vector) -> Real:
    """Dot product of two sparse vectors."""
    total: Real = 0.0
    for state, value in b.items():
        if state in a:
            total = total + a[state] * value
    return total


def shift_of(row: Vector, x: Any, since: Any) -> Real:
    """Change of a predicted measurement since the state of its linearisation."""
    total: Real = 0.0
    for i, by in row.items():
        moved = x[i] - since[i]
        if not trace.is_zero(moved):
            total = total + by * moved
    return total
