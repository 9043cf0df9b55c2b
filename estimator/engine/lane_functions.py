"""Inputs and steps of one filter at one lane; plain Python, for numba too."""

import math
from typing import Any

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.errors import WRONG_SIZE
from icreckon.estimator.base.records import NEVER
from icreckon.estimator.engine.constants import PER_STEP, step_constants
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.faults.scattering_fixes import TakenFix
from icreckon.estimator.filter.fault_table import put_faults
from icreckon.estimator.filter.filter_record import (
    ends_step,
    may_be_pushed,
    take_silence,
    take_track_sample,
    take_track_speeds,
)
from icreckon.estimator.filter.gate import count_verdict
from icreckon.estimator.filter.health import ADMITTED, REACQUIRED, REJECTED
from icreckon.estimator.filter.process_noise import share_of_sigma
from icreckon.estimator.filter.samples import COUNT, DUE, NEWEST, WRITTEN, SampleArrays
from icreckon.estimator.filter.slip_factor import follow_scatter
from icreckon.estimator.sensors.held_tracks import is_hole, speeds_at, take_motion
from icreckon.estimator.sensors.imu_clock import is_alive, take_stamp
from icreckon.estimator.sensors.imu_noise import measure_noise, measured_noise, noise_of_step
from icreckon.estimator.sensors.imu_tilt import add_rates
from icreckon.estimator.sensors.sensor_models import STANDSTILL_VARIANCE
from icreckon.estimator.sensors.standstill import is_full, quiet_mean
from icreckon.estimator.sensors.step_inputs import StepInputs, step_inputs
from icreckon.estimator.sensors.track_latency import add_rate
from icreckon.estimator.tracing.kernel import call_kernel

ROWS = len(INPUTS)
TRACK_ROWS, SLOW = len(StepInputs._fields), INPUTS["slow"]
QUIET_MEAN, RATE = INPUTS["quiet_mean"], INPUTS["rate"]
ROLL_RATE, PITCH_RATE = INPUTS["roll_rate"], INPUTS["pitch_rate"]
TILT_DENSITY = INPUTS["tilt_density"]
FORCE_X, FORCE_Y = INPUTS["force_x"], INPUTS["force_y"]
NOISE = INPUTS["gyro_density"]
PARAMETERS = s.PARAMETERS.start
LEFT, RIGHT = INPUTS["left"], INPUTS["right"]

# Results of functions that did nothing: a step is needed before, as after a gap; the buffers are full.
REFUSED, FULL = -1, -2
INPUTS_PLACE = 5  # place of the inputs among the arrays of a lane, see `take_step`
MOST_STATES = s.WANDER.stop  # most states of a filter with a fast slip
# Places in `LanePlaces.kernels`. Steps with an IMU sample at their end, of a robot that does not stand
# and of any; with one at their start; steps without one, and their two halves; position fixes, at the end
# of a step and ahead of it; the body velocity.
DRIVING_STEP, IMU_STEP, IMU_UPDATE, TIME_STEP, BEGIN, PROPAGATE = range(6)
POSITION, POSITION_AHEAD, EVALUATION = range(6, 9)


