"""Checkpoint of the filter, from which it continues exactly."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.records import NEVER, Size, assign, or_none, plain_copy
from icreckon.estimator.faults.repeating_fixes import PlaceRecord
from icreckon.estimator.faults.scattering_fixes import Scatter
from icreckon.estimator.filter.clones import Clones
from icreckon.estimator.filter.filter_record import DEPARTURE, FilterRecord
from icreckon.estimator.filter.gate import GateRecord
from icreckon.estimator.filter.health import Health
from icreckon.estimator.filter.reacquisition import RejectedFix
from icreckon.estimator.filter.slip_factor import LARGEST_FACTOR
from icreckon.estimator.motion.motion_model import NO_MEMORY
from icreckon.estimator.sensors.held_tracks import TrackRecord
from icreckon.estimator.sensors.imu_clock import ClockRecord
from icreckon.estimator.sensors.imu_noise import NoiseRecord
from icreckon.estimator.sensors.standstill import StandstillMemory


class FilterMemory(NamedTuple):
    """Copy of all that a `Reckoning` changes: quick to make, for the history.

    Attributes:
        state: (SIZE,) see `icreckon.estimator.base.state`.
        covariance: (SIZE, SIZE).
        regressors: (3, 9) of the filter, None before its first step.
        model: (m,) memory of the motion model.
        clones: stochastic clones, None if there are none.
        record: the record of its inputs.
        standstill: checkpoint of the standstill detection.
        gates: counts of the gates of fixes, None before the first.
        counts: counts of all but the gates.
        rejected_fixes: position fixes that were rejected since one was used.
        scatter: scatter of the newest position fixes.
    """

    state: Floats
    covariance: Floats
    regressors: Floats | None
    model: Floats
    clones: Clones | None
    record: FilterRecord
    standstill: StandstillMemory
    gates: tuple[GateRecord | None, ...]
    counts: Health
    rejected_fixes: tuple[RejectedFix, ...]
    scatter: Scatter


class FilterCheckpoint(
    msgspec.Struct, frozen=True, rename={"clones": "marks", "rejected_fixes": "refused_fixes"}
):
    """Checkpoint of a `Reckoning` as it is saved; the filter never changes it.

    Attributes:
        stamp: time of the estimate [ns], or None before the first.
        state: (SIZE,) see `icreckon.estimator.base.state`; with the wander of the fixes two more.
        covariance: (n, n) of the n states.
        stands: the robot was found standing.
        tracks: record of the track speeds.
        standstill: checkpoint of the standstill detection.
        imu: clock of the IMU.
        rejected_for: time of rejections since one was used, by sensor [s].
        health: counts.
        clones: stochastic clones, None if there are none.
        model: (m,) memory of the motion model, see `icreckon.estimator.motion.motion_model.MotionModel`.
        rejected_fixes: position fixes that were rejected since one was used.
        stood_at: stamp of the newest zero velocity that was used [ns], or None.
        regressors: (3, 9) of the filter, see `icreckon.estimator.filter.ekf.Ekf`; None before its
            first step.
        slip_factor: factor on the slip that position fixes have shown.
        present_factor: that of the newest fixes alone.
        fix_trend: mean of the normalised innovations of position fixes, to the front and to the left,
            and of their squares.
        departure: departure of position fixes from the path, see
            `icreckon.estimator.faults.departing_fixes.Departure`.
        noise: record of the noise of the IMU.
        wander_stamp: time up to which the wander of the fixes is propagated [ns], or None.
        positions: newest place of the position fixes.
        poses: newest place of the pose fixes.
        scatter: scatter of the newest position fixes.
    """

    stamp: int | None
    state: np.ndarray[Any, Any]
    covariance: np.ndarray[Any, Any]
    stands: bool
    tracks: TrackRecord
    standstill: StandstillMemory
    imu: ClockRecord
    rejected_for: dict[str, Size]
    health: Health
    clones: Clones | None = None
    model: np.ndarray[Any, Any] = NO_MEMORY
    regressors: np.ndarray[Any, Any] | None = None
    rejected_fixes: tuple[RejectedFix, ...] = ()
    stood_at: int | None = None
    slip_factor: Annotated[float, msgspec.Meta(ge=1.0, le=LARGEST_FACTOR)] = 1.0
    present_factor: Annotated[float, msgspec.Meta(ge=1.0, le=LARGEST_FACTOR)] = 1.0
    fix_trend: tuple[float, float, float] = (0.0, 0.0, 1.0)
    departure: tuple[Size, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    noise: NoiseRecord = msgspec.field(default_factory=NoiseRecord)
    wander_stamp: int | None = None
    positions: PlaceRecord = msgspec.field(default_factory=PlaceRecord)
    poses: PlaceRecord = msgspec.field(default_factory=PlaceRecord)
    scatter: Scatter = Scatter()

    def __post_init__(self) -> None:
        size = s.WANDER.stop if self.state.shape == (s.WANDER.stop,) else s.SIZE
        if self.state.shape != (size,) or self.covariance.shape != (size, size):
            raise ValueError(f"{size} states and the rows of their covariance are needed")
        if self.regressors is not None and self.regressors.shape != (3, 9):
            raise ValueError("three rows of nine derivatives by the parameters are needed")
        if len(self.scatter.moved) not in {0, s.SIZE}:
            raise ValueError(f"{s.SIZE} corrections by the fixes are needed")

    def fill(self, record: FilterRecord) -> None:
        """Copy all that is in the record of a filter, except standstill and gates."""
        record.stamp = NEVER if self.stamp is None else self.stamp
        record.stood_at = NEVER if self.stood_at is None else self.stood_at
        record.stands = self.stands
        record.slip_factor, record.present_factor = self.slip_factor, self.present_factor
        record.trend_forward, record.trend_left, record.trend_size = self.fix_trend
        for name, value in zip(DEPARTURE, self.departure, strict=True):
            setattr(record, name, value)
        record.wander_stamp = NEVER if self.wander_stamp is None else self.wander_stamp
        assign(record.positions, self.positions)
        assign(record.poses, self.poses)
        assign(record.tracks, self.tracks)
        assign(record.imu, self.imu)
        assign(record.noise, self.noise)

    def shifted(self, by: int) -> FilterCheckpoint:
        """Shift all stamps by a change of the clock [ns], except those of marks."""

        def later(stamp: int | None) -> int | None:
            return None if stamp is None else stamp + by

        return replace(
            self,
            stamp=later(self.stamp),
            tracks=self.tracks.shifted(by),
            standstill=self.standstill.shifted(by),
            imu=self.imu.shifted(by),
            stood_at=later(self.stood_at),
            wander_stamp=later(self.wander_stamp),
            noise=self.noise.shifted(by),
            positions=self.positions.shifted(by),
            poses=self.poses.shifted(by),
            scatter=self.scatter.shifted(by),
        )


def of_record(record: FilterRecord) -> dict[str, Any]:
    """Fields of a checkpoint that `FilterCheckpoint.fill` copies back."""
    return {
        "stamp": or_none(record.stamp),
        "stood_at": or_none(record.stood_at),
        "stands": bool(record.stands),
        "slip_factor": float(record.slip_factor),
        "present_factor": float(record.present_factor),
        "fix_trend": tuple(
            map(float, (record.trend_forward, record.trend_left, record.trend_size))
        ),
        "departure": tuple(float(getattr(record, name)) for name in DEPARTURE),
        "wander_stamp": or_none(record.wander_stamp),
        "positions": plain_copy(PlaceRecord, record.positions),
        "poses": plain_copy(PlaceRecord, record.poses),
        "tracks": plain_copy(TrackRecord, record.tracks),
        "imu": ClockRecord(record.imu.stamp, record.imu.interval),
        "noise": plain_copy(NoiseRecord, record.noise),
    }
