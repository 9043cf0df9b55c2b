"""Clock of a sensor: newest stamp, interval, expectation of the next sample.

The functions are written for plain Python and for numba, see `icreckon.estimator.base.records`.
"""

from typing import Protocol

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Interval, Stamp

USUAL_INTERVAL = 0.01  # assumed interval before it is measured [s]
# Longest wait for the next sample, in intervals, and its lower bound [s].
INTERVALS_TO_WAIT, LEAST_WAIT = 1.5, 0.02


class Clocked(Protocol):
    """Record with the stamp [ns] and the interval [s] of the newest sample."""

    stamp: int
    interval: float


class ClockRecord(msgspec.Struct):
    """Clock of the samples of one sensor."""

    stamp: Stamp = NEVER  # stamp of the newest sample [ns], or NEVER
    interval: Interval = USUAL_INTERVAL  # newest interval up to `hold` [s]


def take_stamp(clock: Clocked, stamp: int, hold: float) -> None:
    """Add a sample at a stamp [ns]; an interval longer than `hold` [s] does not count."""
    interval = (stamp - clock.stamp) * NANOSECOND
    if 0.0 < interval <= hold:
        clock.interval = interval
    clock.stamp = stamp


def is_alive(clock: Clocked, stamp: int, hold: float) -> bool:
    """Return True if the newest sample is at most `hold` [s] older than a stamp [ns]."""
    return (stamp - clock.stamp) * NANOSECOND <= hold


def is_due_after(clock: Clocked, stamp: int) -> bool:
    """Return True if a stamp [ns] lies in a step that the next sample will end soon."""
    patience = max(INTERVALS_TO_WAIT * clock.interval, LEAST_WAIT)
    return (stamp - clock.stamp) * NANOSECOND <= patience


def interval_start(clock: Clocked, stamp: int) -> int:
    """Stamp [ns] at which the interval of a sample at a stamp [ns] begins."""
    return stamp - int(clock.interval / NANOSECOND)
