"""Covariance matrix in traced numbers, with postponed updates.

An update with a scalar measurement is stored as the product of two vectors, and subtracted only in
entries that are used. So a step of several updates reads and writes each entry once.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

Vector = dict[int, Any]


class ScalarUpdate(NamedTuple):
    """Postponed update with a scalar measurement.

    Attributes:
        gain: state -> Kalman gain; none for fixed states.
        cross: state -> covariance with the innovation, P H'.
        inverse_S: one over the innovation covariance; 0 for no update.
    """

    gain: Vector
    cross: Vector
    inverse_S: Any


class Covariance:
    """Covariance of some states, by their indices; all other states have none.

    Args:
        entries: entries that are not zero, by pair of states, the smaller index first.
    """

    def __init__(self, entries: dict[tuple[int, int], Any]) -> None:
        self._entries = dict(entries)
        self._updates: list[ScalarUpdate] = []
        self.states = sorted({state for pair in entries for state in pair})

    def entry(self, a: int, b: int) -> Any:
        """Covariance of two states."""
        value = self._base(a, b)
        for gain, cross, _ in self._updates:
            # Gains are zero or optimal; in both cases this equals the Joseph form. `update` adds what
            # the gain of a stand-in changes to the entries.
            if a in gain:
                value = value - gain[a] * cross.get(b, 0.0)
            elif b in gain:
                value = value - gain[b] * cross.get(a, 0.0)
        return value

    def times(self, row: Vector, *parts: tuple[Any, Vector]) -> Vector:
        """Product with a vector.

        Args:
            row: the vector, or part of it.
            parts: the rest, each a factor and a vector. Products with such a vector are computed once
                for all vectors that it is a part of.
        """
        all_parts = (*parts, (1.0, row))
        result: Vector = {}
        for a in self.states:
            total: Any = 0.0
            for factor, part in all_parts:
                total = total + factor * dot({b: self._base(a, b) for b in part}, part)
            result[a] = total
        for gain, cross, inverse_S in self._updates:
            of_all: Any = 0.0
            of_fixed: Any = 0.0
            for factor, part in all_parts:
                fixed = {b: value for b, value in part.items() if b not in gain}
                of_all = of_all + factor * dot(cross, part)
                of_fixed = of_fixed + factor * dot(cross, fixed)
            of_moved = (of_all - of_fixed) * inverse_S
            for a in self.states:
                if a in gain:
                    result[a] = result[a] - gain[a] * of_all
                else:
                    result[a] = result[a] - cross.get(a, 0.0) * of_moved
        return result

    def add(self, a: int, b: int, value: Any) -> None:
        """Add to the entry of a pair of states."""
        pair = (a, b) if a <= b else (b, a)
        self._entries[pair] = self._entries.get(pair, 0.0) + value

    def update(
        self,
        cross: Vector,
        inverse_S: Any,
        fixed: Iterable[int] = (),
        stand_in: tuple[int, Vector] | None = None,
    ) -> Vector:
        """Update with a scalar measurement.

        Args:
            cross: covariance of the states with the innovation.
            inverse_S: one over the innovation covariance, or 0 for no update.
            fixed: states that the update does not move.
            stand_in: state that it moves in their place, and the Jacobian of the predicted measurement,
                see `reference.ekf.IcrEkf.update_scalar`.

        Returns:
            State -> Kalman gain, without the fixed states.
        """
        gain = {i: value * inverse_S for i, value in cross.items() if i not in fixed}
        self._updates.append(ScalarUpdate(gain, cross, inverse_S))
        if stand_in is None:
            return gain
        state, H = stand_in
        held = {i: cross[i] for i in fixed if i in cross}
        missing = dot(held, {i: by for i, by in H.items() if i in held}) / H[state]
        more = missing * inverse_S
        for i, value in held.items():
            self.add(state, i, -(more * value))
        self.add(state, state, more * missing)
        return gain | {state: gain[state] + more}

    def inflate(self, share: Any) -> Vector:
        """Add a share of the variances before the postponed updates to those after them.

        Returns:
            State -> what was added to its variance.
        """
        added = {i: share * self._base(i, i) for i in self.states}
        for i, more in added.items():
            self.add(i, i, more)
        return added

    def _base(self, a: int, b: int) -> Any:
        return self._entries.get((a, b) if a <= b else (b, a), 0.0)


def dot(a: Vector, b: Vector) -> Any:
    """Dot product of two sparse vectors."""
    total: Any = 0.0
    for state, value in b.items():
        if state in a:
            total = total + a[state] * value
    return total