def sample_inputs(
    record: Any,
    stamps: Stamps,
    rates: Floats,
    inputs: Floats,
    lane: int,
    stamp: int,
    gyro: Any,
    force_x: float,
    force_y: float,
    uses_force: bool,
) -> None:
    """Add an IMU sample, and fill the inputs of the step that it ends.

    Args:
        record: record of the filter, changed in place.
        stamps: buffer for stamps of yaw-rate readings [ns].
        rates: buffer for the readings [rad/s].
        inputs: (n, lanes) inputs of the step, written to.
        lane: lane of the filter.
        stamp: stamp of the sample [ns].
        gyro: yaw rate, roll rate and pitch rate, and a reading, see `SensorModels.rates` [rad/s].
        force_x: specific force forward [m/s²], NaN if there is none.
        force_y: specific force to the left [m/s²], likewise.
        uses_force: the step is to use the specific force. Without it, and while the gyro fails, it does
            not use the rates of roll and pitch: slopes would depend on them alone.
    """
    settings = record.settings
    roll, pitch = gyro[1], gyro[2]
    rate = take_motion(record.tracks, stamp, gyro[0], gyro[3], force_x, force_y, settings)
    take_stamp(record.imu, stamp, settings.hold)
    density = add_rates(record.tilt, record.imu.interval, rate, roll, pitch)
    slow = 1.0 if may_be_pushed(record) else 0.0
    measure_noise(record.noise, stamp, rate, force_x, force_y, settings.hold)
    spread = measured_noise(record.noise.gyro)
    silent = take_silence(record, stamp)
    mean = quiet_mean(record.still, stamps, rates, stamp, rate, spread, silent, settings)
    record.stands = 0
    if mean == mean:
        # The oldest quiet reading: the tracks show later that the robot has begun to move.
        record.stands, rate = 1, rates[record.still.first]
    move_inputs(record, inputs, lane, stamp)
    inputs[SLOW, lane], inputs[QUIET_MEAN, lane], inputs[RATE, lane] = slow, mean, rate
    inputs[TILT_DENSITY, lane] = density
    if uses_force:
        inputs[FORCE_X, lane], inputs[FORCE_Y, lane] = force_x, force_y
        if rate == rate and force_x == force_x:
            inputs[ROLL_RATE, lane], inputs[PITCH_RATE, lane] = roll, pitch


def move_inputs(record: Any, inputs: Floats, lane: int, stamp: int) -> None:
    """Fill the inputs of a step without an IMU sample; see `sample_inputs`."""
    # What is not measured is NaN; the yaw rate and the density, which enter sums, are zero.
    fill_tracks(record, inputs, lane, stamp)
    inputs[SLOW, lane] = 1.0 if may_be_pushed(record) and not record.stands else 0.0
    inputs[QUIET_MEAN, lane], inputs[RATE, lane] = math.nan, 0.0
    inputs[ROLL_RATE, lane] = inputs[PITCH_RATE, lane] = math.nan
    inputs[TILT_DENSITY, lane] = 0.0
    inputs[FORCE_X, lane] = inputs[FORCE_Y, lane] = math.nan


def fill_tracks(record: Any, inputs: Floats, lane: int, stamp: int) -> None:
    """Fill the inputs of a step from the track speeds, and the noise of the IMU."""
    track_inputs = step_inputs(record.tracks, record.still, record.stamp, stamp, record.settings)
    for row in range(TRACK_ROWS):
        inputs[row, lane] = track_inputs[row]
    noise = noise_of_step(record.noise, record.still, record.settings)
    for axis in range(3):
        inputs[NOISE + axis, lane] = noise[axis]


def add_track_speeds(
    records: Any, stamp: int, left: float, right: float, only_if_usual: bool
) -> int:
    """Add track speeds to the record in an array (1,), see `take_track_speeds`.

    With `only_if_usual` it adds nothing and returns `REFUSED` if the filter has to take a step before: at
    the start, after a gap, and while there is no IMU.
    """
    record = records[0]
    tracks, hold = record.tracks, record.settings.hold
    if only_if_usual and (
        tracks.stamp == NEVER
        or ends_step(record)
        or is_hole(tracks, stamp, hold)
        or not is_alive(record.imu, stamp, hold)
    ):
        return REFUSED
    take_track_speeds(record, stamp, left, right)
    add_rate(record.turning, stamp, right - left)
    return 1


