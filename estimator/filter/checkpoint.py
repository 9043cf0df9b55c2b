"""What the filter knows between two measurements: enough to go on from there exactly."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from icreckon.estimator.base import state as s
from icreckon.estimator.filter.clones import Marks
from icreckon.estimator.filter.health import Health
from icreckon.estimator.filter.reacquisition import RefusedFix
from icreckon.estimator.motion.motion_model import NO_MEMORY
from icreckon.estimator.sensors.held_tracks import TrackRecord
from icreckon.estimator.sensors.imu_clock import ClockRecord
from icreckon.estimator.sensors.standstill import StandstillMemory


class FilterMemory(msgspec.Struct, frozen=True):
    """The state of a `Reckoning`; nothing in it is changed by going on.

    Attributes:
        stamp: time of the estimate [ns], or None before the first.
        state: (SIZE,) see `estimator.base.state`.
        covariance: (SIZE, SIZE).
        step_under_way: whether the fast slip of the next step is drawn already.
        stands: whether the robot was found standing.
        tracks: record of the track speeds.
        standstill: checkpoint of the standstill detection.
        imu: clock of the IMU.
        rejected_in_a_row: of each gate.
        health: counts.
        marks: the motion since each mark, None where there is none.
        model: (m,) what the motion model remembers, see `estimator.motion.motion_model.MotionModel`.
        refused_fixes: position fixes that were refused since one was used.
        stood_at: stamp of the newest zero velocity that was used [ns], or None.
        regressors: (3, 8) of the filter, see `estimator.filter.ekf.IcrEkf`; None before its first step.
    """

    stamp: int | None
    state: np.ndarray[Any, Any]
    covariance: np.ndarray[Any, Any]
    step_under_way: bool
    stands: bool
    tracks: TrackRecord
    standstill: StandstillMemory
    imu: ClockRecord
    rejected_in_a_row: dict[str, int]
    health: Health
    marks: Marks | None = None
    model: np.ndarray[Any, Any] = NO_MEMORY
    regressors: np.ndarray[Any, Any] | None = None
    refused_fixes: tuple[RefusedFix, ...] = ()
    stood_at: int | None = None

    def __post_init__(self) -> None:
        if self.state.shape != (s.SIZE,) or self.covariance.shape != (s.SIZE, s.SIZE):
            raise ValueError(f"{s.SIZE} states and the rows of their covariance are needed")
        if self.regressors is not None and self.regressors.shape != (3, 8):
            raise ValueError("three rows of eight derivatives by the parameters are needed")

    def shifted(self, by: int) -> FilterMemory:
        """The same by a clock that shows `by` more [ns]; marks keep the stamps that they are known by."""

        def later(stamp: int | None) -> int | None:
            return None if stamp is None else stamp + by

        return replace(
            self,
            stamp=later(self.stamp),
            tracks=self.tracks.shifted(by),
            standstill=self.standstill.shifted(by),
            imu=self.imu.shifted(by),
            stood_at=later(self.stood_at),
        )
