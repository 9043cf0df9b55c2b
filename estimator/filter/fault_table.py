"""Table of faults: what indicates each, and what the filter does while it lasts.

The rules stand in `icreckon.estimator.faults` and `sensors`; a row reads the record that they keep.
`add_fault` adds a fault of a user.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import msgspec

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.records import NEVER
from icreckon.estimator.faults.departing_fixes import are_departing
from icreckon.estimator.faults.failed_gyro import BEYOND, JUMPED, REPEATS, WORKS
from icreckon.estimator.faults.odd_wheels import NO_WHEEL, are_found
from icreckon.estimator.faults.repeating_fixes import most_driven
from icreckon.estimator.faults.scattering_fixes import innovation_correlation, wanders
from icreckon.estimator.faults.sliding_robot import slides
from icreckon.estimator.faults.spinning_tracks import LEFT, RIGHT, is_found
from icreckon.estimator.faults.stuck_tracks import frozen_from, reads_zero, stuck_from
from icreckon.estimator.log.measurements import Measurement
from icreckon.estimator.sensors.imu_clock import is_alive

LARGE_SLIP = 3.0  # factor on the slip from which it is a finding
# Number of rejected position fixes in a row that is a finding, and time of rejections of others [s].
REJECTED_IN_A_ROW, REJECTED_FOR = 3, 3.0
FEWEST_REFUSED = 20  # refused measurements of a stream per accepted one that are a finding
TURN_BY_TRACKS = "the tracks turn the pose"
CORRELATED = 0.5  # correlation of successive innovations of position fixes that is clear
# Reasons to reject fixes that repeat a position, and readings of the gyro, by its fault.
REPEATED = "repeats itself"
GYRO_FAULTS = {JUMPED: "jumped", REPEATS: REPEATED, BEYOND: "beyond its range"}


class Finding(NamedTuple):
    """Fault that a filter has found and that lasts.

    Attributes:
        sensor: name of the sensor in `Health.sensors`, or "robot".
        part: part of the sensor, such as "left track" or "right wheel 2"; "" for all of it.
        fault: name of the fault, see `FAULTS`.
        since: stamp at which it began, or was found if that is not known [ns]; None for most faults of
            fixes. For a silent sensor it is the stamp of its last sample.
        size: size in the unit of the fault (m/s, m or a ratio); None if it has none.
        text: the finding in words, with units; it changes while the fault lasts.
        effect: what the filter does meanwhile.
    """

    sensor: str
    part: str
    fault: str
    since: int | None
    size: float | None
    text: str
    effect: str


class Found(NamedTuple):
    """Finding of a rule, see `Finding`; if the effect is empty, the row's applies."""

    sensor: str
    text: str
    part: str = ""
    since: int | None = None
    size: float | None = None
    effect: str = ""


class Fault(NamedTuple):
    """Row of the table.

    Attributes:
        name: name of the fault.
        indication: what indicates it.
        effect: what the filter does while it lasts.
        rule: file of its rule in `estimator/`.
        find: finds it in a `FilterRecord`.
        times: number of times that it was found, from a `FilterRecord`; None if that is not counted.
    """

    name: str
    indication: str
    effect: str
    rule: str
    find: Callable[[Any], Iterator[Found]]
    times: Callable[[Any], int] | None = None


# --- rules: each reads a `FilterRecord` and finds one fault of the table while it lasts ----------------


def _find_stuck(record: Any) -> Iterator[Found]:
    tracks, settings = record.tracks, record.settings
    frozen_since = frozen_from(tracks.repeating_left, tracks.repeating_right, settings.track_speed)
    if frozen_since != NEVER:
        effect = "the speeds are unknown, as in a gap; accelerometers are excluded"
        text = "both tracks repeat their readings"
        yield Found("tracks", text, since=frozen_since, effect=effect)
        return
    for side, track in (("left", tracks.repeating_left), ("right", tracks.repeating_right)):
        since = stuck_from(track, settings.hold)
        if since != NEVER:
            part = f"{side} track"
            yield Found("tracks", f"the {part} repeats its reading", part, since)


