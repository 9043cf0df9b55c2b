"""Inputs of the steps of one filter; plain Python, for numba too."""

from __future__ import annotations

import math
from typing import Any

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.engine.layout import INPUTS
from icreckon.estimator.filter.filter_record import may_be_pushed, take_track_speeds
from icreckon.estimator.sensors.held_tracks import take_motion
from icreckon.estimator.sensors.imu_clock import take_stamp
from icreckon.estimator.sensors.imu_noise import measure_noise, measured_noise, noise_of_step
from icreckon.estimator.sensors.standstill import is_full, quiet_mean
from icreckon.estimator.sensors.step_inputs import StepInputs, step_inputs

ROWS, TRACK_ROWS, SLOW = len(INPUTS), len(StepInputs._fields), INPUTS["slow"]
QUIET_MEAN, RATE = INPUTS["quiet_mean"], INPUTS["rate"]
FORCE_X, FORCE_Y = INPUTS["force_x"], INPUTS["force_y"]
NOISE = INPUTS["gyro_density"]


def take_tracks_of(records: Any, stamp: int, left: float, right: float) -> int:
    """Add track speeds to the record in an array (1,), see `take_track_speeds`."""
    return take_track_speeds(records[0], stamp, left, right)


def sample_inputs(
    records: Any,
    stamps: Stamps,
    rates: Floats,
    inputs: Floats,
    stamp: int,
    rate: float,
    force_x: float,
    force_y: float,
    uses_force: bool,
) -> bool:
    """Add an IMU sample, and fill the inputs of the step that it ends.

    Args:
        records: (1,) record of the filter, changed in place.
        stamps: buffer for stamps of yaw-rate readings [ns].
        rates: buffer for the readings [rad/s].
        inputs: (n, 1) inputs of the step, written to.
        stamp: stamp of the sample [ns].
        rate: yaw rate [rad/s].
        force_x: specific force forward [m/s²], NaN if there is none.
        force_y: specific force to the left [m/s²], likewise.
        uses_force: the step is to use the specific force.

    Returns:
        False if the buffers are full; nothing was done then.

    Raises:
        ValueError: an array has the wrong size.
    """
    record = records[0]
    if is_full(record.still, stamps):
        return False
    rate = take_motion(record.tracks, stamp, rate, force_x, force_y, record.settings)
    settings = record.settings
    take_stamp(record.imu, stamp, settings.hold)
    slow = 1.0 if may_be_pushed(record) else 0.0
    measure_noise(record.noise, stamp, rate, force_x, force_y, settings.hold)
    spread = measured_noise(record.noise.gyro)
    mean = quiet_mean(record.still, stamps, rates, stamp, rate, spread, settings)
    fill_tracks(record, inputs, stamp)
    inputs[SLOW, 0], inputs[QUIET_MEAN, 0] = slow, mean
    fill_noise(record, inputs)
    inputs[RATE, 0] = rate
    inputs[FORCE_X, 0] = force_x if uses_force else math.nan
    inputs[FORCE_Y, 0] = force_y if uses_force else math.nan
    return True


def move_inputs(records: Any, inputs: Floats, stamp: int) -> None:
    """Fill the inputs of a step without an IMU sample; see `sample_inputs`."""
    record = records[0]
    fill_tracks(record, inputs, stamp)
    inputs[SLOW, 0] = 1.0 if may_be_pushed(record) and not record.stands else 0.0
    inputs[QUIET_MEAN, 0], inputs[RATE, 0] = math.nan, 0.0
    inputs[FORCE_X, 0] = inputs[FORCE_Y, 0] = math.nan
    fill_noise(record, inputs)


def fill_noise(record: Any, inputs: Floats) -> None:
    """Fill the noise of the IMU that a step assumes."""
    found = noise_of_step(record.noise, record.still, record.settings)
    for axis in range(3):
        inputs[NOISE + axis, 0] = found[axis]


def fill_tracks(record: Any, inputs: Floats, stamp: int) -> None:
    """Fill the inputs of a step from the track speeds."""
    if inputs.shape != (ROWS, 1):
        raise ValueError(WRONG_SIZE)
    found = step_inputs(record.tracks, record.still, record.stamp, stamp, record.settings)
    for row in range(TRACK_ROWS):
        inputs[row, 0] = found[row]