def take_sample(
    places: Any,
    kernel_number: int,
    records: Any,
    arrays: Any,
    readings: tuple[Stamps, Floats],
    mounting: Floats,
    stamp: int,
    w: Any,
    f: Any,
    uses_force: bool,
    after_gap: bool,
) -> int:
    """Add an IMU sample, and take the step that it ends.

    Args:
        places: (1,) `LanePlaces`.
        kernel_number: `IMU_STEP`, or `IMU_UPDATE` for a sample at the stamp of the filter.
        records: (1,) record of the filter.
        arrays: arrays of the filter, see `take_step`.
        readings: buffers for stamps [ns] and values [rad/s] of yaw-rate readings.
        mounting: (6, 3) mounting of the IMU, see `SensorModels`.
        stamp: stamp of the sample [ns].
        w: (3,) angular velocity in the axes of the IMU [rad/s].
        f: (3,) specific force in the axes of the IMU [m/s²], or NaN.
        uses_force: the step is to use the specific force.
        after_gap: the step may be longer than `Settings.hold`.

    Returns:
        As `take_step`; `REFUSED` or `FULL` if nothing was done.
    """
    record, (stamps, rates) = records[0], readings
    gap = (stamp - record.stamp) * NANOSECOND > record.settings.hold
    if record.tracks.stamp == NEVER or (gap and not after_gap):
        return REFUSED
    if is_full(record.still, stamps):
        return FULL
    inputs = arrays[INPUTS_PLACE]
    if inputs.shape != (ROWS, 1) or mounting.shape != (6, 3):
        raise ValueError(WRONG_SIZE)
    yaw_rate, roll_rate = along(mounting[0], w), along(mounting[1], w)
    pitch_rate, reading = along(mounting[2], w), along(mounting[3], w)
    gyro = (yaw_rate, roll_rate, pitch_rate, reading)
    add_rate(record.yaw_rates, stamp, yaw_rate)
    sample = (stamp, gyro, along(mounting[4], f), along(mounting[5], f), uses_force)
    sample_inputs(record, stamps, rates, inputs, 0, *sample)
    return take_step(places, kernel_of_sample(kernel_number, record), records, arrays, stamp, 0.0)


def along(axis: Floats, vector: Any) -> float:
    """Component of a vector (3,) along an axis, a row of the IMU's mounting."""
    return float(axis[0] * vector[0] + axis[1] * vector[1] + axis[2] * vector[2])


def kernel_of_sample(kernel_number: int, record: Any) -> int:
    """Kernel of an IMU sample that was added; most robots drive most of the time."""
    return DRIVING_STEP if kernel_number == IMU_STEP and not record.stands else kernel_number


def fill_move(records: Any, inputs: Floats, stamp: int) -> None:
    """Fill the inputs of one filter, see `move_inputs`."""
    if inputs.shape != (ROWS, 1):
        raise ValueError(WRONG_SIZE)
    move_inputs(records[0], inputs, 0, stamp)


def add_to_scatter(records: Any, fix: TakenFix, correction: Floats) -> bool:
    """Add a position fix to the scatter of one filter, see `follow_scatter`."""
    if len(correction) != s.SIZE:
        raise ValueError(WRONG_SIZE)
    return follow_scatter(records[0].fixes.scatter, fix, correction)


def feed_samples(
    places: Any,
    records: Any,
    arrays: Any,
    readings: tuple[Stamps, Floats],
    mounting: Floats,
    samples: SampleArrays,
    uses_force: bool,
    rows: Any,
) -> Any:
    """Take the steps of samples, and fill rows; return the numbers of a `Sampled`.

    Other arguments are those of `take_sample`. The steps end before a sample after a gap, or at a stamp
    that the filter has reached, and if the buffers of readings are full.
    """
    require_sizes(samples)
    record, track_stamps, imu_stamps = records[0], samples.track_stamps, samples.imu_stamps
    tracks, imu, used, stood = 0, 0, 0, 0
    while tracks < len(track_stamps) or imu < len(imu_stamps):
        has_tracks, has_imu = tracks < len(track_stamps), imu < len(imu_stamps)
        is_track = not has_imu or (has_tracks and track_stamps[tracks] <= imu_stamps[imu])
        stamp = track_stamps[tracks] if is_track else imu_stamps[imu]
        if is_row_due(rows, stamp, record):
            write_row(places, records, arrays, rows)
        if is_track:
            if not take_tracks(places, records, arrays, samples, tracks):
                break
            rows.progress[DUE] = len(rows.stamps) > 0
            tracks += 1
        else:
            if stamp <= record.stamp:
                break
            sample = (stamp, samples.angular_velocities[imu], samples.forces[imu], uses_force)
            filter_ = (records, arrays, readings, mounting)
            result = take_sample(places, IMU_STEP, *filter_, *sample, False)
            if result < 0:
                break
            used += result
            stood += record.stands
            imu += 1
    return tracks, imu, used, stood