def _find_silent(record: Any) -> Iterator[Found]:
    tracks, imu = record.tracks, record.imu
    hold = record.settings.hold
    if tracks.stamp != NEVER and (record.stamp - tracks.stamp) * NANOSECOND > hold:
        yield Found("tracks", "no track speeds", since=tracks.stamp)
    if imu.stamp != NEVER and not is_alive(imu, record.stamp, hold):
        text = f"no IMU samples: {TURN_BY_TRACKS}"
        yield Found("imu", text, since=imu.stamp, effect=TURN_BY_TRACKS)


def _find_spinning(record: Any) -> Iterator[Found]:
    tracks, spin = record.tracks, record.tracks.spin
    if is_found(spin):
        part = {LEFT: "left track", RIGHT: "right track"}.get(spin.side, "")
        which, size = f"the {part}" if part else "one track", abs(spin.mismatch)
        text = f"{which} spins, or its sensor fails: {size:.2f} m/s too much"
        for side, track in ((LEFT, tracks.repeating_left), (RIGHT, tracks.repeating_right)):
            if side == spin.side and reads_zero(track):
                text = f"{which} reads zero while the robot drives on: its sensor or drive fails"
        yield Found("tracks", text, part, spin.since, size)


def _find_wheel_off(record: Any) -> Iterator[Found]:
    tracks = record.tracks
    for side, wheels in (("left", tracks.left_wheels), ("right", tracks.right_wheels)):
        if not are_found(wheels):
            continue
        if wheels.odd == NO_WHEEL:
            part = f"{side} wheels"
            apart = 2.0 * wheels.apart  # both possible speeds: each is `apart` from their mean
            text = f"the {part} are {apart:.2f} m/s apart, which is right is not clear"
        else:
            part = f"{side} wheel {wheels.odd + 1}"
            apart = wheels.apart
            text = f"the {part} is {apart:.2f} m/s off"
        yield Found("tracks", text, part, wheels.since, apart)


def _find_sliding(record: Any) -> Iterator[Found]:
    slide = record.tracks.forward
    if slides(slide):
        comparison = "slower" if slide.speed < 0.0 else "faster"
        text = f"the robot is {abs(slide.speed):.2f} m/s {comparison} than its tracks"
        yield Found("robot", text, since=slide.since, size=slide.speed)


def _find_carried(record: Any) -> Iterator[Found]:
    if record.still.carried_since != NEVER:
        text = "the robot is shaken or turned with its tracks at rest: it may be carried"
        yield Found("robot", text, since=record.still.carried_since)


def _find_slipping(record: Any) -> Iterator[Found]:
    factor = float(record.slip_factor)
    if factor > LARGE_SLIP:
        text = f"position fixes show {factor:.1f} times the slip expected, or they wander"
        yield Found("robot", text, size=factor)


def _find_failing(record: Any) -> Iterator[Found]:
    gyro = record.tracks.gyro
    if gyro.fault != WORKS:
        verb = "is " if gyro.fault == BEYOND else ""
        text = f"the reading of the gyro {verb}{GYRO_FAULTS[gyro.fault]}"
        yield Found("gyro", text, since=gyro.since)


def _find_repeating(record: Any) -> Iterator[Found]:
    for sensor, place in (("position", record.positions), ("pose", record.poses)):
        size = abs(place.driven)
        if size > most_driven(place):
            text = f"fixes repeat a position over {size:.1f} m of driving"
            yield Found(sensor, text, size=size)


def _find_rejected(record: Any) -> Iterator[Found]:
    count = record.fixes.rejected.count
    if count >= REJECTED_IN_A_ROW:
        text = f"the last {count} fixes or more were rejected: they or the pose are wrong"
        yield Found("position", text)


