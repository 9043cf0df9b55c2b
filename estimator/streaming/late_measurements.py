"""Recent measurements and checkpoints, for re-runs after late measurements."""

import logging
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.checks import require_nanoseconds
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.records import shifted
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.health import HISTORY_FULL, TOO_OLD
from icreckon.estimator.log.input_checks import Event, Key, event_of, event_row, key_of
from icreckon.estimator.log.measurements import Mark
from icreckon.estimator.streaming.reckoning import Reckoning

LOGGER = logging.getLogger(__name__)
BEFORE_ALL: Key = (-(2**63), -1)  # before any measurement
CHECKPOINT_EVERY = 64  # number of measurements between two checkpoints
# Largest number of measurements that a late one may be behind, at any rate of measurements.
MOST_MEASUREMENTS = 16_000


class HistoryCheckpoint(msgspec.Struct, frozen=True, rename={"checkpoint": "memory"}):
    """Checkpoint of a `History`: its oldest checkpoint of the filter and measurements."""

    after: Key  # key of the last measurement before the history
    checkpoint: FilterCheckpoint  # checkpoint of the filter after it
    measurements: tuple[tuple[Any, ...], ...]  # later ones in order, see `event_row`


class KeyedCheckpoint(NamedTuple):
    """Checkpoint of the filter after the measurement of a key, before the next."""

    after: Key
    checkpoint: FilterCheckpoint


