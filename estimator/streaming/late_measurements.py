"""The last seconds of measurements, and how to work through them again when one comes late."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from itertools import pairwise
from typing import Any, NamedTuple

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.filter import Reckoning
from icreckon.estimator.filter.health import HISTORY_FULL, TOO_OLD
from icreckon.estimator.log.input_checks import Event, Key, event_of, event_row, key_of
from icreckon.estimator.log.measurements import Mark

# Before any measurement.
BEFORE_ALL: Key = (-(2**63), -1)
# Number of measurements between two checkpoints.
CHECKPOINT_EVERY = 16
# Highest number of checkpoints, however fast measurements come.
MOST_CHECKPOINTS = 1000


class HistoryMemory(msgspec.Struct, frozen=True):
    """All that a `History` goes by, but for the checkpoints that can be made again.

    Attributes:
        after: key of the last measurement before the history.
        memory: what the filter knew after it.
        measurements: those since then, marks among them, in order; a row each, see `event_row`.
    """

    after: Key
    memory: FilterCheckpoint
    measurements: tuple[tuple[Any, ...], ...]


class Checkpoint(NamedTuple):
    """What the filter knew after the measurement of this key and before the next."""

    after: Key
    memory: FilterCheckpoint


class History:
    """Gives the filter its measurements in order, whatever order they come in.

    A late measurement is put in its place, the filter is taken back to the checkpoint before it, and
    what came since is worked through again. So the estimate is always the one of all measurements so
    far in the order of their keys, to the last bit.

    Args:
        reckoning: the filter.
        span: how far back a measurement can be put in its place [s].
    """

    def __init__(self, reckoning: Reckoning, span: float) -> None:
        self._reckoning = reckoning
        self._span = round(span / NANOSECOND)
        self._keys: list[Key] = []
        self._events: list[Event] = []
        self._checkpoints = [Checkpoint(BEFORE_ALL, reckoning.checkpoint())]
        self._since_checkpoint = 0

    def memory(self) -> HistoryMemory:
        """What it goes by now."""
        after, memory = self._checkpoints[0]
        return HistoryMemory(after, memory, tuple(map(event_row, self._events)))

    def recall(self, memory: HistoryMemory) -> None:
        """Go by what it went by then; the filter must have been taken back to then, too.

        Raises:
            EstimatorError: the measurements are none, or not in order.
        """
        events = [event_of(row) for row in memory.measurements]
        keys = [key_of(event) for event in events]
        if any(one >= other for one, other in pairwise([memory.after, *keys])):
            raise EstimatorError("the measurements of the history are not in order")
        self._keys, self._events = keys, events
        self._checkpoints = [Checkpoint(memory.after, memory.memory)]
        if keys:
            self._checkpoints.append(Checkpoint(keys[-1], self._reckoning.checkpoint()))
        self._since_checkpoint = 0

    def objection(self, key: Key) -> str | None:
        """Why an event of this key cannot be put in its place; None if it can."""
        keys = self._keys
        if not keys:
            return None if key > self._checkpoints[0].after else TOO_OLD
        if key > keys[-1]:
            return None
        if key[0] < keys[-1][0] - self._span:
            return TOO_OLD
        if keys[bisect_left(keys, key)] == key:
            return "duplicate stamp"
        if key < self._checkpoints[0].after:
            return HISTORY_FULL
        return None

    def starts_after(self, key: Key) -> bool:
        """Whether no measurement has ever come before this key."""
        return self._checkpoints[0].after == BEFORE_ALL and key < self._keys[0]

    def is_late(self, key: Key) -> bool:
        """Whether an event of this key comes before one that was taken already."""
        return bool(self._keys) and key < self._keys[-1]

    def take(self, key: Key, event: Event) -> bool:
        """Take an event there is no objection to; whether the filter used it."""
        if self.is_late(key):
            return self._insert(key, event)
        self._keys.append(key)
        self._events.append(event)
        used = self._reckoning.take(event)
        if self._keep_checkpoint(key):
            self._forget()
        return used

    def set_clock(self, by: int) -> None:
        """Go on by a clock that shows `by` more than the one so far [ns]; nothing older can come."""
        stamp, rank = self._keys[-1]
        self.begin_anew((stamp + by, rank), self._reckoning.checkpoint().shifted(by))

    def begin_anew(self, after: Key, checkpoint: FilterCheckpoint) -> None:
        """Restore a checkpoint behind the measurement of a key; nothing older can come."""
        self._reckoning.restore(checkpoint)
        self._keys, self._events = [], []
        self._checkpoints = [Checkpoint(after, checkpoint)]
        self._since_checkpoint = 0

    @property
    def newest(self) -> int:
        """Stamp of the newest measurement that was taken [ns]."""
        return self._keys[-1][0] if self._keys else self._checkpoints[0].after[0]

    def forget_mark(self, mark: Mark) -> None:
        """Drop a mark, wherever it is kept."""
        self._reckoning.ekf.clones = self._reckoning.clones.without(mark.stamp)
        key = key_of(mark)
        place = bisect_left(self._keys, key)
        if place < len(self._keys) and self._keys[place] == key:
            del self._keys[place], self._events[place]
        for index, (after, memory) in enumerate(self._checkpoints):
            if memory.clones is not None:
                left = memory.clones.without(mark.stamp)
                without = msgspec.structs.replace(memory, clones=left)
                self._checkpoints[index] = Checkpoint(after, without)

    def _insert(self, key: Key, event: Event) -> bool:
        place = bisect_left(self._keys, key)
        self._keys.insert(place, key)
        self._events.insert(place, event)
        while self._checkpoints[-1].after > key:
            self._checkpoints.pop()
        after, memory = self._checkpoints[-1]
        self._reckoning.restore(memory)
        self._since_checkpoint = 0
        used = False
        for index in range(bisect_right(self._keys, after), len(self._keys)):
            taken = self._reckoning.take(self._events[index])
            if index == place:
                used = taken
            self._keep_checkpoint(self._keys[index])
        return used

    def _keep_checkpoint(self, key: Key) -> bool:
        """Whether it was time for one."""
        self._since_checkpoint += 1
        if self._since_checkpoint < CHECKPOINT_EVERY:
            return False
        self._since_checkpoint = 0
        self._checkpoints.append(Checkpoint(key, self._reckoning.checkpoint()))
        return True

    def _forget(self) -> None:
        """Drop what no measurement can come before any more."""
        checkpoints = self._checkpoints
        horizon = self._keys[-1][0] - self._span
        obsolete = 0
        while obsolete + 1 < len(checkpoints) and (
            checkpoints[obsolete + 1].after[0] < horizon
            or len(checkpoints) - obsolete > MOST_CHECKPOINTS
        ):
            obsolete += 1
        if obsolete:
            del checkpoints[:obsolete]
            passed = bisect_right(self._keys, checkpoints[0].after)
            del self._keys[:passed]
            del self._events[:passed]