def require_sizes(samples: SampleArrays) -> None:
    """Raise ValueError if sizes differ: compiled code does not check its indices."""
    tracks, imu = len(samples.track_stamps), len(samples.imu_stamps)
    sizes_fit = samples.speeds.shape == (tracks, 2)
    sizes_fit &= len(samples.left_wheels) == len(samples.right_wheels) == tracks
    sizes_fit &= samples.angular_velocities.shape == samples.forces.shape == (imu, 3)
    if not sizes_fit:
        raise ValueError(WRONG_SIZE)


def take_tracks(places: Any, records: Any, arrays: Any, samples: SampleArrays, k: int) -> bool:
    """Add track speeds k, after a step with the old ones if they end one.

    Returns:
        False, and nothing is done, after a gap in the track speeds or IMU samples.
    """
    record, stamp = records[0], samples.track_stamps[k]
    newest, hold = record.tracks.stamp, record.settings.hold
    if is_hole(record.tracks, stamp, hold) or not is_alive(record.imu, stamp, hold):
        return False
    if ends_step(record):
        move_inputs(record, arrays[INPUTS_PLACE], 0, newest)
        take_step(places, TIME_STEP, records, arrays, newest, 0.0)
    wheels = (samples.left_wheels[k], samples.right_wheels[k])
    take_track_sample(record, stamp, samples.speeds[k], *wheels)
    return True


def is_row_due(rows: Any, stamp: int, record: Any) -> bool:
    """Note the stamp of a measurement [ns]; return True if a row is due before it.

    A row is due once for new track speeds: with an IMU, after the step that has shown their slip.
    """
    progress = rows.progress
    is_later, progress[NEWEST] = stamp > progress[NEWEST], stamp
    has_reached = record.stamp >= record.tracks.stamp
    if not has_reached:
        has_reached = not is_alive(record.imu, stamp, record.settings.hold)
    is_new = record.stamp != progress[WRITTEN]
    return bool(progress[DUE] != 0 and is_later and is_new and has_reached)


def write_row(places: Any, records: Any, arrays: Any, rows: Any) -> None:
    """Fill the next row of `RunRows`; the other arguments are those of `take_step`."""
    x, P, record, row = arrays[0], arrays[1], records[0], rows.progress[COUNT]
    write_twist(places, record, arrays, rows, row)
    for i in range(3):
        for j in range(3):
            rows.pose_covariances[row, i, j] = P[i, j]
    for i in range(s.SIZE):
        rows.states[row, i], rows.sigmas[row, i] = x[i], np.sqrt(P[i, i])
    put_faults(record, rows.faults[row])
    put_innovation(record.gyro, rows, row, 0)
    put_innovation(record.accelerometer_x, rows, row, 1)
    put_innovation(record.accelerometer_y, rows, row, 2)
    rows.stamps[row] = rows.progress[WRITTEN] = record.stamp
    rows.progress[COUNT], rows.progress[DUE] = row + 1, 0


