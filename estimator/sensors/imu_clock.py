"""When IMU samples come, and what may wait for the next of them."""

from __future__ import annotations

from icreckon.estimator.base.array_types import NANOSECOND

# Time between two samples before it is known [s].
USUAL_INTERVAL = 0.01
# The next sample may be waited for this many intervals, or this long [s] where they are shorter.
INTERVALS_TO_WAIT, LEAST_WAIT = 1.5, 0.02


class ImuClock:
    """The stamps of the IMU samples.

    Args:
        hold: an IMU that is silent for longer has stopped [s].

    Attributes:
        stamp: of the newest sample [ns], or None.
        interval: time between the newest two that were not further apart than `hold` [s].
    """

    def __init__(self, hold: float) -> None:
        self._hold = hold
        self.stamp: int | None = None
        self.interval = USUAL_INTERVAL

    def tick(self, stamp: int, *, used: bool) -> None:
        """A sample comes at a stamp [ns]; its interval counts if it is used."""
        if used and self.stamp is not None and self.is_alive(stamp):
            self.interval = (stamp - self.stamp) * NANOSECOND
        self.stamp = stamp

    def is_alive(self, stamp: int) -> bool:
        """Whether a sample may be expected that tells how the robot moved up to this stamp [ns]."""
        return self.stamp is not None and (stamp - self.stamp) * NANOSECOND <= self._hold

    def is_due_after(self, stamp: int) -> bool:
        """Whether a stamp [ns] lies in a step that the next sample is soon to end."""
        if self.stamp is None:
            return False
        patience = max(INTERVALS_TO_WAIT * self.interval, LEAST_WAIT)
        return (stamp - self.stamp) * NANOSECOND <= patience
