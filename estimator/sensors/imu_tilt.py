"""Rates of roll and pitch: their noise, and what they show of the tilt of the IMU.

A robot turns about the normal of the ground. The gyros of an IMU that leans by small angles read a share
of that turning as rates of roll and pitch: a regression by the yaw rate, with the biases as intercepts.
Functions are plain Python, also for numba.
"""

from typing import NamedTuple

import msgspec

from icreckon.estimator.base.records import Size

ROLLING_TIME = 1.0  # time for which a rate of roll or pitch lasts on uneven ground [s]


class TiltRecord(msgspec.Struct):
    """Newest rates of roll and pitch, and integrals of the rates over time."""

    roll: float = 0.0  # newest roll rate [rad/s]
    pitch: float = 0.0  # newest pitch rate [rad/s]
    time: Size = 0.0  # duration of the integrals [s]
    turned: float = 0.0  # integral of the yaw rate [rad]
    square: Size = 0.0  # integral of its square [rad²/s]
    rolled: float = 0.0  # integral of the roll rate [rad]
    pitched: float = 0.0  # integral of the pitch rate [rad]
    roll_in_turns: float = 0.0  # integral of roll rate times yaw rate [rad²/s]
    pitch_in_turns: float = 0.0  # integral of pitch rate times yaw rate [rad²/s]
    tilted: Size = 0.0  # integral of the squares of roll rate and pitch rate [rad²/s]


class Tilt(NamedTuple):
    """Tilt of an IMU."""

    roll: float  # angle about the forward axis [rad]
    pitch: float  # angle about the axis to the left [rad]
    sigma: float  # standard deviation of each [rad]


def add_rates(sums: TiltRecord, interval: float, yaw: float, roll: float, pitch: float) -> float:
    """Add yaw, roll and pitch rates over an interval [s] by the gyros, NaN if unknown.

    Returns the error density of roll and pitch [rad²/s]: half of the square of the change between
    readings is the variance of white noise. An outlier adds about the square of its angle.
    """
    if yaw != yaw or roll != roll:
        return 0.0
    roll_change, pitch_change = roll - sums.roll, pitch - sums.pitch
    sums.roll, sums.pitch = roll, pitch
    sums.time += interval
    sums.turned += yaw * interval
    sums.square += yaw * yaw * interval
    sums.rolled += roll * interval
    sums.pitched += pitch * interval
    sums.roll_in_turns += roll * yaw * interval
    sums.pitch_in_turns += pitch * yaw * interval
    sums.tilted += (roll * roll + pitch * pitch) * interval
    return 0.5 * (roll_change * roll_change + pitch_change * pitch_change) * interval


def tilt_of(sums: TiltRecord) -> Tilt | None:
    """Tilt by the readings so far; None before the robot has turned."""
    if sums.time == 0.0:
        return None
    mean_yaw_rate = sums.turned / sums.time
    yaw_spread = sums.square - mean_yaw_rate * sums.turned
    if not yaw_spread > 0.0:
        return None
    roll = (sums.pitch_in_turns - mean_yaw_rate * sums.pitched) / yaw_spread
    pitch = -(sums.roll_in_turns - mean_yaw_rate * sums.rolled) / yaw_spread
    by_biases = (sums.rolled * sums.rolled + sums.pitched * sums.pitched) / sums.time
    # Sum of squares of both rates that neither biases nor tilt explain; half of it is of each.
    residual = sums.tilted - by_biases - yaw_spread * (roll * roll + pitch * pitch)
    variance = ROLLING_TIME * 0.5 * max(0.0, residual) / sums.time / yaw_spread
    return Tilt(roll, pitch, variance**0.5)