def write_twist(places: Any, record: Any, arrays: Any, rows: Any, row: int) -> None:
    """Fill the twist of a row, its indices, and its covariance as `twist_covariance`."""
    x, P, regressors, memory, lane, inputs, constants = arrays
    speeds = speeds_at(record.tracks, record.stamp, record.settings.hold_ns)
    twist, jacobian, by_speeds = np.empty(3), np.empty((3, len(x))), np.empty((3, 2))
    model, results = (x, memory, lane, inputs, constants), (twist, jacobian, by_speeds)
    indices = evaluate_twist(places, model, *speeds, (1.0, 1.0, 1.0), results)
    # Covariance J P J' of the twist, where the regressors are its derivatives by the parameters.
    with_states, shares, n = np.zeros((3, s.SIZE)), np.ones(3), s.SIZE
    for axis in range(3):
        rows.twists[row, axis], rows.indices[row, axis] = twist[axis], indices[axis]
        for k in range(s.PARAMETER_COUNT):
            jacobian[axis, PARAMETERS + k] = regressors[axis, k]
        for i in range(n):
            if jacobian[axis, i] != 0.0:
                for j in range(n):
                    with_states[axis, j] += jacobian[axis, i] * P[i, j]
    covariance = rows.twist_covariances[row]
    for i in range(3):
        for j in range(3):
            covariance[i, j] = STANDSTILL_VARIANCE[i] if i == j else 0.0
            for k in range(n):
                covariance[i, j] += with_states[i, k] * jacobian[j, k]
    for axis in range(2):
        shares[axis] = share_of_sigma(covariance[axis, axis], record.settings.fastest)
    for i in range(3):
        for j in range(3):
            covariance[i, j] *= shares[i] * shares[j]


def put_innovation(gate: Any, rows: Any, row: int, column: int) -> None:
    """Put the newest innovation of a gate into a row, if it is in no row yet."""
    if gate.stamp != NEVER and rows.judged[column] != gate.stamp:
        rows.judged[column] = gate.stamp
        if gate.S[0] > 0.0:
            rows.innovations[row, column] = gate.z[0] / math.sqrt(gate.S[0])


def fill_state(lane: Floats, constants: Floats, x: Floats, memory: Floats, places: Any) -> None:
    """Copy state and memory to the workspace; ValueError if a size is wrong."""
    sizes_fit = lane.shape == (places.row_count, 1) and len(constants) >= places.constant_count
    if not sizes_fit or x.shape != (places.size,) or len(memory) != places.memory_size:
        raise ValueError(WRONG_SIZE)
    for a in range(places.state_count):
        lane[places.x[a], 0] = x[places.states[a]]
    for k in range(s.PARAMETER_COUNT):
        constants[places.fixed + k] = x[PARAMETERS + k]
    for k in range(len(memory)):
        lane[places.memory + k, 0] = memory[k]


def fill_covariance(lane: Floats, P: Floats, regressors: Floats, places: Any) -> None:
    """Copy covariance and regressors to the workspace; ValueError if a size is wrong."""
    if P.shape != (places.size, places.size) or regressors.shape != (3, s.REGRESSOR_COUNT):
        raise ValueError(WRONG_SIZE)
    n = places.state_count
    for a in range(n):
        i = places.states[a]
        for b in range(a, n):
            lane[places.P[a, b], 0] = P[i, places.states[b]]
    row = places.regressors
    for axis in range(3):
        for k in range(places.parameter_count):
            i = places.parameters[k]
            lane[row, 0] = regressors[axis, i - PARAMETERS]
            row += 1
    lane[row, 0] = regressors[2, s.PARAMETER_COUNT]


def empty_lane(
    lane: Floats, x: Floats, P: Floats, regressors: Floats, memory: Floats, places: Any
) -> None:
    """Copy the filter out of the workspace."""
    for k in range(len(memory)):
        memory[k] = lane[places.memory + k, 0]
    n = places.state_count
    for a in range(n):
        i = places.states[a]
        x[i] = lane[places.x[a], 0]
        for b in range(a, n):
            j = places.states[b]
            P[i, j] = P[j, i] = lane[places.P[a, b], 0]
    row = places.regressors
    for axis in range(3):
        for k in range(places.parameter_count):
            i = places.parameters[k]
            regressors[axis, i - PARAMETERS] = lane[row, 0]
            row += 1
    regressors[2, s.PARAMETER_COUNT] = lane[row, 0]


