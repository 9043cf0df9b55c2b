"""Record of a streaming filter: all that it remembers of its inputs.

The functions are written for plain Python and for numba, see `icreckon.estimator.base.records`.
"""

import math
from typing import Annotated

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.records import NEVER, Flag, Size, Stamp
from icreckon.estimator.faults.odd_wheels import Wheels, take_wheels
from icreckon.estimator.faults.repeating_fixes import PlaceRecord
from icreckon.estimator.faults.scattering_fixes import ScatterRecord
from icreckon.estimator.filter.gate import GateRecord
from icreckon.estimator.filter.reacquisition import RejectedRecord
from icreckon.estimator.filter.slip_factor import LARGEST_FACTOR
from icreckon.estimator.sensors.held_tracks import TrackRecord, average, count_distance, take_tracks
from icreckon.estimator.sensors.imu_clock import ClockRecord, is_alive, is_due_after
from icreckon.estimator.sensors.imu_noise import NoiseRecord
from icreckon.estimator.sensors.imu_tilt import TiltRecord
from icreckon.estimator.sensors.input_settings import InputSettings
from icreckon.estimator.sensors.standstill import StandstillRecord, stopped_after
from icreckon.estimator.sensors.track_latency import RateRecord

# Fields of the departure of position fixes from the path, see `faults.departing_fixes.Departure`.
DEPARTURE = tuple(
    f"departed_{part}" for part in ("for", "from_x", "from_y", "by_x", "by_y", "first")
)
# Fields of the newest position fixes that were used and stated variances alike.
ALIKE_FIXES = ("alike_variance", "alike_count")
# Share of the fastest track speed below which tracks that fall silent may have stopped [-].
SLOW_AT_SILENCE = 0.05
Factor = Annotated[float, msgspec.Meta(ge=1.0, le=LARGEST_FACTOR)]  # factor on the slip


class FixesRecord(msgspec.Struct):
    """Record of the newest position fixes."""

    wander_stamp: Stamp = NEVER  # time up to which their wander is propagated [ns], or NEVER
    # those that were rejected since one was used, and the scatter of the fixes
    rejected: RejectedRecord = msgspec.field(default_factory=RejectedRecord)
    scatter: ScatterRecord = msgspec.field(default_factory=ScatterRecord)


class FilterRecord(msgspec.Struct):
    """Record of the inputs of one streaming filter."""

    settings: InputSettings  # settings of the inputs
    stamp: Stamp = NEVER  # time of the estimate [ns], or NEVER
    stood_at: Stamp = NEVER  # stamp of the newest zero velocity that was used [ns], or NEVER
    stands: Flag = 0  # 1 if the robot was found standing at the newest IMU sample
    slip_factor: Factor = 1.0  # factor on the slip that position fixes have shown
    present_factor: Factor = 1.0  # factor by the newest fixes alone
    trend_forward: float = 0.0  # mean of the position fixes' normalised innovations, forward [-]
    trend_left: float = 0.0  # to the left [-]
    trend_size: float = 1.0  # mean of their squares; 1 if they are as large as expected
    departed_for: Size = 0.0  # time of rejected position fixes that depart from the path [s]
    departed_from_x: float = 0.0  # place on the path of the newest fix that does not depart [m]
    departed_from_y: float = 0.0
    departed_by_x: float = 0.0  # innovation of the newest fix [m]
    departed_by_y: float = 0.0
    departed_first: Size = 0.0  # size of the first rejected fix's innovation; 0 if none [m]
    alike_variance: Size = 0.0  # variance of the newest fix that was used [m²]
    alike_count: Size = 0.0  # number of fixes up to it that stated variances alike
    fixes: FixesRecord = msgspec.field(default_factory=FixesRecord)  # the newest position fixes
    # newest places of the position fixes and of the pose fixes
    positions: PlaceRecord = msgspec.field(default_factory=PlaceRecord)
    poses: PlaceRecord = msgspec.field(default_factory=PlaceRecord)
    tracks: TrackRecord = msgspec.field(default_factory=TrackRecord)  # the track speeds
    imu: ClockRecord = msgspec.field(default_factory=ClockRecord)  # clock of the IMU
    noise: NoiseRecord = msgspec.field(default_factory=NoiseRecord)  # noise of the IMU
    tilt: TiltRecord = msgspec.field(default_factory=TiltRecord)  # readings that show its tilt
    still: StandstillRecord = msgspec.field(default_factory=StandstillRecord)  # the standstill
    # counts of the gates of gyro and accelerometers, forward and left
    gyro: GateRecord = msgspec.field(default_factory=GateRecord)
    accelerometer_x: GateRecord = msgspec.field(default_factory=GateRecord)
    accelerometer_y: GateRecord = msgspec.field(default_factory=GateRecord)
    # newest differences of the track speeds, right less left [m/s], and yaw rates by the gyro [rad/s]
    turning: RateRecord = msgspec.field(default_factory=RateRecord)
    yaw_rates: RateRecord = msgspec.field(default_factory=RateRecord)


