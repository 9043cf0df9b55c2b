"""Records that plain Python and compiled code share: one source, the same numbers to the last bit."""

import msgspec
import numpy as np
from numba import njit

from icreckon.estimator.base import state as s
from icreckon.estimator.base.records import (
    NEVER,
    array_on,
    plain_copy,
    record_of,
    shared_record,
    shifted,
)
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.gate import GateRecord
from icreckon.estimator.filter.health import Health
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.held_tracks import TrackRecord, take_tracks
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.standstill import QuietMemory
from icreckon.estimator.sensors.step_inputs import step_inputs
from icreckon.estimator.tracing.jit_kernel import jit

SETTINGS = input_settings(load_robot("auriga-alpha"), Settings())
STEP = 20_000_000
EPOCH = 1_700_000_000_123_456_789


compiled_take, compiled_inputs = jit(take_tracks), jit(step_inputs)


@njit
def take_in_lane(records, lane, stamp, left, right, chosen):
    return compiled_take(records[lane], stamp, left, right, chosen)


def values(record):
    """Fields of a record of either kind, nested ones flat."""
    names = record.dtype.names if isinstance(record, np.void) else record.__struct_fields__
    found = []
    for name in names:
        value = record[name] if isinstance(record, np.void) else getattr(record, name)
        nested = isinstance(value, msgspec.Struct) or getattr(value, "dtype", np.dtype(float)).names
        found += values(value) if nested else np.ravel(value).tolist()
    return found


def drive(seed, count=400):
    """Stamps and speeds: ordinary, a stop, a stuck left track, a gap, and a decaying end."""
    rng = np.random.default_rng(seed)
    speeds = np.cumsum(0.02 * rng.standard_normal((count, 2)), axis=0)
    speeds[100:140] = 0.0
    speeds[200:260, 0] = speeds[200, 0]
    stamps = EPOCH + np.cumsum(STEP + rng.integers(-(10**6), 10**6, count))
    stamps[150:] += 3 * 10**9
    return stamps.tolist(), speeds.tolist()


def test_a_record_that_is_shifted_goes_on_by_the_other_clock():
    stamps, speeds = drive(1)
    plain, later, by = TrackRecord(), shifted(TrackRecord(), 5), 10**12
    assert values(later) == values(plain)
    for stamp, (left, right) in zip(stamps[:230], speeds[:230], strict=True):
        take_tracks(plain, stamp, left, right, SETTINGS)
    later = shifted(plain, by)
    for stamp, (left, right) in zip(stamps[230:], speeds[230:], strict=True):
        take_tracks(plain, stamp, left, right, SETTINGS)
        take_tracks(later, stamp + by, left, right, SETTINGS)
    assert values(shifted(plain, by)) == values(later)


def test_a_shared_record_is_one_for_python_and_compiled_code():
    shared, plain = shared_record(TrackRecord()), TrackRecord()
    array = array_on(shared)
    stamps, speeds = drive(0)
    for number, (stamp, (left, right)) in enumerate(zip(stamps, speeds, strict=True)):
        take_tracks(plain, stamp, left, right, SETTINGS)
        if number % 2:
            take_tracks(shared, stamp, left, right, SETTINGS)
        else:
            take_in_lane(array, 0, stamp, left, right, SETTINGS)
    assert plain_copy(TrackRecord, shared) == plain == record_of(TrackRecord, array[0])


def test_a_checkpoint_is_shifted_with_its_quiet_readings_and_gates():
    record = FilterRecord(settings=SETTINGS, stamp=EPOCH)
    record.still.end, record.gyro.stamp = 2, EPOCH
    found = shifted(
        FilterCheckpoint(
            np.zeros(s.SIZE),
            np.eye(s.SIZE),
            record,
            QuietMemory((EPOCH, EPOCH + STEP), (0.1, 0.2)),
            {"position": GateRecord(stamp=EPOCH), "heading": GateRecord()},
            Health(),
        ),
        STEP,
    )
    assert found.quiet == QuietMemory((EPOCH + STEP, EPOCH + 2 * STEP), (0.1, 0.2))
    assert {name: gate.stamp for name, gate in found.gates.items()} == {
        "position": EPOCH + STEP,
        "heading": NEVER,
    }
    assert found.record.stamp == found.record.gyro.stamp == EPOCH + STEP
    assert found.record.accelerometer_x.stamp == NEVER
