"""Whether a measurement can be right by itself, before the filter is asked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    Mark,
    Matrix3,
    Measurement,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    Vector3,
    ZeroVelocity,
)

# The streams by what they consist of, in the order in which measurements of equal stamps are taken;
# `Log.measurements` has the same.
STREAMS: dict[type[Measurement], str] = {
    TrackSpeeds: "tracks",
    ImuSample: "imu",
    PositionFix: "position",
    HeadingFix: "heading",
    BodyVelocity: "body velocity",
    PoseFix: "pose",
    ZeroVelocity: "zero velocity",
}
# What is worked through in order: measurements, and marks behind them.
Event = Measurement | Mark
EVENTS: dict[type[Event], str] = dict(STREAMS.items())
EVENTS[Mark] = "mark"
RANKS = {kind: rank for rank, kind in enumerate(EVENTS)}
# The place of an event in the one order in which they are taken: its stamp [ns], and its rank.
Key = tuple[int, int]
# So many samples in a row must agree before a clock that jumped ahead is believed.
CLOCK_WITNESSES = 10
# So many in a row that are too old, with nothing newer between them, and of tracks and IMU at least
# these, show a clock that was set back.
BEHIND, BEHIND_OF_EACH = 20, 4
# Track speeds and body velocities this many times beyond the fastest track are none.
ABSURD_SPEED = 10.0
# No gyro of a vehicle reads more [rad/s], and no accelerometer [m/s²].
ABSURD_RATE, ABSURD_FORCE = 100.0, 1000.0
# Elements of a covariance may differ from their mirror images by this share of its standard deviations,
# and no less than this share of them must be left in any direction.
ASYMMETRY, LEAST_SHARE = 1e-6, 1e-9


def key_of(event: Event) -> Key:
    """The place of an event in the order in which they are taken."""
    return event.stamp, RANKS[type(event)]


def as_plain(measurement: Measurement) -> Measurement:
    """The measurement in plain integers, floats and tuples, which nobody can change afterwards.

    Raises:
        EstimatorError: it is no measurement, or holds what is no number.
    """
    kind = kind_of(measurement)
    stream = STREAMS[kind]
    stamp = measurement.stamp
    if kind is ImuSample and type(measurement) is ImuSample and type(stamp) is int:
        force = measurement.linear_acceleration
        if _is_plain(measurement.angular_velocity) and (force is None or _is_plain(force)):
            return measurement
    if type(stamp) is not int:
        if not isinstance(stamp, int | np.integer):
            raise EstimatorError(f"{stream}: a stamp is an integer of nanoseconds, found {stamp!r}")
        stamp = int(stamp)
    if isinstance(measurement, ImuSample):
        force = measurement.linear_acceleration
        return ImuSample(
            stamp,
            _three("angular_velocity", measurement.angular_velocity),
            None if force is None else _three("linear_acceleration", force),
        )
    values = [getattr(measurement, name) for name in kind.__match_args__[1:]]
    is_plain = type(measurement) is kind and type(measurement.stamp) is int
    is_plain = is_plain and kind is not PoseFix and kind is not ZeroVelocity
    if is_plain and all(type(value) is float for value in values):
        return measurement
    if isinstance(measurement, ZeroVelocity):
        return ZeroVelocity(stamp, _three("sigma", measurement.sigma))
    if isinstance(measurement, PoseFix):
        x, y, yaw = _three("x, y, yaw", (measurement.x, measurement.y, measurement.yaw))
        return PoseFix(stamp, x, y, yaw, _three_rows("covariance", measurement.covariance))
    make: Any = kind
    try:
        return make(stamp, *map(float, values))  # type: ignore[no-any-return]
    except (TypeError, ValueError):
        raise EstimatorError(
            f"{stream}: all but the stamp must be numbers: {measurement!r}"
        ) from None


def event_row(event: Event) -> tuple[Any, ...]:
    """An event as its stream's name and its attributes in order."""
    return (EVENTS[type(event)], *astuple(event))


def event_of(row: tuple[Any, ...]) -> Event:
    """The event that `event_row` made the row of.

    Raises:
        EstimatorError: it is no such row.
    """
    for kind, stream in EVENTS.items():
        if row and stream == row[0]:
            try:
                event = kind(*row[1:])
            except TypeError:
                break
            return event if isinstance(event, Mark) else as_plain(event)
    raise EstimatorError(f"no measurement: {row!r}")


def kind_of(measurement: Measurement) -> type[Measurement]:
    """Which of `STREAMS` a measurement belongs to.

    Raises:
        EstimatorError: it is no measurement.
    """
    if type(measurement) in STREAMS:
        return type(measurement)
    for kind in STREAMS:
        if isinstance(measurement, kind):
            return kind
    raise EstimatorError(
        f"no measurement: {measurement!r}; feed TrackSpeeds, ImuSample, PositionFix, HeadingFix, "
        "BodyVelocity, PoseFix or ZeroVelocity"
    )


def _three(name: str, values: Any) -> Vector3:
    try:
        first, second, third = values
        return float(first), float(second), float(third)
    except (TypeError, ValueError):
        raise EstimatorError(f"{name} must be three numbers, found {values!r}") from None


