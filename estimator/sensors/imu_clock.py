"""Clock of the IMU: sample interval, and expectation of the next sample."""

from __future__ import annotations

from icreckon.estimator.base.array_types import NANOSECOND

# Assumed interval before it is measured [s].
USUAL_INTERVAL = 0.01
# Longest wait for the next sample, in intervals, and its lower bound [s].
INTERVALS_TO_WAIT, LEAST_WAIT = 1.5, 0.02


class ImuClock:
    """Clock of the IMU samples.

    Args:
        hold: an IMU without samples for longer has stopped [s].

    Attributes:
        stamp: stamp of the newest sample [ns], or None.
        interval: newest interval between samples that was not longer than `hold` [s].
    """

    def __init__(self, hold: float) -> None:
        self._hold = hold
        self.stamp: int | None = None
        self.interval = USUAL_INTERVAL

    def tick(self, stamp: int, *, used: bool) -> None:
        """Record a sample at a stamp [ns]; its interval counts if it is used."""
        if used and self.stamp is not None and self.is_alive(stamp):
            self.interval = (stamp - self.stamp) * NANOSECOND
        self.stamp = stamp

    def is_alive(self, stamp: int) -> bool:
        """Return True if a sample is expected that covers the motion up to a stamp [ns]."""
        return self.stamp is not None and (stamp - self.stamp) * NANOSECOND <= self._hold

    def is_due_after(self, stamp: int) -> bool:
        """Return True if a stamp [ns] lies in a step that the next sample will end soon."""
        if self.stamp is None:
            return False
        patience = max(INTERVALS_TO_WAIT * self.interval, LEAST_WAIT)
        return (stamp - self.stamp) * NANOSECOND <= patience