class History:
    """Recent measurements of a filter, which gets them in the order of their stamps.

    A late measurement is inserted in its place, the checkpoint before it is restored, and the filter is
    re-run over all later ones. So the estimate is always as if all measurements had come in the order of
    their keys (stamp, and rank of the type), to the last bit, wherever the checkpoints are.

    Args:
        reckoning: the filter.
        span: largest delay of a measurement [s].
        watch: called with the record of the filter before its rates are full, or are cleared.
    """

    def __init__(
        self, reckoning: Reckoning, span: float, watch: Callable[[FilterRecord], None]
    ) -> None:
        self._reckoning, self._watch = reckoning, watch
        self._span_ns = round(span / NANOSECOND)
        self._keys: list[Key] = []
        self._events: list[Event] = []
        self._checkpoints = [KeyedCheckpoint(BEFORE_ALL, reckoning.checkpoint())]
        self._since_checkpoint = 0

    def checkpoint(self) -> HistoryCheckpoint:
        """Checkpoint of the oldest checkpoint and all later measurements."""
        after, oldest = self._checkpoints[0]
        return HistoryCheckpoint(after, oldest.plain(), tuple(map(event_row, self._events)))

    def restore(self, checkpoint: HistoryCheckpoint) -> None:
        """Restore a checkpoint after the filter's own; `EstimatorError` for invalid rows."""
        events = [event_of(row) for row in checkpoint.measurements]
        keys = [key_of(event) for event in events]
        if any(key >= next_key for key, next_key in pairwise([checkpoint.after, *keys])):
            raise EstimatorError("the measurements of the history are not in order")
        # The filter is already in its newest state; it goes back only to copy the oldest checkpoint.
        newest = self._reckoning.checkpoint()
        self.begin_anew(checkpoint.after, checkpoint.checkpoint)
        self._keys, self._events = keys, events
        if keys:
            self._checkpoints.append(KeyedCheckpoint(keys[-1], newest))
        self._reckoning.restore(newest)

    def objection(self, key: Key) -> str | None:
        """Reason to reject a measurement of this key; None if it can be inserted."""
        if self.is_newest(key):
            return None
        keys, (stamp, _) = self._keys, key
        if not keys or stamp < self.newest - self._span_ns:
            return TOO_OLD
        place = bisect_left(keys, key)
        if key < self._checkpoints[0].after or len(keys) - place > MOST_MEASUREMENTS:
            return HISTORY_FULL
        return "duplicate stamp" if keys[place] == key else None

    @property
    def has_begun(self) -> bool:
        """True after the first measurement."""
        return bool(self._keys) or self._checkpoints[0].after != BEFORE_ALL

    def starts_after(self, key: Key) -> bool:
        """Return True if this key is before the first measurement of all."""
        return self._checkpoints[0].after == BEFORE_ALL and key < self._keys[0]

    def is_newest(self, key: Key) -> bool:
        """Return True if this key is after all measurements so far."""
        return key > self._newest_key()

    def _newest_key(self) -> Key:
        """Key of the newest measurement, also of one that is no longer in the history."""
        return self._keys[-1] if self._keys else self._checkpoints[0].after

    def append(self, key: Key, event: Event) -> bool:
        """Update the filter with the newest event; return True if it was used."""
        self._keys.append(key)
        self._events.append(event)
        try:
            used = self._reckoning.take(event)
        except BaseException:
            self._take_back(len(self._keys) - 1)
            raise
        self._since_checkpoint += 1
        if self._since_checkpoint >= CHECKPOINT_EVERY:
            self._watch(self._reckoning.record)
            first, count = self._keys[0][0], len(self._keys)
            self._add_checkpoint(key)
            self._drop_obsolete()
            require_nanoseconds(first, key[0], count)
        return used

    def set_clock(self, by: int) -> None:
        """Change to a clock that is ahead by this difference [ns], and clear the history."""
        LOGGER.warning("the clock was set by %.3f s", by * NANOSECOND)
        stamp, rank = self._newest_key()
        self.begin_anew((stamp + by, rank), shifted(self._reckoning.checkpoint().plain(), by))

    def begin_anew(self, after: Key, checkpoint: FilterCheckpoint) -> None:
        """Restore a checkpoint after the measurement of a key, and clear the history."""
        self._reckoning.restore(checkpoint)
        self._keys, self._events = [], []
        self._checkpoints = [KeyedCheckpoint(after, self._reckoning.checkpoint())]
        self._since_checkpoint = 0

    @property
    def newest(self) -> int:
        """Stamp of the newest measurement [ns]."""
        stamp, _ = self._newest_key()
        return stamp

    def forget_mark(self, mark: Mark) -> None:
        """Drop a mark from the filter, the history and all checkpoints."""
        self._reckoning.ekf.clones = self._reckoning.clones.without(mark.stamp)
        key = key_of(mark)
        place = bisect_left(self._keys, key)
        if place < len(self._keys) and self._keys[place] == key:
            del self._keys[place], self._events[place]
        # A checkpoint directly after the mark gets the key of the event before it.
        before = self._keys[place - 1] if place else self._checkpoints[0].after
        for index, (after, checkpoint) in enumerate(self._checkpoints):
            if checkpoint.clones is not None:
                clones = checkpoint.clones.without(mark.stamp)
                checkpoint = msgspec.structs.replace(checkpoint, clones=clones)
                after = before if after == key else after
                self._checkpoints[index] = KeyedCheckpoint(after, checkpoint)

    def insert(self, key: Key, event: Event) -> bool:
        """Update with a late event, re-running the filter; return True if it was used."""
        self._watch(self._reckoning.record)
        place = bisect_left(self._keys, key)
        self._keys.insert(place, key)
        self._events.insert(place, event)
        while self._checkpoints[-1].after > key:
            self._checkpoints.pop()
        try:
            return self._run_again(place)
        except BaseException:
            self._take_back(place)
            raise

    def _take_back(self, place: int) -> None:
        """Take back the event at a place, whose sensor raised an exception."""
        del self._keys[place], self._events[place]
        self._run_again(len(self._keys))

    def _run_again(self, place: int) -> bool:
        """Re-run from the newest checkpoint; return True if the event at a place was used."""
        after, checkpoint = self._checkpoints[-1]
        reckoning = self._reckoning
        reckoning.restore(checkpoint)
        self._since_checkpoint = 0
        is_late_used = False
        for index in range(bisect_right(self._keys, after), len(self._keys)):
            is_used = reckoning.take(self._events[index])
            self._since_checkpoint += 1
            if index == place:
                is_late_used = is_used
                self._watch(reckoning.record)
            else:
                # The rates of the others were watched in the first run.
                reckoning.record.turning.count = reckoning.record.yaw_rates.count = 0
            if self._since_checkpoint >= CHECKPOINT_EVERY:
                self._add_checkpoint(self._keys[index])
        return is_late_used

    def _add_checkpoint(self, key: Key) -> None:
        """Add a checkpoint after the measurement of a key."""
        self._since_checkpoint = 0
        self._checkpoints.append(KeyedCheckpoint(key, self._reckoning.checkpoint()))

    def _drop_obsolete(self) -> None:
        """Drop measurements and checkpoints that are older than the history."""
        checkpoints, keys = self._checkpoints, self._keys
        # Rank -1 is before all measurements of a stamp.
        horizon: Key = (self.newest - self._span_ns, -1)
        if len(keys) > MOST_MEASUREMENTS:
            horizon = max(horizon, keys[-MOST_MEASUREMENTS])
        # The newest checkpoint before the horizon is kept, to re-run from it.
        obsolete = 0
        while obsolete + 1 < len(checkpoints) and checkpoints[obsolete + 1].after < horizon:
            obsolete += 1
        if obsolete:
            del checkpoints[:obsolete]
            passed = bisect_right(keys, checkpoints[0].after)
            del keys[:passed], self._events[:passed]
