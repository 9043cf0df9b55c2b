"""Noise of gyro and accelerometers, measured from differences of their readings.

Second differences cancel a constant and a constant change, so that a turn does not count as noise. Their
mean size, clipped, is a robust scale of the noise. The scale is taken of single readings and of means
over short blocks, which show slow vibration to a fast IMU; the larger counts. The functions are written
for plain Python and for numba, see `icreckon.estimator.base.records`.
"""

import math
from typing import Annotated, NamedTuple

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.records import NEVER, Count, Flag, Size, Stamp
from icreckon.estimator.sensors.input_settings import InputSettings
from icreckon.estimator.sensors.standstill import StandstillRecord, is_carried, tracks_rest

# Least length of a block of readings [s]: two at 100 Hz, three at 200 Hz, six at 400 Hz.
BLOCK = 0.0135
MEMORY = 3.0  # time constant of the measured noise [s]
# A difference counts as at most this many times the mean size: outliers and knocks are no noise.
CLIP = 4.0
# Variance of the second difference of white noise of variance 1, and the standard deviation of a normal
# distribution over its mean size.
DIFFERENCE_VARIANCE, SIGMA_OVER_MEAN_SIZE = 6.0, math.sqrt(0.5 * math.pi)
# An interval that is longer than the usual one by this factor is a gap: differences start again.
GAP_FACTOR = 1.7
# The file's noise is assumed while the measured noise is at most this many times as large, driving or
# with resting tracks, or as small: differences of readings include jolts of driving, which are motion.
MORE_DRIVING, MORE_AT_REST, LESS = 2.5, 1.5, 5.0
# Least noise of the gyro that is assumed, over that of the file: the delay of the track speeds acts like
# noise while a robot drives, even if the gyro has none.
LEAST_GYRO_SHARE = 0.3
# Noise of the first sample, over that of the file: the robot may be shaken, which later samples show.
FACTOR_AT_START = 30.0
CARRIED_FORCE = 1e4  # density of the specific force of a robot that is carried [m²/s³]


class Pace(msgspec.Struct):
    """Clock of values whose differences are taken."""

    stamp: Stamp = NEVER  # stamp of the newest value [ns], or NEVER
    interval: Size = 0.0  # averaged interval between values [s]
    run: Annotated[int, msgspec.Meta(ge=0, le=3)] = 0  # values since the newest gap, at most 3


class Differences(msgspec.Struct, array_like=True):
    """Second differences of values of one axis."""

    newest: float = 0.0  # newest value
    change: float = 0.0  # newest value less the one before
    size: Size = 0.0  # clipped mean size of the second differences, as a noise density [unit/√Hz]
    count: Count = 0  # number of differences so far


class AxisNoise(msgspec.Struct):
    """Noise of one axis."""

    total: float = 0.0  # sum of the readings of the block in progress
    readings: Differences = msgspec.field(default_factory=Differences)  # of single readings
    blocks: Differences = msgspec.field(default_factory=Differences)  # of means over blocks


class NoiseRecord(msgspec.Struct):
    """Record of the noise of an IMU."""

    is_first: Flag = 1  # 1 until the second sample
    in_block: Count = 0  # number of readings in the block in progress
    readings: Pace = msgspec.field(default_factory=Pace)  # clock of the distinct readings
    blocks: Pace = msgspec.field(default_factory=Pace)  # clock of the blocks
    gyro: AxisNoise = msgspec.field(default_factory=AxisNoise)  # noise of the yaw rate
    accelerometer_x: AxisNoise = msgspec.field(default_factory=AxisNoise)  # of force forward
    accelerometer_y: AxisNoise = msgspec.field(default_factory=AxisNoise)  # of force to the left


class ImuNoise(NamedTuple):
    """Noise of an IMU that the filter assumes."""

    gyro: float  # density of the yaw rate [rad²/s]
    accelerometer_x: float  # density of the specific force forward [m²/s³]
    accelerometer_y: float  # density of the specific force to the left [m²/s³]


