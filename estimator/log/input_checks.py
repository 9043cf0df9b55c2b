"""Input validation: reject measurements that are implausible on their own."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from decimal import Decimal
from functools import cache
from numbers import Real
from typing import Any, get_type_hints

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.checks import clipped_correlations
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    HeightFix,
    ImuSample,
    Mark,
    Matrix3,
    Measurement,
    PoseFix,
    PositionFix,
    Speeds,
    TrackSpeeds,
    Vector3,
    ZeroVelocity,
)

# Streams by type of measurement, in the order of processing at equal stamps, as in `Log.measurements`.
STREAMS: dict[type[Measurement], str] = {
    TrackSpeeds: "tracks",
    ImuSample: "imu",
    PositionFix: "position",
    HeadingFix: "heading",
    BodyVelocity: "body velocity",
    PoseFix: "pose",
    ZeroVelocity: "zero velocity",
    HeightFix: "height",
}
MARK = "mark"
Event = Measurement | Mark  # events in order: measurements, and stochastic clones behind them
RANKS: dict[type[Event], int] = {kind: rank for rank, kind in enumerate(STREAMS)}
RANKS[Mark] = 1000
Key = tuple[int, int]  # sort key of an event: its stamp [ns], and its rank
CLOCK_STREAMS = "tracks", "imu"  # streams whose stamps indicate that the clock was set
CLOCK_WITNESSES = 10  # samples in a row that agree before a clock that jumped ahead is accepted
# Consecutive measurements that are too old, in total and of tracks and IMU each, that indicate a
# clock that was set back.
BEHIND, BEHIND_OF_EACH = 20, 4
MOST_BEHIND = 500  # most of these that are kept
# Track speeds and body velocities above this multiple of the fastest track are implausible.
ABSURD_SPEED = 10.0
# No gyro of a vehicle reads more [rad/s], and no accelerometer [m/s²].
ABSURD_RATE, ABSURD_FORCE = 100.0, 1000.0
# No place is further from the origin of its map [m], and no antenna from the robot [m].
ABSURD_DISTANCE, ABSURD_LEVER = 1e10, 1e3
# Stamps that are held in 64 bits, with all differences between them: from 1896 to 2116 [ns].
EARLIEST, LATEST = -(2**61), 2**62 - 1
NOT_FINITE, OUT_OF_RANGE = "not finite", "stamp out of range"  # reasons to reject
LONGEST_TEXT = 200  # longest text of a value in a message
# Largest asymmetry of a covariance, and its least eigenvalue, relative to its standard deviations.
ASYMMETRY, LEAST_SHARE = 1e-6, 1e-14


def key_of(event: Event) -> Key:
    """Sort key of an event in the order of processing."""
    return event.stamp, RANKS[type(event)]


def add_stream(kind: type[Measurement], stream: str) -> None:
    """Add a type of measurements, processed after all others at equal stamps.

    Raises:
        EstimatorError: the type or the name is taken, the first field is not `stamp`, or another is
            neither a float nor a tuple of floats, of three, or of three by three.
    """
    if kind in STREAMS or stream in (*STREAMS.values(), MARK):
        raise EstimatorError(f"{kind.__name__}, {stream!r}: there is such a sensor already")
    if getattr(kind, "__match_args__", ())[:1] != ("stamp",):
        raise EstimatorError(f"{kind.__name__}: the first field must be stamp")
    for name, wanted in _fields(kind).items():
        if wanted not in CONVERTERS:
            raise EstimatorError(
                f"{kind.__name__}.{name}: cannot be {wanted}, but float, or a tuple of floats, of "
                "three or of three by three"
            )
    RANKS[kind] = max(rank for other, rank in RANKS.items() if other is not Mark) + 1
    STREAMS[kind] = stream


def remove_stream(kind: type[Measurement]) -> None:
    """Remove a type of measurements that `add_stream` added."""
    del STREAMS[kind], RANKS[kind]


@cache
def _fields(kind: type) -> dict[str, Any]:
    """Types of a measurement's fields after the stamp, by name."""
    hints = get_type_hints(kind)
    return {name: hints[name] for name in kind.__match_args__[1:]}  # type: ignore[attr-defined]


