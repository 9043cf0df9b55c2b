"""Records that plain Python and compiled code share: one source, the same numbers to the last bit."""

import copy
import math
import pickle

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from icreckon.estimator.base import state as s
from icreckon.estimator.base.records import (
    NEVER,
    array_on,
    assign,
    plain_copy,
    record_array,
    record_of,
    shared_record,
    shifted,
)
from icreckon.estimator.faults.stuck_tracks import OTHERS, Repeating, repeating_after, stuck_from
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.gate import GateRecord
from icreckon.estimator.filter.health import Health
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.held_tracks import TrackRecord, take_tracks
from icreckon.estimator.sensors.imu_clock import ClockRecord, is_due_after, take_stamp
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.standstill import (
    QuietMemory,
    QuietReadings,
    StandstillRecord,
    quiet_mean,
    stopped_after,
)
from icreckon.estimator.sensors.step_inputs import step_inputs
from icreckon.estimator.tracing.jit_kernel import jit

SETTINGS = input_settings(load_robot("auriga-alpha"), Settings())
STEP = 20_000_000
EPOCH = 1_700_000_000_123_456_789


compiled_take, compiled_inputs = jit(take_tracks), jit(step_inputs)
compiled_stopped, compiled_mean = jit(stopped_after), jit(quiet_mean)
compiled_stamp, compiled_due = jit(take_stamp), jit(is_due_after)


@njit
def take_in_lane(records, lane, stamp, left, right, chosen):
    return compiled_take(records[lane], stamp, left, right, chosen)


@njit
def inputs_of_lane(records, still, lane, start, end, chosen):
    return compiled_inputs(records[lane], still[0], start, end, chosen)


@njit
def quiet_mean_of_lane(records, lane, stamps, rates, stamp, rate, speed, chosen):
    compiled_stopped(records[lane], stamp, speed, speed, chosen.track_speed)
    return compiled_mean(records[lane], stamps, rates, stamp, rate, 0.0, chosen)


@njit
def clock_of_lane(records, lane, stamp, hold):
    compiled_stamp(records[lane], stamp, hold)
    return compiled_due(records[lane], stamp + 25_000_000)


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


@pytest.mark.parametrize("seed", range(4))
def test_held_tracks_are_the_same_in_python_and_compiled_to_the_last_bit(seed):
    """The record of one filter is an element of an array: here of length 1, and as a lane of 3."""
    plain, alone, lanes = (
        TrackRecord(),
        record_array(TrackRecord(), 1),
        record_array(TrackRecord(), 3),
    )
    rng = np.random.default_rng(seed)
    for stamp, (left, right) in zip(*drive(seed), strict=True):
        take_tracks(plain, stamp, left, right, SETTINGS)
        take_in_lane(alone, 0, stamp, left, right, SETTINGS)
        take_in_lane(lanes, 1, stamp, left, right, SETTINGS)
        start = stamp + int(rng.integers(0, STEP))
        end = start + int(rng.choice([0, 10**7, 10**9]))
        carried = stamp if int(stamp) % 2 else NEVER
        still = StandstillRecord(restless_since=start - STEP, carried_since=carried)
        expected = step_inputs(plain, still, start, end, SETTINGS)
        assert expected == inputs_of_lane(alone, record_array(still, 1), 0, start, end, SETTINGS)
    assert plain.stuck == 1
    assert values(plain) == values(alone[0]) == values(lanes[1])
    assert values(lanes[0]) == values(TrackRecord())


def test_a_checkpoint_is_a_copy():
    plain, array = TrackRecord(), record_array(TrackRecord(), 1)
    stamps, speeds = drive(0)
    for stamp, (left, right) in zip(stamps[:230], speeds[:230], strict=True):
        take_tracks(plain, stamp, left, right, SETTINGS)
        take_in_lane(array, 0, stamp, left, right, SETTINGS)
    checkpoint, of_array = plain_copy(TrackRecord, plain), array.copy()
    before = values(plain)
    for stamp, (left, right) in zip(stamps[230:], speeds[230:], strict=True):
        take_tracks(plain, stamp, left, right, SETTINGS)
        take_in_lane(array, 0, stamp, left, right, SETTINGS)
    assert values(checkpoint) == values(of_array[0]) == before != values(plain)


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


READINGS = st.lists(
    st.tuples(st.sampled_from([0.0, 0.1, 0.2, 0.3]), st.sampled_from([0.0, 0.1, 0.2, 0.4, 0.5])),
    min_size=2,
    max_size=300,
)


