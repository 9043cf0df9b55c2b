"""Whether a track's sensor is stuck: it repeats itself to the last bit, while the other one's does not.

Many sensors repeat themselves: those that are read less often than they are told of, and those of coarse
resolution at a steady speed. So repeating counts only where the other track has read many different
values meanwhile, and where it goes on for much longer than this track has repeated itself before.
"""

from __future__ import annotations

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND

# So many different readings of the other track there must be, and so many of its own before.
OTHERS, OWN = 10, 20
# A track's repeating is unusual from so many times the longest before.
UNUSUAL = 3.0


class Repeating(msgspec.Struct, frozen=True):
    """How long a track has read the same.

    Attributes:
        reading: the newest [m/s].
        since: stamp of the first sample of those in a row that read so [ns].
        newest: stamp of the last of them [ns].
        others: what the other track has read since then, each value once, at most `OTHERS` [m/s].
        changes: how often the reading has changed, at most `OWN`.
        longest: time that it has read the same for, moving and not stuck, at most [s].
    """

    reading: float
    since: int
    newest: int
    others: tuple[float, ...]
    changes: int = 0
    longest: float = 0.0

    def after(self, stamp: int, reading: float, other: float, hold: float) -> Repeating:
        """After one more sample.

        Args:
            stamp: of the sample [ns].
            reading: of the track [m/s].
            other: of the other track [m/s].
            hold: what comes later than this does not belong together [s].
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
        """Whether the newest two samples read the same."""
        return self.since != self.newest

    def stuck_from(self, hold: float) -> int | None:
        """Stamp from which the reading is not to be trusted [ns]; None where it is.

        Args:
            hold: how long a reading may be old in any case [s].
        """
        if not self.repeats or len(self.others) < OTHERS or self.changes < OWN:
            return None
        start = self.since + int(max(hold, UNUSUAL * self.longest) / NANOSECOND)
        return start if self.newest > start and self.reading != 0.0 else None