def _find_scattering(record: Any) -> Iterator[Found]:
    scatter = record.fixes.scatter
    sigma = math.sqrt(scatter.variance)
    if sigma > 0.0:
        wander = ", as their errors wander" if wanders(scatter) else ""
        text = f"fixes scatter more than stated: used with a sigma of {sigma:.2g} m{wander}"
        yield Found("position", text, size=sigma)


def _find_wandering(record: Any) -> Iterator[Found]:
    correlation = innovation_correlation(record.fixes.scatter)
    if correlation is not None and correlation > CORRELATED and not record.fixes.scatter.variance:
        reason = f"successive innovations have a correlation of {correlation:.2f}"
        text = f"errors of fixes wander, or the robot slips for long: {reason}"
        yield Found("position", text, size=correlation)


def _find_departing(record: Any) -> Iterator[Found]:
    if are_departing(record):
        size = math.hypot(record.departed_by_x, record.departed_by_y)
        text = f"fixes depart from the path, now by {size:.2f} m"
        yield Found("position", text, size=size)


def refused_stream(stream: str, rejected: Mapping[str, int], reached: int) -> Iterator[Finding]:
    """Find a stream of which few measurements have `reached` the filter."""
    count = sum(rejected.values())
    if count >= FEWEST_REFUSED * max(1, reached):
        reason = max(rejected, key=lambda reason: rejected[reason])
        remedy = "correct the driver"
        if "stamp" in reason or "history" in reason:
            remedy = "use the clock of the tracks, or raise Settings.history above the delay"
        text = f"measurements of {stream} are refused: {reason}; {remedy}"
        effect = TURN_BY_TRACKS if stream == "imu" else "they are not used"
        yield Finding(stream, "", "silent", None, float(count), text, effect)


def rejected_sensor(sensor: str, rejected_for: float) -> Iterator[Finding]:
    """Find a sensor of pose or twist that is rejected for too long a time [s]."""
    if rejected_for >= REJECTED_FOR:
        text = f"{sensor}: rejected for {rejected_for:.0f} s, it or the pose is wrong"
        effect = "its measurements are excluded until `Settings.gates.patience` ends"
        yield Finding(sensor, "", "rejected", None, rejected_for, text, effect)