@settings(max_examples=40)
@given(READINGS, st.integers(0, 20), st.integers(1, 400))
def test_a_track_is_found_stuck_once_and_as_the_definition_has_it(readings, hole, repeat):
    """The record keeps a summary; here the definition is applied to all readings so far."""
    track, taken = Repeating(), []
    # A beginning with many different readings, so that being stuck can be noticed at all.
    prelude = [(0.01 * k, 0.02 * k) for k in range(30)] + [(0.7, 0.01 * k) for k in range(repeat)]
    stamp, was_stuck = 0, False
    for number, (reading, other) in enumerate(prelude + readings):
        stamp += STEP * (50 if number == 30 + hole else 1)
        found = repeating_after(track, stamp, reading, other, 0.3)
        taken.append((stamp, reading, other))
        is_stuck = stuck_from(track, 0.3) != NEVER
        assert found == (is_stuck and not was_stuck)
        was_stuck = is_stuck
        same = [taken[-1]]
        for before in reversed(taken[:-1]):
            if before[1] != reading or same[0][0] - before[0] > 3 * 10**8:
                break
            same.insert(0, before)
        assert (track.since, track.newest) == (same[0][0], stamp)
        assert track.other_count == min(OTHERS, len({row[2] for row in same}))
        if is_stuck:
            assert reading != 0.0
            assert stuck_from(track, 0.3) >= same[0][0] + 3 * 10**8


@pytest.mark.parametrize("room", [60, 64, 200])
def test_quiet_readings_are_the_same_in_python_and_compiled(room):
    """Whatever the size of the buffer, which is moved when it is full."""
    plain, array = StandstillRecord(), record_array(StandstillRecord(), 1)
    lists = [0] * 400, [0.0] * 400
    arrays = np.zeros(room, np.int64), np.zeros(room)
    rng, means = np.random.default_rng(0), []
    for k in range(600):
        stamp, rate = EPOCH + k * 10**7, float(1e-3 * rng.standard_normal())
        speed = 0.1 if 300 <= k < 310 else 0.0
        stopped_after(plain, stamp, speed, speed, SETTINGS.track_speed)
        expected = quiet_mean(plain, *lists, stamp, rate, 0.0, SETTINGS)
        found = quiet_mean_of_lane(array, 0, *arrays, stamp, rate, speed, SETTINGS)
        assert found == expected or (math.isnan(found) and math.isnan(expected))
        means.append(expected)
    assert np.isnan(means[:50]).all()
    assert np.isfinite(means[50:300]).all()
    assert np.isnan(means[300:360]).all()
    assert np.isfinite(means[360:]).all()


def test_a_buffer_that_is_too_short_is_refused():
    still, buffers = StandstillRecord(), ([0] * 40, [0.0] * 40)
    stopped_after(still, 0, 0.0, 0.0, SETTINGS.track_speed)
    for k in range(40):
        quiet_mean(still, *buffers, k * 10**7, 0.0, 0.0, SETTINGS)
    with pytest.raises(ValueError, match="wrong size"):
        quiet_mean(still, *buffers, 40 * 10**7, 0.0, 0.0, SETTINGS)


def test_the_readings_make_room_for_any_number_of_readings():
    still, readings = StandstillRecord(), QuietReadings()
    stopped_after(still, 0, 0.0, 0.0, SETTINGS.track_speed)
    means = [readings.mean(still, k * 10**6, 0.01, 0.0, SETTINGS) for k in range(2000)]
    assert np.isnan(means[:500]).all()
    assert means[500:] == pytest.approx([0.01] * 1500)
    other, others = StandstillRecord(), QuietReadings()
    kept = copy.copy(still)
    others.recall(readings.memory(kept))
    assign(other, kept)
    assert others.memory(other) == readings.memory(copy.copy(still))
    assert len(others.memory(other).stamps) == 501
    assert others.mean(other, 2000 * 10**6, 0.01, 0.0, SETTINGS) == pytest.approx(0.01)


def test_clocks_are_the_same_in_python_and_compiled():
    plain, array = ClockRecord(), record_array(ClockRecord(), 2)
    for stamp in (EPOCH, EPOCH + 10**7, EPOCH + 3 * 10**7, EPOCH + 10**9, EPOCH + 10**9 + 1):
        take_stamp(plain, stamp, 0.3)
        assert is_due_after(plain, stamp + 25_000_000) == clock_of_lane(array, 1, stamp, 0.3)
        assert values(plain) == values(array[1])
    assert shifted(copy.copy(plain), 5).stamp == plain.stamp + 5
    assert values(array[0]) == values(shifted(ClockRecord(), 5)) == [NEVER, 0.01]


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


def test_copies_of_a_shared_record_have_their_own_memory():
    shared = shared_record(FilterRecord(SETTINGS))
    shared.tracks.left, shared.tracks.repeating_right.others[3] = 0.25, 0.5
    for other in (copy.deepcopy(shared), pickle.loads(pickle.dumps(shared))):  # noqa: S301 - our own
        assert values(array_on(other)[0]) == values(array_on(shared)[0])
        assert record_of(FilterRecord, array_on(other)[0]).settings == SETTINGS
        assign(other.tracks, TrackRecord())
        assert (shared.tracks.left, shared.tracks.repeating_right.others[3]) == (0.25, 0.5)


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
