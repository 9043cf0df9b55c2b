"""Stuck track sensors: one repeats a reading while the other track's changes.

Many sensors repeat readings: those sampled less often than they are published, and those of coarse
resolution at a steady speed. So repetition counts only if the other track has read many different values
meanwhile, and if it lasts much longer than this track's earlier repetitions.
"""

from __future__ import annotations

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND

# Required number of different readings of the other track, and of its own before.
OTHERS, OWN = 10, 20
# Repetition is unusual from this multiple of the longest before.
UNUSUAL = 3.0


class Repeating(msgspec.Struct, frozen=True):
    """Repetition record of one track's readings.

    Attributes:
        reading: newest reading [m/s].
        since: stamp of the first of the consecutive samples with this reading [ns].
        newest: stamp of the last of them [ns].
        others: distinct readings of the other track since then, at most `OTHERS` [m/s].
        changes: number of changes of the reading, at most `OWN`.
        longest: longest time of one reading while moving and not stuck [s].
    """

    reading: float
    since: int
    newest: int
    others: tuple[float, ...]
    changes: int = 0
    longest: float = 0.0

    def after(self, stamp: int, reading: float, other: float, hold: float) -> Repeating:
        """Record after one more sample.

        Args:
            stamp: stamp of the sample [ns].
            reading: reading of the track [m/s].
            other: reading of the other track [m/s].
            hold: a longer gap between samples starts a new record [s].
        """
        if (stamp - self.newest) * NANOSECOND > hold:
            return Repeating(reading, stamp, stamp, (other,), self.changes, self.longest)
        if reading != self.reading:
            longest = self.longest
            if self.repeats and self.reading != 0.0 and self.stuck_from(hold) is None:
                longest = max(longest, (self.newest - self.since) * NANOSECOND)
            return Repeating(reading, stamp, stamp, (other,), min(self.changes + 1, OWN), longest)
        others = self.others
        if len(others) < OTHERS and other not in others:
            others = (*others, other)
        return Repeating(reading, self.since, stamp, others, self.changes, self.longest)

    @property
    def repeats(self) -> bool:
        """True if the newest two samples have the same reading."""
        return self.since != self.newest

    def stuck_from(self, hold: float) -> int | None:
        """Stamp from which the reading is stuck [ns]; None if it is not.

        Args:
            hold: age up to which a reading is valid in any case [s].
        """
        if not self.repeats or len(self.others) < OTHERS or self.changes < OWN:
            return None
        start = self.since + int(max(hold, UNUSUAL * self.longest) / NANOSECOND)
        return start if self.newest > start and self.reading != 0.0 else None
