"""In-memory log: every stream as arrays, screened once, in REP-103 axes.

`simulation` makes logs, `replay` reads them from and writes them to bags, and the filter runs over them.
Streams are screened when they are made (`screen`): invalid samples are dropped and counted, never
repaired.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from heapq import merge
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Floats, Indexes, Stamps
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.input_checks import STREAMS, Admission, Key, key_of
from icreckon.estimator.log.measurements import (
    HeadingFix,
    ImuSample,
    Measurement,
    PositionFix,
    TrackSpeeds,
)
from icreckon.estimator.log.series import (
    AnySeries,
    FixSeries,
    ImuSeries,
    TrackSpeedSeries,
    Truth,
    require_part,
    rows_of,
)

NO_LIMIT = 1e300  # largest track speed for `Admission` if the robot is not known [m/s]
AT_A_TIME = 8192  # number of measurements of a stream that are made at once

_Maker = Callable[[Indexes], list[Measurement]]
"""Function from indices into a stream to its measurements, in that order."""


@dataclass(frozen=True)
class Log:
    """Log of one run: measurements of all sensors and, if known, the truth.

    Attributes:
        name: name of the log in tables and figures.
        tracks: track speeds.
        imu: IMU samples, or None.
        fixes: position or pose fixes, or None.
        truth: the truth, or None.
        dropped: number of dropped samples, as "stream: reason" -> count.
        notes: remarks of a reader for the user.
        others: measurements without a series (body velocities, pose fixes, zero velocities, headings
            without a position), in the order of their stamps; they are not written to files.
        origin: latitude, longitude [deg] and altitude [m] (WGS 84) of x = y = 0, if x is east and y north
            of a place on the globe; None otherwise.
    """

    name: str
    tracks: TrackSpeedSeries
    imu: ImuSeries | None = None
    fixes: FixSeries | None = None
    truth: Truth | None = None
    dropped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    others: tuple[Measurement, ...] = ()
    origin: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        require_part("name", self.name, str)
        require_part("tracks", self.tracks, TrackSpeedSeries)
        require_part("imu", self.imu, ImuSeries, or_none=True)
        require_part("fixes", self.fixes, FixSeries, or_none=True)
        require_part("truth", self.truth, Truth, or_none=True)

    @classmethod
    def from_measurements(
        cls, measurements: Iterable[Measurement], name: str = "measurements", gyro_axes: str = "xyz"
    ) -> Log:
        """Make a log of measurements in any order, to `run` a filter over or to `smooth`.

        Implausible measurements are dropped and counted, and so are measurements of one type and stamp
        after the first.

        Args:
            measurements: measurements, as for an estimator.
            name: name of the log in tables and figures.
            gyro_axes: `imu.gyro_axes` of the robot; with "z" the other axes may be NaN.

        Raises:
            EstimatorError: an element is not a measurement, or track speeds have differing numbers of
                wheels.
        """
        return cls(name, **_gathered(measurements, gyro_axes))

    def __repr__(self) -> str:
        """One line: duration and numbers of samples."""
        parts = [f"{len(self.tracks.stamps)} track speeds"]
        if self.imu is not None:
            parts.append(f"{len(self.imu.stamps)} IMU samples")
        if self.fixes is not None:
            parts.append(f"{len(self.fixes.stamps)} fixes")
        if self.others:
            parts.append(f"{len(self.others)} others")
        if self.truth is not None:
            parts.append(f"{len(self.truth.poses.stamps)} true poses")
        if self.dropped:
            parts.append(f"{sum(self.dropped.values())} dropped")
        lasts = f"{self.duration:.1f} s: " if len(self.tracks.stamps) else ""
        return f"<Log {self.name!r}, {lasts}{', '.join(parts)}>"

    @property
    def start(self) -> int:
        """Stamp of the earliest track speeds or IMU sample [ns]."""
        return int(min(stamps[0] for stamps in self._stamps()))

    @property
    def end(self) -> int:
        """Stamp of the latest track speeds or IMU sample [ns]."""
        return int(max(stamps[-1] for stamps in self._stamps()))

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        return (self.end - self.start) * NANOSECOND

    def _stamps(self) -> list[Stamps]:
        """Stamps of the track speeds and of the IMU, without empty streams."""
        streams = [self.tracks.stamps] + ([] if self.imu is None else [self.imu.stamps])
        filled = [stamps for stamps in streams if len(stamps)]
        if not filled:
            raise EstimatorError(f"log {self.name!r} holds neither track speeds nor IMU samples")
        return filled

    def part(self, start: float, end: float) -> Log:
        """Part of the log between two times since its start, both included [s].

        Raises:
            EstimatorError: it holds neither track speeds nor IMU samples there.
        """
        first, last = (self.start + round(seconds / NANOSECOND) for seconds in (start, end))
        return self.between(first, last)

    def between(self, start: int, end: int) -> Log:
        """Part of the log between two stamps, both included [ns], with counts and notes.

        The part is empty if `start` is after `end`.

        Raises:
            EstimatorError: the log holds neither track speeds nor IMU samples there.
        """
        if start <= end and (end < self.start or start > self.end):
            raise EstimatorError(
                f"nothing of log {self.name!r} is between {start} and {end} ns: it is from {self.start} "
                f"to {self.end} ns; part(0.0, 10.0) takes seconds since its start"
            )

        def cut(series: AnySeries) -> AnySeries:
            return rows_of(series, (series.stamps >= start) & (series.stamps <= end))

        truth = self.truth
        if truth is not None:
            truth = replace(
                truth,
                poses=cut(truth.poses),
                twists=truth.twists and cut(truth.twists),
                tracks=truth.tracks and cut(truth.tracks),
            )
        return replace(
            self,
            tracks=cut(self.tracks),
            imu=self.imu and cut(self.imu),
            fixes=self.fixes and cut(self.fixes),
            truth=truth,
            others=tuple(other for other in self.others if start <= other.stamp <= end),
        )

    def measurements(self) -> Iterator[Measurement]:
        """Iterate over all measurements in the order of their stamps.

        At equal stamps the order is tracks, IMU, fixes, others.
        """
        streams = [_stream(len(self.tracks.stamps), partial(_track_speeds, self.tracks))]
        if self.imu is not None:
            streams.append(_stream(len(self.imu.stamps), partial(_imu_samples, self.imu)))
        if self.fixes is not None:
            fixes, headed = self.fixes, np.flatnonzero(np.isfinite(self.fixes.poses[:, 2]))
            streams.append(_stream(len(fixes.stamps), partial(_positions, fixes)))
            streams.append(_stream(len(headed), lambda rows: _headings(fixes, headed[rows])))
        by_stamp = attrgetter("stamp")
        return merge(*streams, sorted(self.others, key=by_stamp), key=by_stamp)


def screen(
    stream: str, stamps: ArrayLike, *values: ArrayLike, positive: ArrayLike | None = None
) -> tuple[Flags, dict[str, int]]:
    """Screen a stream: mask of valid samples, and counts of dropped ones by reason.

    A sample is dropped if a value is NaN or infinite, if a variance is not positive, or if its stamp is
    inconsistent with the others. Of the stamps in order of arrival the longest strictly rising sequence
    is kept, so that one wrong stamp, ahead or behind, drops only that sample.

    Args:
        stream: name used in the reasons, "stream: reason".
        stamps: (n,) stamps [ns] in order of arrival.
        values: arrays of n rows; every element must be finite.
        positive: array of n rows, every element finite and positive, or None.
    """
    stamps = np.asarray(stamps, dtype=np.int64)
    count = len(stamps)
    keep = np.ones(count, dtype=bool)
    reasons: dict[str, int] = {}
    if count == 0:
        return keep, reasons

    def drop(is_bad: Flags, reason: str) -> None:
        newly_bad = is_bad & keep
        if newly_bad.any():
            key = f"{stream}: {reason}"
            reasons[key] = reasons.get(key, 0) + int(newly_bad.sum())
            keep[newly_bad] = False

    for value in values:
        finite = np.isfinite(np.asarray(value, dtype=float)).reshape(count, -1).all(axis=1)
        drop(~finite, "not finite")
    if positive is not None:
        variance = np.asarray(positive, dtype=float).reshape(count, -1)
        drop(~(np.isfinite(variance) & (variance > 0)).all(axis=1), "variance not positive")
    rising = _longest_rising(stamps, keep)
    kept = np.flatnonzero(rising)
    if len(kept):
        # Indices of the kept samples before and after each one.
        place = np.searchsorted(kept, np.arange(count))
        before = kept[np.maximum(place - 1, 0)]
        after = kept[np.minimum(place, len(kept) - 1)]
        drop(~rising & (stamps == stamps[before]), "duplicate stamp")
        drop(~rising & (stamps >= stamps[after]) & (stamps > stamps[before]), "stamp jumps ahead")
        drop(~rising, "stamp goes backward")
    return keep, reasons


def _longest_rising(stamps: Stamps, allowed: Flags) -> Flags:
    """Mask (n,) of the longest strictly rising sequence of allowed stamps."""
    chosen = np.zeros(len(stamps), dtype=bool)
    candidates = np.flatnonzero(allowed)
    values = stamps[candidates]
    if (np.diff(values) > 0).all():
        chosen[candidates] = True
        return chosen
    # Patience sorting: for each length (less 1) the rising sequence with the smallest last value.
    last_values: list[int] = []
    last_indices: list[int] = []  # among `values`
    predecessors = np.full(len(values), -1)  # among `values`; -1 begins a sequence
    for index, value in enumerate(values.tolist()):
        length = bisect_left(last_values, value)
        if length == len(last_values):
            last_values.append(value)
            last_indices.append(index)
        elif value < last_values[length]:
            last_values[length], last_indices[length] = value, index
        predecessors[index] = last_indices[length - 1] if length else -1
    index = last_indices[-1]
    while index >= 0:
        chosen[candidates[index]] = True
        index = int(predecessors[index])
    return chosen


def _stream(count: int, make: _Maker) -> Iterator[Measurement]:
    """Yield the measurements of a stream, made in chunks: all would fill the memory."""
    for start in range(0, count, AT_A_TIME):
        yield from make(np.arange(start, min(start + AT_A_TIME, count)))


def _track_speeds(tracks: TrackSpeedSeries, rows: Indexes) -> list[Measurement]:
    columns = [tracks.stamps[rows].tolist(), *tracks.speeds[rows].T.tolist()]
    both_sides = (tracks.left_wheels, tracks.right_wheels)
    columns += [list(map(tuple, side[rows].tolist())) for side in both_sides if side is not None]
    return [TrackSpeeds(*row) for row in zip(*columns, strict=True)]


def _imu_samples(imu: ImuSeries, rows: Indexes) -> list[Measurement]:
    """IMU samples of some rows of a series; a specific force with NaN becomes None."""
    rates = [tuple(row) for row in imu.angular_velocity[rows].tolist()]
    forces: list[Any] = [None] * len(rates)
    if imu.linear_acceleration is not None:
        read = imu.linear_acceleration[rows]
        is_absent = np.asarray(np.isnan(read).any(axis=1)).tolist()
        pairs = zip(read.tolist(), is_absent, strict=True)
        forces = [None if absent else tuple(force) for force, absent in pairs]
    return [ImuSample(*row) for row in zip(imu.stamps[rows].tolist(), rates, forces, strict=True)]


def _positions(fixes: FixSeries, rows: Indexes) -> list[Measurement]:
    place, variances = fixes.poses[rows, :2].T, fixes.variances[rows, 0]
    return _each_row(PositionFix, fixes.stamps[rows], *place, variances, *fixes.lever_arms[rows].T)


def _headings(fixes: FixSeries, rows: Indexes) -> list[Measurement]:
    yaw, variances = fixes.poses[rows, 2], fixes.variances[rows, 1]
    return _each_row(HeadingFix, fixes.stamps[rows], yaw, variances)


def _each_row(kind: Callable[..., Measurement], *columns: NDArray[Any]) -> list[Measurement]:
    return [kind(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def _gathered(measurements: Iterable[Measurement], gyro_axes: str) -> dict[str, Any]:
    """Sort measurements into the fields of a `Log`, by name.

    A heading fix at the stamp of a position fix belongs to it. What has no series is in `others`.
    """
    admission, dropped = Admission(0.0, NO_LIMIT, gyro_axes), dict[str, int]()
    kept: dict[Key, Measurement] = {}
    for measurement, objection in map(admission.checked, measurements):
        key = key_of(measurement)
        reason = objection or ("duplicate stamp" if key in kept else None)
        if reason is None:
            kept[key] = measurement
        else:
            name = f"{STREAMS[type(measurement)]}: {reason}"
            dropped[name] = dropped.get(name, 0) + 1
    ordered = [kept[key] for key in sorted(kept)]
    tracks = [m for m in ordered if isinstance(m, TrackSpeeds)]
    samples = [m for m in ordered if isinstance(m, ImuSample)]
    positions = [m for m in ordered if isinstance(m, PositionFix)]
    stamps = {m.stamp for m in positions}
    headings = {m.stamp: m for m in ordered if isinstance(m, HeadingFix) and m.stamp in stamps}
    rest = [m for m in ordered if not isinstance(m, TrackSpeeds | ImuSample | PositionFix)]
    others = [m for m in rest if not (isinstance(m, HeadingFix) and m.stamp in headings)]
    return {
        "tracks": _tracks(tracks),
        "imu": _imu(samples) if samples else None,
        "fixes": _fixes(positions, headings) if positions else None,
        "dropped": dropped,
        "others": tuple(others),
    }


def _tracks(speeds: list[TrackSpeeds]) -> TrackSpeedSeries:
    """Series of track speeds; wheels are kept if all samples have as many."""
    stamps, means = _stamps(speeds), _array([(m.left, m.right) for m in speeds], 2)
    counts = {(len(m.left_wheels), len(m.right_wheels)) for m in speeds}
    if counts <= {(0, 0)}:
        return TrackSpeedSeries(stamps, means)
    if len(counts) > 1:
        raise EstimatorError(
            "track speeds of one log have as many wheels in each sample; found (left, right) "
            f"{', '.join(map(str, sorted(counts)))}"
        )
    ((left, right),) = counts  # the only one
    left_wheels = _array([m.left_wheels for m in speeds], left)
    right_wheels = _array([m.right_wheels for m in speeds], right)
    return TrackSpeedSeries(stamps, means, left_wheels, right_wheels)


def _imu(samples: list[ImuSample]) -> ImuSeries:
    """Series of IMU samples; without forces if no sample has one."""
    forces: Floats | None = None
    if any(m.linear_acceleration is not None for m in samples):
        no_force = (np.nan, np.nan, np.nan)
        forces = _array([m.linear_acceleration or no_force for m in samples], 3)
    return ImuSeries(_stamps(samples), _array([m.angular_velocity for m in samples], 3), forces)


def _fixes(positions: list[PositionFix], headings: dict[int, HeadingFix]) -> FixSeries:
    """Series of fixes with the headings at their stamps; NaN for a fix without one."""
    no_heading = HeadingFix(0, np.nan, np.nan)
    antennas = _array([(m.forward, m.left, m.up) for m in positions], 3)
    pairs = [(m, headings.get(m.stamp, no_heading)) for m in positions]
    poses = _array([(m.x, m.y, heading.yaw) for m, heading in pairs], 3)
    variances = _array([(m.variance, heading.variance) for m, heading in pairs], 2)
    return FixSeries(_stamps(positions), poses, variances, antennas if antennas.any() else None)


def _stamps(measurements: list[Any]) -> Stamps:
    return np.array([m.stamp for m in measurements], dtype=np.int64)


def _array(rows: list[Any], width: int) -> Floats:
    return np.array(rows, dtype=float).reshape(-1, width)