def take_track_speeds(record: FilterRecord, stamp: int, left: float, right: float) -> None:
    """Add track speeds [m/s] at a stamp [ns]; coarse ones are averaged first."""
    held = record.tracks
    if average(held, stamp, left, right, record.settings.hold):
        hold_track_speeds(record, stamp, held.average_left, held.average_right)


def hold_track_speeds(record: FilterRecord, stamp: int, left: float, right: float) -> None:
    """Hold track speeds [m/s] from a stamp [ns] on."""
    settings, held = record.settings, record.tracks
    stopped_after(record.still, stamp, left, right, settings.track_speed)
    before, left_before, right_before = held.stamp, held.left, held.right
    take_tracks(held, stamp, left, right, settings)
    count_distance(held, record.stamp, before, left_before, right_before, settings.hold_ns)


def take_silence(record: FilterRecord, stamp: int) -> bool:
    """Return True if track speeds are stale at an IMU sample's stamp [ns].

    Some drivers send nothing at rest: where the robot was slow, this begins a rest in the record.
    """
    held, settings = record.tracks, record.settings
    if stamp - held.stamp <= settings.hold_ns:
        return False
    is_new = record.stamp - held.stamp <= settings.hold_ns
    if is_new and max(abs(held.left), abs(held.right)) < SLOW_AT_SILENCE * settings.fastest:
        stopped_after(record.still, stamp, 0.0, 0.0, settings.track_speed)
    return True


def ends_step(record: FilterRecord) -> bool:
    """Return True if the newest track speeds end a step, as no IMU sample soon will."""
    stamp = record.tracks.stamp
    return record.stamp < stamp and not is_due_after(record.imu, stamp)


def take_track_sample(
    record: FilterRecord, stamp: int, speeds: Floats, left_wheels: Floats, right_wheels: Floats
) -> None:
    """Add track speeds (2,), and those of the wheels (n,) and (m,) if known."""
    left, right = sides_of(record, stamp, speeds, left_wheels, right_wheels, True)
    take_track_speeds(record, stamp, left, right)


def sides_of(
    record: FilterRecord, stamp: int, speeds: Wheels, left: Wheels, right: Wheels, keeps: bool
) -> tuple[float, float]:
    """Speeds of both sides by their wheels if known, see `take_wheels` [m/s]."""
    means = (speeds[0], speeds[1])
    if len(left) + len(right) == 0:
        return means
    held, fastest = record.tracks, record.settings.fastest
    sides, wheels = (held.left_wheels, held.right_wheels), (left, right)
    return take_wheels(*sides, held.spin, stamp, means, *wheels, fastest, keeps)


def wander_after(fixes: FixesRecord, stamp: int, sigma: float, time: float) -> tuple[float, float]:
    """Decay of the wander up to a stamp [ns], which is recorded, and its gain [m²]."""
    elapsed = 0 if fixes.wander_stamp == NEVER else stamp - fixes.wander_stamp
    fixes.wander_stamp, decay = stamp, math.exp(-elapsed * NANOSECOND / time)
    return decay, sigma * sigma * (1.0 - decay * decay)


def may_be_pushed(record: FilterRecord) -> bool:
    """Return True if a robot that is not found standing may turn with resting tracks."""
    tracks, settings = record.tracks, record.settings
    is_slow = max(abs(tracks.left), abs(tracks.right)) < settings.track_speed
    has_imu = is_alive(record.imu, record.stamp, settings.hold)
    return is_slow and has_imu and record.stood_at < record.stamp