def _three_rows(name: str, rows: Any) -> Matrix3:
    try:
        first, second, third = rows
        return _three(name, first), _three(name, second), _three(name, third)
    except (TypeError, ValueError, EstimatorError):
        raise EstimatorError(
            f"{name} must be three rows of three numbers, found {rows!r}"
        ) from None


class Admission:
    """Objects to measurements that cannot be right, whatever the filter says.

    Args:
        longest_gap: a stamp this much ahead of the estimate is not believed, unless
            `CLOCK_WITNESSES` of its stream in a row are [s].
        fastest: no track is faster [m/s].

    Attributes:
        witnesses: of each stream that is far ahead: how many samples in a row were, and the stamp of
            the newest of them [ns].
    """

    def __init__(self, longest_gap: float, fastest: float) -> None:
        self._longest_gap = int(longest_gap / NANOSECOND)
        self._absurd = ABSURD_SPEED * fastest
        self.witnesses: dict[str, tuple[int, int]] = {}
        self._behind: list[Measurement] = []

    def in_time(self) -> None:
        """A measurement was in time."""
        if self._behind:
            self._behind.clear()

    def too_old(self, measurement: Measurement) -> list[Measurement]:
        """A measurement was too old to be taken in.

        Returns:
            The measurements in a row that were, in the order of their stamps, where these are so many
            and so even that it must be the clock that was set back; otherwise nothing.
        """
        behind = self._behind
        if behind and abs(measurement.stamp - behind[-1].stamp) > self._longest_gap:
            behind.clear()
        behind.append(measurement)
        if len(behind) < BEHIND:
            return []
        of_each = [sum(type(one) is kind for one in behind) for kind in (TrackSpeeds, ImuSample)]
        if min(of_each) < BEHIND_OF_EACH:
            del behind[0]
            return []
        found = sorted(behind, key=key_of)
        behind.clear()
        return found

    def objection(self, measurement: Measurement) -> str | None:
        """Why what was measured cannot be right; None admits it.

        Args:
            measurement: as `as_plain` returns it.
        """
        match measurement:
            case TrackSpeeds():
                speeds = measurement.left, measurement.right
                if not _are_finite(speeds):
                    return "not finite"
                return "absurdly fast" if _largest(speeds) > self._absurd else None
            case ImuSample():
                rates, force = measurement.angular_velocity, measurement.linear_acceleration
                if not (_are_finite(rates) and (force is None or _are_finite(force))):
                    return "not finite"
                if _largest(rates) > ABSURD_RATE:
                    return "absurd rate"
                return "absurd force" if force and _largest(force) > ABSURD_FORCE else None
            case PoseFix():
                if not _are_finite((measurement.x, measurement.y, measurement.yaw)):
                    return "not finite"
                return _objection_to_covariance(measurement.covariance)
            case ZeroVelocity():
                sigma = measurement.sigma
                positive = _are_finite(sigma) and all(
                    one > 0.0 < one * one < math.inf for one in sigma
                )
                return None if positive else "sigma not positive"
            case PositionFix():
                values: Sequence[float] = (measurement.x, measurement.y)
            case HeadingFix():
                values = (measurement.yaw,)
            case BodyVelocity():
                values = (measurement.v_x, measurement.v_y)
        if not _are_finite(values):
            return "not finite"
        if isinstance(measurement, BodyVelocity) and _largest(values) > self._absurd:
            return "absurdly fast"
        variance = measurement.variance
        return None if math.isfinite(variance) and variance > 0.0 else "variance not positive"

    def objection_to_stamp(self, stream: str, stamp: int, now: int | None) -> str | None:
        """Why a stamp [ns] is so far ahead that it is wrong, unless others of its stream agree.

        Args:
            stream: name of the stream.
            stamp: of its measurement.
            now: stamp of the estimate, or None before the first.
        """
        if now is None or stamp - now <= self._longest_gap:
            self.witnesses.pop(stream, None)
            return None
        count, before = self.witnesses.get(stream, (0, stamp))
        count = count + 1 if abs(stamp - before) <= self._longest_gap else 1
        self.witnesses[stream] = (count, stamp)
        return "stamp far ahead" if count < CLOCK_WITNESSES else None


def _is_plain(values: Any) -> bool:
    if type(values) is not tuple or len(values) != 3:
        return False
    first, second, third = values
    return type(first) is type(second) is type(third) is float


def _objection_to_covariance(covariance: Matrix3) -> str | None:
    matrix = np.array(covariance)
    if not np.isfinite(matrix).all():
        return "not finite"
    variances = matrix.diagonal()
    if variances.min() <= 0.0:
        return "variance not positive"
    sigmas = np.sqrt(variances)
    correlation = matrix / sigmas / sigmas[:, None]
    if np.abs(correlation - correlation.T).max() > ASYMMETRY:
        return "covariance not symmetric"
    least = np.linalg.eigvalsh(0.5 * (correlation + correlation.T))[0]
    return None if least >= LEAST_SHARE else "covariance not positive definite"


def _largest(values: Sequence[float]) -> float:
    return max(map(abs, values))


def _are_finite(values: Sequence[float]) -> bool:
    return all(map(math.isfinite, values))
