"""A covariance in traced numbers that is worked out as late as possible.

Updates with scalar measurements are kept as what they are, products of two vectors, and taken off only
where an entry is asked for. So a step of several updates reads and writes each entry once.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

Vector = dict[int, Any]


class Taken(NamedTuple):
    """What an update takes off: `gain` of a state times `cross` of another.

    Attributes:
        gain: state -> gain; none for those that the update keeps.
        cross: state -> covariance with the prediction.
        per_expected: what gains are of `cross`.
    """

    gain: Vector
    cross: Vector
    per_expected: Any


class Covariance:
    """The covariance of some states, each known by its index; others are as if they were not there.

    Args:
        entries: of each pair of states, the smaller first, where it is not zero.
    """

    def __init__(self, entries: dict[tuple[int, int], Any]) -> None:
        self._entries = dict(entries)
        self._taken: list[Taken] = []
        self.states = sorted({state for pair in entries for state in pair})

    def entry(self, a: int, b: int) -> Any:
        """Of a pair of states."""
        value = self._base(a, b)
        for gain, cross, _ in self._taken:
            # Gains are zero, or those that are best; either way this is what the Joseph form comes to.
            if a in gain:
                value = value - gain[a] * cross.get(b, 0.0)
            elif b in gain:
                value = value - gain[b] * cross.get(a, 0.0)
        return value

    def times(self, row: Vector, *parts: tuple[Any, Vector]) -> Vector:
        """It times a vector.

        Args:
            row: the vector, or part of it.
            parts: the rest, each a factor and a vector. What is worked out for such a vector is shared
                by all that it is a part of.
        """
        all_parts = (*parts, (1.0, row))
        result: Vector = {}
        for a in self.states:
            total: Any = 0.0
            for factor, part in all_parts:
                total = total + factor * dot({b: self._base(a, b) for b in part}, part)
            result[a] = total
        for gain, cross, per_expected in self._taken:
            of_all: Any = 0.0
            of_kept: Any = 0.0
            for factor, part in all_parts:
                kept = {b: value for b, value in part.items() if b not in gain}
                of_all = of_all + factor * dot(cross, part)
                of_kept = of_kept + factor * dot(cross, kept)
            of_moved = (of_all - of_kept) * per_expected
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

    def take(self, cross: Vector, per_expected: Any, kept: Iterable[int] = ()) -> Vector:
        """An update is made.

        Args:
            cross: covariance of the states with the prediction.
            per_expected: one over the variance of the residual, or 0 for no update.
            kept: states that are not to be moved.

        Returns:
            State -> gain, of those that are.
        """
        gain = {i: value * per_expected for i, value in cross.items() if i not in kept}
        self._taken.append(Taken(gain, cross, per_expected))
        return gain

    def _base(self, a: int, b: int) -> Any:
        return self._entries.get((a, b) if a <= b else (b, a), 0.0)


def dot(a: Vector, b: Vector) -> Any:
    """Of two vectors; what one of them has not is zero."""
    total: Any = 0.0
    for state, value in b.items():
        if state in a:
            total = total + a[state] * value
    return total
