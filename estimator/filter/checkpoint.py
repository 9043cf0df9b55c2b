"""Checkpoint of the filter, from which it continues exactly."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.records import Stamp, or_none, plain_copy
from icreckon.estimator.filter.clones import Clones
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.gate import GateRecord
from icreckon.estimator.filter.health import Health
from icreckon.estimator.motion.motion_model import NO_MEMORY
from icreckon.estimator.sensors.standstill import QuietMemory

NO_REGRESSORS = np.zeros((3, s.REGRESSOR_COUNT))


class FilterCheckpoint(msgspec.Struct, frozen=True, rename={"clones": "marks"}):
    """Copy of all that a `Reckoning` changes; the filter never changes it.

    Attributes:
        state: (SIZE,) see `icreckon.estimator.base.state`; with the wander of the fixes two more.
        covariance: (n, n) of the n states.
        record: record of the inputs.
        quiet: yaw-rate readings of a standstill.
        gates: counts of the gates of fixes, by name.
        counts: counts of all but the gates.
        clones: stochastic clones, None if there are none.
        model: (m,) memory of the motion model, see `icreckon.estimator.motion.motion_model.MotionModel`.
        regressors: (3, 10) of the filter, see `icreckon.estimator.filter.ekf.Ekf`.
        own_faults: faults of users by name, with their memory; from a file their fields.
    """

    state: np.ndarray[Any, Any]
    covariance: np.ndarray[Any, Any]
    record: FilterRecord
    quiet: QuietMemory
    gates: dict[str, GateRecord]
    counts: Health
    clones: Clones | None = None
    model: np.ndarray[Any, Any] = NO_MEMORY
    regressors: np.ndarray[Any, Any] = NO_REGRESSORS
    own_faults: dict[str, Any] = {}

    def __post_init__(self) -> None:
        size = s.WANDER.stop if self.state.shape == (s.WANDER.stop,) else s.SIZE
        if self.state.shape != (size,) or self.covariance.shape != (size, size):
            raise ValueError(f"{size} states and the rows of their covariance are needed")
        if self.regressors.shape != NO_REGRESSORS.shape:
            raise ValueError("three rows of ten regressors are needed")
        still, count = self.record.still, len(self.quiet.stamps)
        if (still.first, still.end, len(self.quiet.rates)) != (0, count, count):
            raise ValueError("each yaw-rate reading of a standstill needs a stamp")

    @property
    def stamp(self) -> Stamp | None:
        """Time of the estimate [ns], or None before the first."""
        return or_none(self.record.stamp)

    def plain(self) -> FilterCheckpoint:
        """Copy to records that Python alone uses, as files have them."""
        gates = {name: plain_copy(GateRecord, counts) for name, counts in self.gates.items()}
        record = plain_copy(FilterRecord, self.record)
        return msgspec.structs.replace(self, record=record, gates=gates)