def as_plain(measurement: Measurement) -> Measurement:
    """Convert a measurement to immutable plain integers, floats and tuples.

    Raises:
        EstimatorError: it is not a measurement, or holds a value that is not a number.
    """
    kind = kind_of(measurement)
    stream = STREAMS[kind]
    stamp = as_stamp(stream, measurement.stamp)
    fields = _fields(kind)
    values = [getattr(measurement, name) for name in fields]
    is_plain = type(measurement) is kind and stamp is measurement.stamp
    types = zip(map(type, values), fields.values(), strict=True)
    if is_plain and all(found is float and wanted is float for found, wanted in types):
        return measurement
    converted = [
        _converted(f"{stream}: {name}", wanted, value)
        for (name, wanted), value in zip(fields.items(), values, strict=True)
    ]
    make: Any = kind
    return make(stamp, *converted)  # type: ignore[no-any-return]


def as_stamp(name: str, stamp: Any) -> int:
    """Convert a stamp to a plain integer [ns].

    Args:
        name: name of what it is the stamp of, for the message.
        stamp: an integer of any type.

    Raises:
        EstimatorError: it is not an integer.
    """
    if type(stamp) is int:
        return stamp
    if isinstance(stamp, bool) or not isinstance(stamp, int | np.integer):
        raise EstimatorError(
            f"{name}: a stamp is an integer of nanoseconds, found {_text(stamp)}; use round(s * 1e9)"
        )
    return int(stamp)


def stamp_of_mark(stamp: object) -> int:
    """Stamp of a mark as a plain integer in range [ns]."""
    plain_stamp = as_stamp("mark", stamp)
    if not EARLIEST <= plain_stamp <= LATEST:
        raise EstimatorError(f"there is no mark of this stamp: {OUT_OF_RANGE}")
    return plain_stamp


def event_row(event: Event) -> tuple[Any, ...]:
    """Row of an event: its stream's name, and its attributes in order."""
    if isinstance(event, Mark):
        return MARK, event.stamp
    kind = type(event)
    return (STREAMS[kind], event.stamp, *(getattr(event, name) for name in _fields(kind)))


def event_of(row: tuple[Any, ...]) -> Event:
    """Event of a row from `event_row`.

    Raises:
        EstimatorError: it is not such a row.
    """
    kinds: dict[str, Any] = {stream: kind for kind, stream in STREAMS.items()} | {MARK: Mark}
    name = row[0] if row and isinstance(row[0], str) else ""
    kind = kinds.get(name)
    if kind is None and name:
        raise EstimatorError(f"sensor {name!r} is not known here: register it before")
    # A row has all fields, those with a default included.
    if kind is not None and len(row) == (2 if kind is Mark else 2 + len(_fields(kind))):
        with suppress(TypeError):
            event: Event = kind(*row[1:])
            return event if kind is Mark else as_plain(event)
    raise EstimatorError(f"no measurement: {row!r}")


def measurement_of(row: tuple[Any, ...]) -> Measurement:
    """Measurement of a row from `event_row`.

    Raises:
        EstimatorError: it is not such a row, or that of a mark.
    """
    event = event_of(row)
    if isinstance(event, Mark):
        raise EstimatorError(f"no measurement: {row!r}")
    return event


def kind_of(measurement: Measurement) -> type[Measurement]:
    """Type of a measurement, a key of `STREAMS`.

    Raises:
        EstimatorError: it is not a measurement.
    """
    if type(measurement) in STREAMS:
        return type(measurement)
    for kind in STREAMS:
        if isinstance(measurement, kind):
            return kind
    *most, last = (kind.__name__ for kind in STREAMS)
    found = _text(measurement)
    raise EstimatorError(f"no measurement: {found}; feed {', '.join(most)} or {last}")


def _text(value: Any) -> str:
    """Text of a value in a message; its type for an integer too large to print."""
    try:
        return repr(value)[:LONGEST_TEXT]
    except ValueError:
        return type(value).__name__


def _float(value: Any) -> float:
    """Convert a real number; one that is beyond the range of a float becomes infinite.

    Raises:
        TypeError: it is no real number, as a string or a bool are none.
        ValueError: it is a signalling NaN.
    """
    if type(value) is float:
        return value
    if getattr(value, "ndim", None) == 0 and not isinstance(value, np.generic):
        value = value.item()  # of an array without dimensions
    if isinstance(value, bool) or not isinstance(value, Real | Decimal):
        raise TypeError
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf  # type: ignore[operator]


def _three(values: Any, convert: Callable[[Any], Any] = _float) -> tuple[Any, Any, Any]:
    """Convert three numbers, or other values; a ValueError for more or fewer."""
    first, second, third = values
    return convert(first), convert(second), convert(third)