FAULTS = (
    Fault(
        "stuck",
        "a track speed repeats itself while the other changes, or both do",
        "the speed stays in use with an error that grows with time; accelerometers are excluded",
        "faults/stuck_tracks.py",
        _find_stuck,
        lambda record: record.tracks.stuck,
    ),
    Fault(
        "silent",
        "no sample for longer than `Settings.hold`, or nearly all are refused",
        "the last track speeds fade within seconds and their error grows",
        "sensors/held_tracks.py",
        _find_silent,
    ),
    Fault(
        "spinning",
        "track speeds differ by more than the gyro and the robot's own bends explain",
        "the speed of that track is replaced by the speed of the other one and the gyro's turning",
        "faults/spinning_tracks.py",
        _find_spinning,
        lambda record: record.tracks.spin.times,
    ),
    Fault(
        "wheel off",
        "a wheel differs from the others of its side by 0.15 m/s, or a tenth of the fastest speed",
        "the wheel is excluded; as long as it is unclear which, their mean is used with a larger error",
        "faults/odd_wheels.py",
        _find_wheel_off,
        lambda record: record.tracks.left_wheels.times + record.tracks.right_wheels.times,
    ),
    Fault(
        "sliding",
        "the accelerometer shows a change of velocity that the tracks do not, or the reverse",
        "the error of the forward speed grows by the size of the slide",
        "faults/sliding_robot.py",
        _find_sliding,
        lambda record: record.tracks.forward.times,
    ),
    Fault(
        "carried",
        "the gyro is not quiet for a second while the tracks rest",
        "the speed is unknown; accelerometers are excluded",
        "sensors/standstill.py",
        _find_carried,
        lambda record: record.still.carries,
    ),
    Fault(
        "slipping",
        "innovations of position fixes point to one side of the robot again and again",
        "the standard deviation of the slip is larger by this factor",
        "filter/slip_factor.py",
        _find_slipping,
    ),
    Fault(
        "failing",
        "the yaw rate jumps further than friction can turn the robot, repeats itself while the tracks' "
        "turning changes, or is at the end of `gyro_range`",
        "readings of the gyro are excluded; only the tracks turn the pose",
        "faults/failed_gyro.py",
        _find_failing,
        lambda record: record.tracks.gyro.times,
    ),
    Fault(
        "repeating",
        "fixes repeat a position while the tracks drive",
        "fixes are excluded",
        "faults/repeating_fixes.py",
        _find_repeating,
        lambda record: record.positions.rejected + record.poses.rejected,
    ),
    Fault(
        "rejected",
        "the gate rejects three position fixes in a row, or another sensor for 3 s",
        "fixes are excluded until the path can be aligned with them, or `Settings.gates.patience` ends",
        "filter/reacquisition.py",
        _find_rejected,
    ),
    Fault(
        "scattering",
        "fixes scatter about the path along and across by more than they state",
        "fixes are used with the larger variance, and what they have moved becomes uncertain",
        "faults/scattering_fixes.py",
        _find_scattering,
        lambda record: record.fixes.scatter.used,
    ),
    Fault(
        "wandering",
        "successive innovations of position fixes are correlated",
        "none; `wander_sigma` in `[log.fixes]` accounts for it",
        "faults/scattering_fixes.py",
        _find_wandering,
    ),
    Fault(
        "departing",
        "rejected fixes depart from the path by more and more, no faster than the robot",
        "slip, yaw and gyro bias become uncertain by what explains it; fixes are used then",
        "faults/departing_fixes.py",
        _find_departing,
    ),
)
"""Faults in the order in which `Health.findings` has them."""


# --- faults at the rows of a run -----------------------------------------------------------------------

# Faults that a row of a run has, and their parts, by column.
FAULT_COLUMNS = (
    ("stuck", "both tracks"),
    ("stuck", "left track"),
    ("stuck", "right track"),
    ("spinning", "left track"),
    ("spinning", "right track"),
    ("spinning", "one track"),
    ("wheel off", "left wheels"),
    ("wheel off", "right wheels"),
    ("silent", "IMU"),
    ("failing", "gyro"),
    ("sliding", "robot"),
    ("carried", "robot"),
    ("departing", "fixes"),
)


def put_faults(record: Any, row: Any) -> None:
    """Write the faults that last to a row (k,), see `FAULT_COLUMNS`; also for numba."""
    tracks, settings = record.tracks, record.settings
    left, right, spin = tracks.repeating_left, tracks.repeating_right, tracks.spin
    is_frozen = frozen_from(left, right, settings.track_speed) != NEVER
    row[0] = is_frozen
    row[1] = not is_frozen and stuck_from(left, settings.hold) != NEVER
    row[2] = not is_frozen and stuck_from(right, settings.hold) != NEVER
    row[3] = is_found(spin) and spin.side == LEFT
    row[4] = is_found(spin) and spin.side == RIGHT
    row[5] = is_found(spin) and spin.side != LEFT and spin.side != RIGHT
    row[6] = are_found(tracks.left_wheels)
    row[7] = are_found(tracks.right_wheels)
    row[8] = record.imu.stamp != NEVER and not is_alive(record.imu, record.stamp, settings.hold)
    row[9] = tracks.gyro.fault != WORKS
    row[10] = slides(tracks.forward)
    row[11] = record.still.carried_since != NEVER
    row[12] = are_departing(record)


# --- faults of users ----------------------------------------------------------------------------------


class Exclude(NamedTuple):
    """Effect: reject the measurement; the reason is the name of the fault."""


class Replace(NamedTuple):
    """Effect: use another measurement of the same type and stamp."""

    measurement: Measurement