def fill_constants(record: Any, lane: Floats, constants: Floats, stamp: int, places: Any) -> None:
    """Compute the constants of a step to a stamp [ns], and the factor on the slip."""
    values = step_constants((stamp - record.stamp) * NANOSECOND)
    for k in range(PER_STEP):
        constants[k] = values[k]
    constants[places.interval] = record.imu.interval
    lane[places.slip_factor, 0] = record.slip_factor


def set_gate(counts: Any, lane: Floats, rows: Any) -> None:
    """Copy the rejections of a gate into the workspace; its `rows` are in `imu_gates`."""
    rejected_for, admitted = rows[0], rows[1]
    lane[rejected_for, 0], lane[admitted, 0] = counts.rejected_for, 0.0


def count_sample(counts: Any, stamp: int, interval: float, lane: Floats, rows: Any) -> bool:
    """Count the verdict of a gate on the newest sample; return True if it is used."""
    rejected_for, admitted = lane[rows[0], 0], lane[rows[1], 0]
    z, S = lane[rows[2], 0], lane[rows[3], 0]
    if S == 0.0:  # there was no update with it
        return False
    verdict = REACQUIRED  # not admitted, and the time of rejections is reset
    if admitted > 0.0:
        verdict = ADMITTED
    elif rejected_for > 0.0:
        verdict = REJECTED
    count_verdict(counts, verdict, z * z / S, 1, interval)
    counts.stamp, counts.verdict, counts.z[0], counts.S[0] = stamp, verdict, z, S
    return verdict != REJECTED


def take_step(
    all_places: Any, kernel_number: int, records: Any, arrays: Any, stamp: int, rejected_for: float
) -> int:
    """Take a step or an update of one filter, in place.

    Args:
        all_places: (1,) `LanePlaces`.
        kernel_number: `IMU_STEP` or another of the kernels.
        records: (1,) record of the filter, see `FilterRecord`.
        arrays: (SIZE,) the state, (SIZE, SIZE) its covariance, (3, 10) regressors, see `Ekf`, the memory
            of the motion model, and workspace, (n, 1) inputs and constants of the kernel.
        stamp: stamp of the measurement, or of the end [ns].
        rejected_for: time of the position fixes rejected so far [s].

    Returns:
        The flags of a position fix, see `fixes.position_kernel`; of an IMU sample 1 if its yaw rate is
        used; otherwise 0.

    Raises:
        ValueError: an array has the wrong size.
    """
    x, P, regressors, memory, lane, inputs, constants = arrays
    if inputs.shape != (ROWS, 1):
        raise ValueError(WRONG_SIZE)
    places, record = all_places[0], records[0]
    fill_state(lane, constants, x, memory, places)
    fill_covariance(lane, P, regressors, places)
    fill_constants(record, lane, constants, stamp, places)
    if kernel_number <= IMU_UPDATE:
        set_gate(record.gyro, lane, places.imu_gates[0])
        set_gate(record.accelerometer_x, lane, places.imu_gates[1])
        set_gate(record.accelerometer_y, lane, places.imu_gates[2])
    elif kernel_number < POSITION:
        lane[places.stood, 0] = 0.0
    else:
        lane[places.position_rejected_for, 0] = rejected_for
        lane[places.position_admitted, 0] = 0.0
        begin_position(record, lane, places.of_record)
    flags = call_kernel(places.kernels[kernel_number], lane, inputs, constants)
    empty_lane(lane, x, P, regressors, memory, places)
    if kernel_number >= POSITION:
        end_position(record, lane, places.of_record)
        return flags
    if kernel_number != BEGIN:
        record.stamp = stamp
    if kernel_number > IMU_UPDATE:
        return 0
    interval, gates = record.imu.interval, places.imu_gates
    count_sample(record.accelerometer_x, stamp, interval, lane, gates[1])
    count_sample(record.accelerometer_y, stamp, interval, lane, gates[2])
    return 1 if count_sample(record.gyro, stamp, interval, lane, gates[0]) else 0


