"""Estimates from an unmapped log: clocks, units, values of robot and sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import to_builtins

from icreckon.estimator.base.array_types import NANOSECOND, true_runs
from icreckon.estimator.base.config import convert
from icreckon.estimator.log.failed_sensors import StuckSide, rates_at, stuck_sides, working_imu
from icreckon.estimator.log.lag import Lag, NoLag
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, Vehicle
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.bags.table_files import is_table
from icreckon.replay.base.errors import ApartError, EqualStampsError, ReplayError
from icreckon.replay.estimates import fix_wander, imu_mounting, latency
from icreckon.replay.estimates.gyro_bias import GyroBias, gyro_bias
from icreckon.replay.estimates.imu_mounting import YawRates
from icreckon.replay.estimates.track_by_rate import TrackByRate, track_by_rate, track_windows
from icreckon.replay.estimates.wheels import (
    NO_WHEELS,
    WheelEstimates,
    standstills,
    units_and_sides,
    wheel_estimates,
)
from icreckon.replay.inspection.static_frames import Mount, with_static_yaw
from icreckon.replay.mapping.topics import TopicMap
from icreckon.replay.reading.clocks import Choice, choose_clocks
from icreckon.replay.reading.gather import Gathered, gather
from icreckon.replay.reading.to_log import assemble, evidence_of

UNUSED = ("latency", "gauge")  # keys that an inspection ignores and estimates
FASTEST = 1e3  # highest track speed that is read, in m/s or rad/s


class Sizes(NamedTuple):
    """Lengths [m] and streams of a robot that a person filled in; None if not."""

    gauge: float | None = None  # track gauge
    radius: float | None = None  # sprocket radius
    controller_gauge: float | None = None  # gauge of the controller of twists [m]
    log: Mapping[str, Mapping[str, Any]] = {}  # keys of its [log] tables, by table


NO_SIZES = Sizes()


@dataclass(frozen=True)
class LogEstimates:
    """Estimates from a log, for findings and a robot file; None if not observable."""

    mapping: TopicMap  # the guessed topics
    clocks: Mapping[str, Choice]  # clock of each stream and the reason of its choice, by purpose
    log: Log | None  # log read with a sprocket radius of 1 m; None if it cannot be read
    sizes: Sizes  # lengths of the robot that a person filled in
    mounting: imu_mounting.Mounting | None = None  # estimated mounting of the IMU
    yaw_rates: YawRates | None = None  # rates about the vertical
    wheels: WheelEstimates = NO_WHEELS  # estimated effective radius and track
    # latencies of tracks and truth against the gyro, by purpose
    latencies: Mapping[str, Lag | NoLag] = field(default_factory=dict)
    are_apart: bool = False  # True if tracks and gyro both turn, but not together
    bias: GyroBias | None = None  # bias of the gyro
    wander: fix_wander.FixWanderEstimate | str | None = (
        None  # error of the fixes, or why it is not known
    )
    imu_mount: Mount | None = None  # static transform of the IMU
    fix_fit: fix_wander.FixFit | None = None  # place of the antenna, lag and scale by the fixes
    stuck: Sequence[StuckSide] = ()  # sides that repeat one reading; not part of the wheels
    track: TrackByRate | None = None  # effective track of the whole log and over the yaw rate

    @property
    def states_fix_sigma(self) -> bool:
        """True if the fixes state their variances."""
        fixes = self.mapping.keys_of("fixes")
        return fixes is not None and fixes.position_sigma is None

    @property
    def radius(self) -> float | None:
        """Sprocket radius by a person, or else by the log [m]; for tracks in rates."""
        return self.sizes.radius or (self.wheels.distance and self.wheels.distance.value)

    @property
    def effective_track(self) -> float | None:
        """Effective track by the gyro [m]; None without radius or gauge of a controller."""
        # True length of the gauge or radius that was read as 1 m.
        unit: float | None = 1.0
        if self.mapping.from_twist:
            unit = self.sizes.controller_gauge
        elif self.mapping.in_rates:
            unit = self.radius
        if self.wheels.track is None or unit is None:
            return None
        return self.wheels.track.value * unit


def log_estimates(
    paths: Sequence[Path],
    mapping: TopicMap,
    definitions: Definitions,
    sizes: Sizes,
    imu_mount: Mount | None,
    notes: list[str],
) -> LogEstimates:
    """Estimate clocks, units, and values of robot and sensors from a log.

    Adds a note on each unusual unit, or on a log that cannot be read.

    Raises:
        ReplayError: the streams that a person filled in cannot be read.
    """
    reading = _Reading(paths, definitions, mapping)
    try:
        log = reading.read(sizes.log, notes)
    except EqualStampsError:
        raise
    except ReplayError as problem:
        if sizes.log:
            raise ReplayError(f"the streams of the robot file: {problem}") from None
        has_tables = any(is_table(file) for file in paths if file.is_file())
        if mapping.columns is not None or not has_tables:
            notes.append(f"the proposed topics cannot be read: {problem}")
        return LogEstimates(reading.mapping, reading.clocks, None, sizes, imu_mount=imu_mount)
    estimates = LogEstimates(reading.mapping, reading.clocks, log, sizes, imu_mount=imu_mount)
    return _measured(estimates, log)


@dataclass
class _Reading:
    """Reading of a log by a guessed mapping, which it completes by clocks and units."""

    paths: Sequence[Path]
    definitions: Definitions
    mapping: TopicMap
    clocks: Mapping[str, Choice] = field(default_factory=dict)

    def read(self, filled_in: Mapping[str, Mapping[str, Any]], notes: list[str]) -> Log:
        """Choose clocks and units, and read the log by them; notes get unusual units.

        Raises:
            ReplayError: it cannot be read; the attributes have what was found before.
        """
        gathered = self._gathered(self.mapping)
        self.clocks = choose_clocks(evidence_of(gathered.streams))
        try:
            log = self._assembled(gathered)
        except ApartError:
            self.mapping = latency.on_one_clock(self.mapping, self._log_of)
            log = self._log_of(self.mapping)
        read_tracks = partial(self._log_of, self.mapping, "tracks")
        keys = units_and_sides(self.mapping, log, filled_in, notes, read_tracks)
        in_units = with_keys(self.mapping, keys)
        # Several tables may have several clocks, and one whose tracks or IMU have times of their own.
        columns = self.mapping.columns
        if columns and (
            len(self.paths) > 1 or any(k and k.time for k in (columns.tracks, columns.imu))
        ):
            in_units = latency.on_one_clock(in_units, self._log_of)
        if in_units is self.mapping:
            return log
        self.mapping = in_units
        return self._log_of(in_units)

    def _log_of(self, mapping: TopicMap, purpose: str = "", fastest: float = FASTEST) -> Log:
        """Log of a mapping, or one of its streams alone; by a highest track speed [m/s]."""
        gathered = self._gathered(mapping)
        if purpose:
            gathered.streams = {k: one for k, one in gathered.streams.items() if k == purpose}
        return self._assembled(gathered, fastest)

    def _gathered(self, mapping: TopicMap) -> Gathered:
        return gather(self.paths, mapping, own_mapping=False, definitions=self.definitions)

    def _assembled(self, gathered: Gathered, fastest: float = FASTEST) -> Log:
        # With a radius of 1 m rates are read as speeds.
        vehicle = Vehicle(1.0, 1.0, 1.0, max_track_speed=fastest)
        return assemble(gathered, Robot(name="unknown", vehicle=vehicle), self.paths[0].stem)


def _measured(estimates: LogEstimates, log: Log) -> LogEstimates:
    """Add estimates of the robot and its sensors by a log that could be read."""
    log, _ = working_imu(log)
    mounting, yaw_rates = _mounting_and_yaw_rates(log, estimates.imu_mount)
    latencies = _latencies(log, yaw_rates)
    aligned = _without_latencies(log, latencies)
    if aligned is not log:
        mounting, yaw_rates = _mounting_and_yaw_rates(aligned, estimates.imu_mount)
    is_apart = yaw_rates is not None and imu_mounting.turn_apart(log.tracks, yaw_rates)
    wander = fit = None
    if log.fixes is not None and not is_apart:
        fit = fix_wander.fit_fixes(aligned, yaw_rates)
        if fit is not None and fit.is_late:
            stamps = log.fixes.stamps - round(fit.lag / NANOSECOND)
            aligned = replace(aligned, fixes=replace(log.fixes, stamps=stamps))
        wander = fix_wander.estimate_wander(
            aligned, yaw_rates, states_sigma=estimates.states_fix_sigma
        )
    # Counts have no scale yet, by which wheels could be estimated.
    shows_wheels = not (estimates.mapping.lacks_counts_per_turn or is_apart)
    correlation = mounting.turning_correlation if mounting else None
    wheels, turning = NO_WHEELS, None
    if shows_wheels and yaw_rates is not None:
        wheels = wheel_estimates(aligned, yaw_rates, correlation)
        if wheels.track is not None:
            turning = wheels.track.value * rates_at(aligned.tracks, *yaw_rates)
    stuck = stuck_sides(aligned.tracks, turning)
    sound = longest_without(aligned, stuck)
    if sound is not aligned and shows_wheels and yaw_rates is not None:
        wheels = wheel_estimates(sound, yaw_rates, correlation)
    measured = replace(
        estimates,
        mounting=mounting,
        yaw_rates=yaw_rates,
        wheels=wheels,
        stuck=stuck,
        latencies=latencies,
        are_apart=is_apart,
        bias=None if yaw_rates is None or is_apart else gyro_bias(aligned, yaw_rates),
        wander=wander,
        fix_fit=fit,
    )
    return replace(measured, track=_track_by_rate(measured, sound.tracks))


def longest_without(log: Log, stuck: Sequence[StuckSide]) -> Log:
    """Longest part without a stuck side, and without rest while gyros turn."""
    is_sound = np.ones(len(log.tracks.stamps), dtype=bool)
    at_rest = [
        np.searchsorted(log.tracks.stamps, stop) for *stop, turns in standstills(log) if turns
    ]
    for rows in (
        *(slice(*stop) for stop in at_rest),
        *(rows for side in stuck for rows in side.spans),
    ):
        is_sound[rows] = False
    runs = log.tracks.stamps[true_runs(is_sound)]
    if is_sound.all() or not len(runs):
        return log
    return log.between(*max(runs.tolist(), key=lambda run: run[1] - run[0]))


def _mounting_and_yaw_rates(
    log: Log, mount: Mount | None
) -> tuple[imu_mounting.Mounting | None, YawRates | None]:
    """Mounting of the IMU and rates about the vertical; None if unknown."""
    mounting = imu_mounting.estimate_mounting(log)
    if log.imu is None or mounting is None:
        return None, None
    if mount is not None:
        mounting = with_static_yaw(mounting, mount, log) or mounting
    return mounting, imu_mounting.vertical_rate(log.imu, mounting)


def _track_by_rate(estimates: LogEstimates, tracks: TrackSpeedSeries) -> TrackByRate | None:
    """Effective track by the gyro, of the whole log and over the yaw rate."""
    track, bias, yaw_rates = estimates.wheels.track, estimates.bias, estimates.yaw_rates
    if track is None or yaw_rates is None:
        return None
    whole, unit = estimates.effective_track, "m"
    if whole is None:
        whole, unit = track.value, "times the controller's gauge"
        if estimates.mapping.in_rates:
            unit = "times the effective radius"
    clear_bias = bias.value if bias is not None and bias.is_clear else 0.0
    windows = track_windows(tracks, yaw_rates, clear_bias)
    # The log's tracks are read with a radius or gauge of 1 m: V_r - V_l gets the unit of `whole`.
    return TrackByRate(whole, unit, tuple(track_by_rate(windows * (1.0, whole / track.value))))


def with_keys(guess: TopicMap, filled_in: Mapping[str, Mapping[str, Any]]) -> TopicMap:
    """Merge keys of [log] tables, by table, into a guessed mapping, except `UNUSED`.

    A guessed stream is dropped if they use its topic for another stream.
    """
    if not filled_in:
        return guess
    topics = {keys["topic"] for keys in filled_in.values() if "topic" in keys}
    merged = {}
    for name, stream in to_builtins(guess).items():
        own_topic = filled_in.get(name, {}).get("topic")
        if stream and stream.get("topic") not in topics - {own_topic}:
            merged[name] = stream
    for name, keys in filled_in.items():
        table = merged
        for part in name.split("."):
            table[part] = table.get(part) or {}
            table = table[part]
        table |= {key: value for key, value in keys.items() if key not in UNUSED}
    return convert(merged, TopicMap, "[log]", ReplayError)


def _latencies(log: Log, yaw_rates: YawRates | None) -> dict[str, Lag | NoLag]:
    """Latencies of tracks, headings and truth against the gyro; {} without a gyro."""
    if log.imu is None or yaw_rates is None:
        return {}
    latencies: dict[str, Lag | NoLag] = {}
    if len(log.tracks.speeds) and np.abs(log.tracks.speeds).max() <= imu_mounting.ABSURD:
        latencies["tracks"] = latency.track_latency(log.tracks, yaw_rates)
    headings = [other for other in log.others if isinstance(other, HeadingFix)]
    if headings:
        latencies["heading"] = latency.heading_lag(headings, yaw_rates)
    if log.truth is not None:
        latencies["truth"] = latency.truth_lag(log.truth, log.tracks, log.imu, yaw_rates)
    return latencies


def _without_latencies(log: Log, latencies: Mapping[str, Lag | NoLag]) -> Log:
    """Log with stamps of track speeds and truth corrected where the latency is clear."""
    tracks = latencies.get("tracks")
    if isinstance(tracks, Lag) and not latency.objection(tracks):
        log = replace(log, tracks=latency.without_lag(log.tracks, tracks))
    return latency.with_truth_in_time(log, latencies.get("truth"))