# Allowed values and their conversion, by type of field.
CONVERTERS: dict[Any, tuple[str, Callable[[Any], Any]]] = {
    float: ("a number", _float),
    Vector3: ("three numbers", _three),
    Vector3 | None: ("three numbers", lambda values: None if values is None else _three(values)),
    Matrix3: ("three rows of three numbers", lambda rows: _three(rows, _three)),
    Speeds: ("numbers", lambda values: tuple(map(_float, values))),
}


def _converted(name: str, kind: Any, value: Any) -> Any:
    """Value of a field as plain floats and tuples; `EstimatorError` for no number."""
    wanted, convert = CONVERTERS[kind]
    try:
        return convert(value)
    except (TypeError, ValueError):
        raise EstimatorError(f"{name} must be {wanted}, found {_text(value)}") from None


class Admission:
    """Admission of measurements: reject implausible ones, independently of the filter.

    Args:
        longest_gap: a stamp this much ahead of the estimate is rejected, unless `CLOCK_WITNESSES`
            consecutive samples of its stream are [s].
        fastest: highest speed of a track [m/s].
        gyro_axes: axes of the gyro that are used, "xyz" or "z".

    Attributes:
        longest_gap: the argument in nanoseconds.
        witnesses: for each stream that is far ahead, the number of consecutive samples that were, and
            the stamp of the newest of them [ns].
        behind: the newest consecutive measurements that were too old.
    """

    def __init__(self, longest_gap: float, fastest: float, gyro_axes: str = "xyz") -> None:
        self.longest_gap = int(longest_gap / NANOSECOND)
        self._gyro_axes = gyro_axes
        self._fastest_plausible = ABSURD_SPEED * fastest  # [m/s]
        self.witnesses: dict[str, tuple[int, int]] = {}
        self.behind: list[Measurement] = []

    def checked(self, measurement: Measurement) -> tuple[Measurement, str | None]:
        """Measurement by `as_plain` without unused readings, and the reason to reject it."""
        # A shortcut for samples of plain numbers, which come hundreds of times a second.
        m: Any = measurement
        kind, is_usual = type(m), False
        if kind is ImuSample:
            force = m.linear_acceleration
            is_usual = _are_usual(m.angular_velocity, ABSURD_RATE) and (
                force is None or _are_usual(force, ABSURD_FORCE)
            )
        elif kind is TrackSpeeds:
            left, right, most = m.left, m.right, self._fastest_plausible
            is_usual = (
                type(left) is type(right) is float
                and -most <= left <= most
                and -most <= right <= most
                and type(m.left_wheels) is type(m.right_wheels) is tuple
                and not (m.left_wheels or m.right_wheels)
            )
        if is_usual and type(m.stamp) is int and EARLIEST <= m.stamp <= LATEST:
            return measurement, None
        plain = as_plain(measurement)
        if isinstance(plain, ImuSample):
            rates, force = plain.angular_velocity, plain.linear_acceleration
            if self._gyro_axes == "z" and not all(abs(rate) <= ABSURD_RATE for rate in rates[:2]):
                rates = 0.0, 0.0, rates[2]  # of axes that are not used
            if force is not None and any(map(math.isnan, force)):
                force = None  # drivers publish NaN if there is no accelerometer
            plain = ImuSample(plain.stamp, rates, force)
        return plain, self.objection(plain)

    def too_old(self, measurement: Measurement) -> list[Measurement]:
        """Record a measurement that was too old to be used.

        Returns:
            The consecutive measurements that were too old, in the order of their stamps, if they are
            enough, in all and of tracks and IMU each, to show that the clock was set back. Otherwise an
            empty list.
        """
        behind = self.behind
        if behind and abs(measurement.stamp - behind[-1].stamp) > self.longest_gap:
            behind.clear()
        behind.append(measurement)
        if len(behind) < BEHIND:
            return []
        counts = [sum(type(m) is kind for m in behind) for kind in (TrackSpeeds, ImuSample)]
        if min(counts) < BEHIND_OF_EACH:
            # An IMU may be dozens of times as fast as the tracks.
            del behind[: max(0, len(behind) - MOST_BEHIND)]
            return []
        in_order = sorted(behind, key=key_of)
        behind.clear()
        return in_order

    def objection(self, measurement: Measurement) -> str | None:
        """Reason to reject measured values; None admits them.

        Values that are not finite are found first, then implausible sizes and noise.

        Args:
            measurement: the measurement, as returned by `checked`.
        """
        if not EARLIEST <= measurement.stamp <= LATEST:
            return OUT_OF_RANGE
        fields = {name: getattr(measurement, name) for name in _fields(type(measurement))}
        for name, value in fields.items():
            if name not in NOISE and value is not None and not _is_finite(value):
                return f"{name} is {NOT_FINITE}"
        for values, most, reason in self._sizes(measurement):
            if any(abs(value) > most for value in values):
                return reason
        checks = (check(fields[name]) for name, check in NOISE.items() if name in fields)
        return next(filter(None, checks), None)

    def _sizes(self, measurement: Measurement) -> list[tuple[Speeds, float, str]]:
        """Values of a measurement, the largest plausible sizes, and reasons."""
        fastest, far = (self._fastest_plausible, "absurdly fast"), (ABSURD_DISTANCE, "absurdly far")
        match measurement:
            case TrackSpeeds(_, left, right, left_wheels, right_wheels):
                return [((left, right, *left_wheels, *right_wheels), *fastest)]
            case ImuSample(_, rates, force):
                of_force = force or (), ABSURD_FORCE, "absurd force"
                return [(rates, ABSURD_RATE, "absurd rate"), of_force]
            case BodyVelocity(_, v_x, v_y):
                return [((v_x, v_y), *fastest)]
            case PositionFix(_, x, y, _, forward, left, up):
                return [((x, y), *far), ((forward, left, up), ABSURD_LEVER, "absurdly far")]
            case PoseFix(_, x, y):
                return [((x, y), *far)]
            case HeightFix(_, z):
                return [((z,), *far)]
        return []

    def objection_to_stamp(self, stream: str, stamp: int, now: int | None) -> str | None:
        """Reason to reject a stamp far ahead, unless others of its stream agree; or None.

        Only tracks and IMU indicate that the clock jumped: fixes far ahead have another clock.

        Args:
            stream: name of the stream.
            stamp: stamp of the measurement [ns].
            now: stamp of the estimate [ns]; None before the first estimate.
        """
        if now is None or stamp - now <= self.longest_gap:
            if self.witnesses:
                self.witnesses.pop(stream, None)
            return None
        count, previous = self.witnesses.get(stream, (0, stamp))
        count = count + 1 if abs(stamp - previous) <= self.longest_gap else 1
        self.witnesses[stream] = (count, stamp)
        has_jumped = count >= CLOCK_WITNESSES and stream in CLOCK_STREAMS
        return None if has_jumped else "stamp far ahead"