def measure_noise(
    noise: NoiseRecord, stamp: int, rate: float, force_x: float, force_y: float, hold: float
) -> None:
    """Add an IMU sample: its readings, and with the last of a block the block's means.

    The yaw rate [rad/s] and the forces forward and left [m/s²] are NaN if there is none. After a gap
    longer than `hold` [s] the differences start again.
    """
    gyro, x, y = noise.gyro, noise.accelerometer_x, noise.accelerometer_y
    # A missing reading (NaN) repeats the last one, which is no noise.
    rate = rate if rate == rate else gyro.readings.newest
    force_x = force_x if force_x == force_x else x.readings.newest
    force_y = force_y if force_y == force_y else y.readings.newest
    pace, block_pace = noise.readings, noise.blocks
    noise.is_first = 1 if pace.stamp == NEVER else 0
    is_repeated = rate == gyro.readings.newest and force_x == x.readings.newest
    if not noise.is_first and is_repeated and force_y == y.readings.newest:
        # A driver that repeats samples: they hold no noise of their own.
        return
    dt = next_interval(pace, stamp, hold)
    add_value(gyro.readings, rate, pace.run, dt, pace.interval)
    add_value(x.readings, force_x, pace.run, dt, pace.interval)
    add_value(y.readings, force_y, pace.run, dt, pace.interval)
    if pace.run == 1:
        # A block begins after the first reading.
        block_pace.stamp, block_pace.run, noise.in_block = stamp, 0, 0
        gyro.total = x.total = y.total = 0.0
        return
    noise.in_block += 1
    gyro.total += rate
    x.total += force_x
    y.total += force_y
    if (stamp - block_pace.stamp) * NANOSECOND < BLOCK:
        return
    count, block_dt = noise.in_block, next_interval(block_pace, stamp, hold)
    add_value(gyro.blocks, gyro.total / count, block_pace.run, block_dt, block_pace.interval)
    add_value(x.blocks, x.total / count, block_pace.run, block_dt, block_pace.interval)
    add_value(y.blocks, y.total / count, block_pace.run, block_dt, block_pace.interval)
    noise.in_block = 0
    gyro.total = x.total = y.total = 0.0


def next_interval(pace: Pace, stamp: int, hold: float) -> float:
    """Add a value's stamp [ns]; return the interval [s], 0 if longer than `hold`."""
    dt = (stamp - pace.stamp) * NANOSECOND
    pace.stamp = stamp
    if not 0.0 < dt <= hold:
        pace.run = 1
        return 0.0
    if pace.interval == 0.0:
        pace.interval = dt
    pace.run = 1 if dt > GAP_FACTOR * pace.interval else min(3, pace.run + 1)
    pace.interval += min(1.0, dt / MEMORY) * (dt - pace.interval)
    return dt


def add_value(differences: Differences, value: float, run: int, dt: float, interval: float) -> None:
    """Add value number `run` since a gap to an axis, `dt` after the one before [s]."""
    change = value - differences.newest
    difference = abs(change - differences.change)
    differences.newest, differences.change = value, change
    # A coarse or constant reading has equal differences, which hide its noise.
    if run < 3 or not difference > 0.0:
        return
    differences.count += 1
    size = difference * math.sqrt(interval / DIFFERENCE_VARIANCE)
    if differences.count > 1:
        size = min(size, CLIP * differences.size)
    weight = max(1.0 / differences.count, min(1.0, dt / MEMORY))
    differences.size += weight * (size - differences.size)


def measured_noise(axis: AxisNoise) -> float:
    """Measured noise density of an axis [unit/√Hz]; 0 before there is one."""
    return SIGMA_OVER_MEAN_SIZE * max(axis.readings.size, axis.blocks.size)


def assumed_noise(axis: AxisNoise, stated: float, factor: float, least: float) -> float:
    """Noise density of an axis that the filter assumes [unit²/Hz].

    It is the density of the robot file, `stated` [unit/√Hz], unless the measured density is more than
    `factor` times or less than 1 / `LESS` of it. Beyond these limits it changes continuously to the
    measured density, but not below `least` times the file's.
    """
    measured, density = measured_noise(axis), stated
    if measured > factor * stated:
        density = min(measured, measured * measured / (factor * factor * stated))
    elif 0.0 < measured * LESS < stated:
        density = max(measured, measured * measured * (LESS * LESS) / stated, least * stated)
    return density * density


def imu_noise(noise: NoiseRecord, at_rest: bool, settings: InputSettings) -> ImuNoise:
    """Noise of an IMU that the filter assumes.

    The accelerometers' noise in a robot file includes slopes and jolts that are slower than a block: a
    measured density may increase it, but not reduce it. `at_rest`: the tracks rest.
    """
    gyro, force = settings.gyro_noise_density, settings.accelerometer_noise_density
    factor = MORE_AT_REST if at_rest else MORE_DRIVING
    if noise.is_first:
        gyro, force = FACTOR_AT_START * gyro, FACTOR_AT_START * force
    return ImuNoise(
        assumed_noise(noise.gyro, gyro, factor, LEAST_GYRO_SHARE),
        assumed_noise(noise.accelerometer_x, force, factor, 1.0),
        assumed_noise(noise.accelerometer_y, force, factor, 1.0),
    )


def noise_of_step(noise: NoiseRecord, still: StandstillRecord, settings: InputSettings) -> ImuNoise:
    """Noise of an IMU that a step assumes; a carried robot uses the gyro alone."""
    assumed = imu_noise(noise, tracks_rest(still), settings)
    if is_carried(still):
        return ImuNoise(assumed.gyro, CARRIED_FORCE, CARRIED_FORCE)
    return assumed