def begin_position(record: Any, lane: Floats, rows: Any) -> None:
    """Copy what position fixes change into the workspace, in the order of `OF_RECORD`."""
    lane[rows[0], 0], lane[rows[1], 0] = record.slip_factor, record.present_factor
    lane[rows[2], 0], lane[rows[3], 0] = record.trend_forward, record.trend_left
    lane[rows[4], 0], lane[rows[5], 0] = record.trend_size, record.departed_for
    lane[rows[6], 0], lane[rows[7], 0] = record.departed_from_x, record.departed_from_y
    lane[rows[8], 0], lane[rows[9], 0] = record.departed_by_x, record.departed_by_y
    lane[rows[10], 0], lane[rows[11], 0] = record.departed_first, record.alike_variance
    lane[rows[12], 0] = record.alike_count


def end_position(record: Any, lane: Floats, rows: Any) -> None:
    """Copy what a position fix changed out of the workspace."""
    record.slip_factor, record.present_factor = lane[rows[0], 0], lane[rows[1], 0]
    record.trend_forward, record.trend_left = lane[rows[2], 0], lane[rows[3], 0]
    record.trend_size, record.departed_for = lane[rows[4], 0], lane[rows[5], 0]
    record.departed_from_x, record.departed_from_y = lane[rows[6], 0], lane[rows[7], 0]
    record.departed_by_x, record.departed_by_y = lane[rows[8], 0], lane[rows[9], 0]
    record.departed_first, record.alike_variance = lane[rows[10], 0], lane[rows[11], 0]
    record.alike_count = lane[rows[12], 0]


def evaluate_twist(
    all_places: Any, arrays: Any, left: float, right: float, slip_shares: Any, results: Any
) -> Any:
    """Evaluate the body velocity, see `Ekf.twist_model`.

    Args:
        all_places: (1,) `LanePlaces`.
        arrays: (SIZE,) the state, the memory of the motion model, and workspace, inputs and constants of
            the kernel, see `take_step`.
        left: speed of the left track [m/s].
        right: speed of the right track [m/s].
        slip_shares: (3,) factors on the slip.
        results: (3,) twist, (3, SIZE) jacobian and (3, 2) derivatives by the speeds, written to.

    Returns:
        zeta, epsilon, eta, u and force, see `Motion`.

    Raises:
        ValueError: an array has the wrong size.
    """
    (x, memory, lane, inputs, constants), (twist, jacobian, by_speeds) = arrays, results
    places = all_places[0]
    sizes_fit = twist.shape == (3,) and jacobian.shape == (3, places.size)
    if not sizes_fit or by_speeds.shape != (3, 2) or inputs.shape != (ROWS, 1):
        raise ValueError(WRONG_SIZE)
    fill_state(lane, constants, x, memory, places)
    inputs[LEFT, 0], inputs[RIGHT, 0] = left, right
    for axis in range(3):
        constants[places.slip_shares + axis] = slip_shares[axis]
    call_kernel(places.kernels[EVALUATION], lane, inputs, constants)
    jacobian[:] = 0.0
    for axis in range(3):
        twist[axis] = lane[places.twist + axis, 0]
        for a in range(places.state_count):
            jacobian[axis, places.states[a]] = lane[places.by_state[axis, a], 0]
        for side in range(2):
            by_speeds[axis, side] = lane[places.motion + 5 + 2 * axis + side, 0]
    m = places.motion  # the five values of the result come first there
    return lane[m, 0], lane[m + 1, 0], lane[m + 2, 0], lane[m + 3, 0], lane[m + 4, 0]