def _are_usual(values: Any, most: float) -> bool:
    """Return True for a tuple of three floats of at most a size."""
    if type(values) is not tuple or len(values) != 3:
        return False
    x, y, z = values
    are_plain = type(x) is type(y) is type(z) is float
    return are_plain and -most <= x <= most and -most <= y <= most and -most <= z <= most


def _objection_to_sigma(sigma: float | Sequence[float]) -> str | None:
    """Reason to reject a sigma that is not positive, or whose square is 0 or infinite."""
    sigmas = sigma if isinstance(sigma, tuple) else (sigma,)
    are_positive = all(one > 0.0 and 0.0 < one * one < math.inf for one in sigmas)
    return None if are_positive else "sigma not positive"


def _objection_to_covariance(covariance: Matrix3) -> str | None:
    """Reason to reject a matrix that is not finite, symmetric and positive definite."""
    matrix = np.array(covariance)
    if not np.isfinite(matrix).all():
        return f"covariance is {NOT_FINITE}"
    if matrix.diagonal().min() <= 0.0:
        return "variance not positive"
    correlation = clipped_correlations(matrix)
    if np.abs(correlation - correlation.T).max() > ASYMMETRY:
        return "covariance not symmetric"
    least = np.linalg.eigvalsh(0.5 * correlation + 0.5 * correlation.T)[0]
    return None if least >= LEAST_SHARE else "covariance not positive definite"


# Fields that hold the noise of a measurement.
NOISE: dict[str, Callable[[Any], str | None]] = {
    "variance": lambda value: None if 0.0 < value < math.inf else "variance not positive",
    "sigma": _objection_to_sigma,
    "covariance": _objection_to_covariance,
}


def _is_finite(value: Any) -> bool:
    """Return True for a float, or a tuple of such values, without NaN and infinity."""
    return math.isfinite(value) if type(value) is float else all(map(_is_finite, value))