class Inflate(NamedTuple):
    """Effect: add the squares of these to the variances of states, see `state_names`.

    States of `LEARNT` that the variant does not estimate stay fixed.
    """

    sigmas: dict[str, float]


Effect = Exclude | Replace | Inflate


class FilterView(Protocol):
    """View of the filter before it takes a measurement, for faults of users."""

    @property
    def stamp(self) -> int | None:
        """Time of the estimate [ns]."""

    @property
    def stands(self) -> bool:
        """True if the robot was found standing."""

    @property
    def track_speeds(self) -> tuple[float, float]:
        """Present speeds of the left and the right track [m/s]."""

    def snapshot(self) -> Any:
        """State, covariance, twist and its covariance, see `PoseEstimator.snapshot`."""


class OwnFault(msgspec.Struct):
    """Fault of your own.

    Its fields are its memory: finite numbers, texts, None, and lists of them, with defaults. Fields are
    copied for late measurements and saved. A stamp has the type `Stamp` of
    `icreckon.estimator.base.records` and the default None, so that it follows changes of the clock.

    If a fault raises, or returns anything but an effect or None, that estimator no longer watches for it,
    and `Health.findings` reports the error.

    Attributes:
        name: name of the fault.
        effect: what it does, in words.
    """

    name: ClassVar[str]
    effect: ClassVar[str]

    def watch(self, measurement: Measurement, view: FilterView) -> Effect | None:
        """Watch a measurement before the filter takes it; return an effect or None."""
        raise NotImplementedError("a fault needs a method `watch`")

    def find(self) -> Found | None:
        """Return what lasts, for `Health.findings`; None if nothing does."""
        return None


OWN_FAULTS: dict[str, type[OwnFault]] = {}  # faults of users by name
RESERVED = ("gate", REPEATED)  # reasons of rejections, which are no names for faults


def add_fault(kind: type[OwnFault]) -> None:
    """Add a fault; estimators that are made afterwards watch for it.

    Logs are then streamed in one process. Studies and `run_many` refuse to run.

    Raises:
        EstimatorError: it is no `OwnFault`, has no name or effect or a name that is taken, or a field has
            no default.
    """
    texts = [getattr(kind, name, None) for name in ("name", "effect")]
    has_texts = all(isinstance(text, str) and text for text in texts)
    if not (isinstance(kind, type) and issubclass(kind, OwnFault) and has_texts):
        raise EstimatorError(
            f"a fault is a class of OwnFault with a name and an effect, found {kind!r}"
        )
    if kind.name in (*OWN_FAULTS, *RESERVED, *(fault.name for fault in FAULTS)):
        raise EstimatorError(f"{kind.name!r}: there is such a fault already")
    try:
        kind()
    except TypeError as problem:
        raise EstimatorError(f"{kind.name!r}: all fields need defaults: {problem}") from None
    OWN_FAULTS[kind.name] = kind


def remove_fault(name: str) -> None:
    """Remove a fault that `add_fault` added; estimators that exist keep it.

    Raises:
        EstimatorError: there is no such fault.
    """
    if OWN_FAULTS.pop(name, None) is None:
        raise EstimatorError(f"{name!r}: no such fault was added, found {sorted(OWN_FAULTS)}")


def findings_of(record: Any) -> list[Finding]:
    """Find the faults of the table that last, by a `FilterRecord`."""
    return [finding(fault, found) for fault in FAULTS for found in fault.find(record)]


def finding(fault: Fault | OwnFault, found: Found) -> Finding:
    """Complete what a rule found with the name and the effect of its fault."""
    since = None if found.since is None or found.since == NEVER else int(found.since)
    effect = found.effect or fault.effect
    return Finding(found.sensor, found.part, fault.name, since, found.size, found.text, effect)


def times_of(record: Any) -> dict[str, int]:
    """Number of times that each fault was found, if it was, by its name."""
    counts = {fault.name: int(fault.times(record)) for fault in FAULTS if fault.times is not None}
    return {name: count for name, count in counts.items() if count}
