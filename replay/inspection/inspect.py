"""Inspection of a log, topic by topic, with a proposed robot file."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from dataclasses import replace as with_changed
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import to_builtins
from msgspec.structs import replace

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.config import convert
from icreckon.estimator.log.lag import Lag, NoLag
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault
from icreckon.estimator.log.series import ImuSeries
from icreckon.estimator.robot.robot_file import Robot, Vehicle
from icreckon.replay.bags.bag_files import over_bag
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.bags.message_types import JOINT_STATE
from icreckon.replay.bags.table_files import is_table
from icreckon.replay.base.errors import EqualStampsError, ReplayError, coarse_stamps
from icreckon.replay.inspection import imu_mounting, robot_file, topic_survey, wheels
from icreckon.replay.inspection import track_by_rate as by_rate
from icreckon.replay.inspection.fix_wander import FixWanderEstimate, estimate_wander
from icreckon.replay.inspection.guess_columns import guess_columns
from icreckon.replay.inspection.guess_topics import guess_topics, may_be_a_side
from icreckon.replay.inspection.gyro_bias import GyroBias, gyro_bias
from icreckon.replay.inspection.latency import objection, track_latency, truth_lag, without_lag
from icreckon.replay.mapping.columns import ColumnMap
from icreckon.replay.mapping.topics import MAPPING_TOPIC, TopicMap
from icreckon.replay.reading.clocks import Choice, choose_clocks
from icreckon.replay.reading.gather import as_paths, gather
from icreckon.replay.reading.tables import Table
from icreckon.replay.reading.to_log import assemble, evidence_of

UNUSED = ("latency", "gauge")
"""Keys of streams that a log is inspected without: it shows what they should be."""
FAST_TURNING = 6.0
"""Yaw rate that a ground robot hardly exceeds [rad/s]."""
FAST_SPEED, FAST_RATE = 20.0, 120.0
"""Speed and wheel rate that a ground robot hardly exceeds [m/s, rad/s]."""
MOST_STOPS = 8
"""Highest number of standstills that are listed."""
UNITS_OF_RADIUS = Robot(name="unknown", vehicle=Vehicle(1.0, 1.0, 1.0, max_track_speed=1e3))
"""Robot with a sprocket radius of 1 m, so that rates are read as speeds."""


@dataclass(frozen=True)
class Inspection:
    """Result of an inspection.

    Attributes:
        path: the log, or the first of its files.
        duration: from the first to the last message, by time of recording [s].
        topics: one report for each topic, by name; for tables one for each column.
        mapping: guessed topic of each stream.
        mounting: estimated mounting of the IMU, or None.
        findings: findings about clocks, standstills, gyro bias, suspicious units.
        dropped: samples that screening would drop, as in `Log`.
        notes: findings about the files, such as a broken index.
        proposed_robot_file: a robot file to start from, as TOML; values that no log contains are
            placeholders, marked in a comment.
        track: effective track of the whole log and over the yaw rate, None if nothing shows it.
    """

    path: Path
    duration: float
    topics: tuple[topic_survey.TopicReport, ...]
    mapping: TopicMap
    mounting: imu_mounting.Mounting | None
    findings: tuple[str, ...]
    dropped: dict[str, int]
    notes: tuple[str, ...]
    proposed_robot_file: str
    track: by_rate.TrackByRate | None = None


def inspect(
    path: Path | str | Sequence[Path | str],
    *,
    definitions: Definitions = (),
    sizes: robot_file.Sizes = robot_file.NO_SIZES,
) -> Inspection:
    """Inspect a log; a bag that was cut short is inspected up to the break.

    Args:
        path: the file or folder, or several that make one log, as for `read_log`.
        definitions: message types that bags lack, as for `read_log`.
        sizes: lengths and streams that a person filled in: the streams are read in place of guessed
            ones, the lengths give `eta0` of the proposed robot file.

    Raises:
        ReplayError: no such file, no bag or table, nothing of it is readable, or not the streams that
            a person filled in.
    """
    paths = as_paths(path)
    surveys, notes, tables = _look_through(paths, definitions)
    reports = {survey.channel.topic: survey.report() for survey in surveys.values()}
    mapping = guess_topics(surveys.values())
    if tables:
        time_column = str(sizes.log.get("columns", {}).get("time", ""))
        mapping = replace(mapping, columns=guess_columns(tables, time_column))
        if mapping.columns is None:
            notes.append("not all tables have a column that looks like a time: none is proposed")
    mapping = _with_own(mapping, sizes.log)
    log: Log | None = None
    clocks: dict[str, Choice] = {}
    try:
        gathered = gather(paths, mapping, own_mapping=False, definitions=definitions)
        clocks = choose_clocks(evidence_of(gathered.streams))
        log = assemble(gathered, UNITS_OF_RADIUS, paths[0].stem)
        if (changed := _other_units(mapping, log, notes)) is not mapping:
            mapping = changed
            gathered = gather(paths, mapping, own_mapping=False, definitions=definitions)
            log = assemble(gathered, UNITS_OF_RADIUS, paths[0].stem)
    except EqualStampsError:
        raise
    except ReplayError as problem:
        if sizes.log:
            raise ReplayError(f"the streams of the robot file: {problem}") from None
        if not tables or mapping.columns is not None:
            notes.append(f"the proposed topics cannot be read: {problem}")
    for purpose, repeated in (_repeated_shares(log) if log is not None else {}).items():
        entry = mapping.tracks if purpose == "tracks" else mapping.imu
        if entry is not None and entry.topic in reports:
            reports[entry.topic] = with_changed(reports[entry.topic], repeated_share=repeated)
    seen = _estimates(mapping, clocks, log, sizes)
    track = _track_by_rate(seen)
    times = [survey.recorded for survey in surveys.values() if survey.recorded]
    duration = (max(map(max, times)) - min(map(min, times))) * NANOSECOND if times else 0.0
    if log is not None and tables and (len(log.tracks.stamps) or log.imu is not None):
        duration = max(duration, log.duration)
    listed = [reports[name] for name in sorted(reports)]
    listed += [report for table in tables for report in _column_reports(table, mapping.columns)]
    return Inspection(
        path=paths[0],
        duration=duration,
        topics=tuple(listed),
        mapping=mapping,
        mounting=seen.mounting,
        findings=(
            *(() if mapping.track_keys else (_no_tracks(surveys.values()),)),
            *_findings(seen),
            *_of_rates(track),
            *_of_bias(seen.bias),
            *_of_wander(seen.wander),
        ),
        dropped=log.dropped if log is not None else {},
        notes=(*coarse_stamps(log.notes if log else ()), *notes),
        proposed_robot_file=robot_file.robot_file_text(paths[0], seen),
        track=track,
    )


def _estimates(
    mapping: TopicMap, clocks: dict[str, Choice], log: Log | None, sizes: robot_file.Sizes
) -> robot_file.LogEstimates:
    """Estimate mounting, wheels, latencies, gyro bias and wander from a log."""
    if log is None:
        return robot_file.LogEstimates(mapping, clocks, log, sizes)
    mounting, vertical = _mounted(log)
    latencies = _latencies(log, vertical)
    in_time = _in_time(log, latencies)
    if in_time is not log:
        mounting, vertical = _mounted(in_time)
    scaled = None if mapping.lacks_counts_per_turn else vertical
    correlation = mounting.turning_correlation if mounting else None
    return robot_file.LogEstimates(
        mapping,
        clocks,
        log,
        sizes,
        mounting,
        vertical,
        wheels.wheel_estimates(in_time, scaled, correlation),
        latencies,
        None if vertical is None else gyro_bias(in_time, vertical),
        estimate_wander(log, vertical) if log.fixes is not None else None,
    )


def _mounted(log: Log) -> tuple[imu_mounting.Mounting | None, Floats | None]:
    """Mounting of the IMU and its rate about the vertical (n,); None if unknown."""
    mounting = imu_mounting.estimate_mounting(log)
    vertical = imu_mounting.vertical_rate(log.imu, mounting) if log.imu and mounting else None
    return mounting, vertical


def _track_by_rate(seen: robot_file.LogEstimates) -> by_rate.TrackByRate | None:
    """Effective track by the gyro, of the whole log and over the yaw rate."""
    ratio, bias, log = seen.wheels.track_ratio, seen.bias, seen.log
    if ratio is None or seen.vertical is None or log is None:
        return None
    whole, unit = seen.effective_track, "m"
    if whole is None:
        unit = "the effective radius" if seen.mapping.in_rates else "the controller's gauge"
        whole, unit = ratio, f"times {unit}"
    is_clear = bias is not None and (bias.source == "standstill" or bias.differs(0.0))
    value = bias.value if bias is not None and is_clear else 0.0
    windows = by_rate.track_windows(_in_time(log, seen.latencies), seen.vertical, value)
    return by_rate.TrackByRate(
        whole, unit, tuple(by_rate.track_by_rate(windows * (1.0, whole / ratio)))
    )


def _with_own(guess: TopicMap, own: Mapping[str, Mapping[str, Any]]) -> TopicMap:
    """Merge the keys that a person filled in into a guessed mapping, except `UNUSED`.

    A guessed stream is dropped if a person uses its topic for another stream.
    """
    topics = {keys["topic"] for keys in own.values() if "topic" in keys}
    merged = {
        name: stream
        for name, stream in to_builtins(guess).items()
        if stream and stream.get("topic") not in topics - {own.get(name, {}).get("topic")}
    }
    for name, keys in own.items():
        table = merged
        for part in name.split("."):
            table[part] = table.get(part) or {}
            table = table[part]
        table |= {key: value for key, value in keys.items() if key not in UNUSED}
    return convert(merged, TopicMap, "[log]", ReplayError) if own else guess


def _other_units(mapping: TopicMap, log: Log, notes: list[str]) -> TopicMap:
    """Mapping with the IMU in deg/s or g where its readings are, with a note on each."""
    if log.imu is None:
        return mapping
    units, fast = {}, _fast_turning(log.imu)
    # Above the first limit rad/s are implausible, above the second deg/s are, too.
    if FAST_TURNING < fast < math.degrees(FAST_TURNING):
        units["rate_unit"] = "deg/s"
        notes.append(f"the gyro reads {fast:.3g} and more for 1 % of the time: taken for deg/s")
    mounting = imu_mounting.estimate_mounting(log)
    if mounting is not None and mounting.specific_force is not None:
        force = float(np.linalg.norm(mounting.specific_force))
        if wheels.unit_of_gravity(force) == "; in g?":
            units["acceleration_unit"] = "g"
            notes.append(f"the mean specific force is {force:.3g}: taken for g")
    return _with_own(mapping, {"imu" if mapping.imu else "columns.imu": units} if units else {})


def guess_mapping(
    path: Path | str | Sequence[Path | str], *, definitions: Definitions = ()
) -> TopicMap | None:
    """Guess the topics of bags; None for tables, and for bags with their own mapping.

    Raises:
        ReplayError: no such file, or nothing of it is readable.
    """
    surveys, _, tables = _look_through(as_paths(path), definitions)
    if tables or any(topic == MAPPING_TOPIC for topic, _ in surveys):
        return None
    return guess_topics(surveys.values())


def _latencies(log: Log, vertical: Floats | None) -> dict[str, Lag | NoLag]:
    """Latencies of streams against the gyro, by purpose."""
    if log.imu is None or vertical is None:
        return {}
    found: dict[str, Lag | NoLag] = {}
    if len(log.tracks.speeds) and np.abs(log.tracks.speeds).max() <= imu_mounting.ABSURD:
        found["tracks"] = track_latency(log.tracks, log.imu, vertical)
    truth = log.truth
    if truth is not None:
        if truth.headings and heading_fault(truth) is not None:
            truth = truth.positions_alone()
        found["truth"] = truth_lag(truth, log.tracks, log.imu, vertical)
    return found


def _in_time(log: Log, latencies: Mapping[str, Lag | NoLag]) -> Log:
    """Log whose track speeds and truth are as late as its gyro, where that is clear."""
    tracks, truth = (latencies.get(purpose) for purpose in ("tracks", "truth"))
    if isinstance(tracks, Lag) and not objection(tracks):
        log = with_changed(log, tracks=without_lag(log.tracks, tracks))
    if isinstance(truth, Lag) and not objection(truth) and log.truth is not None:
        poses = without_lag(log.truth.poses, truth)
        log = with_changed(log, truth=with_changed(log.truth, poses=poses))
    return log


def _look_through(
    paths: Sequence[Path], definitions: Definitions
) -> tuple[dict[tuple[str, str], topic_survey.Survey], list[str], list[Table]]:
    """Survey all files in one pass: topics by name and type, notes, tables."""
    surveys: dict[tuple[str, str], topic_survey.Survey] = {}
    notes: list[str] = []
    tables = []
    for path in paths:
        if path.is_file() and is_table(path):
            tables.append(Table(path))
            notes += [*tables[-1].notes, *tables[-1].stray_texts()]
            continue
        read = partial(topic_survey.survey_bag, source=str(path), definitions=definitions)
        found, remarks = over_bag(path, read)
        notes += remarks
        for survey in found:
            one = surveys.setdefault((survey.channel.topic, survey.channel.msgtype), survey)
            if one is not survey:
                one.extend(survey)
    return surveys, notes, tables


def _column_reports(table: Table, columns: ColumnMap | None) -> Iterator[topic_survey.TopicReport]:
    """Report each column; numbers with their spacing in time, if that is known."""
    stamps = timed = None
    if columns is not None and table.has([columns.time]):
        with suppress(ReplayError):
            stamps, timed = table.stamps(columns.time, columns.time_unit)
    for column in table.columns:
        spaced = topic_survey.Spacing()
        if columns is not None and stamps is not None:
            with suppress(ReplayError):
                there = timed
                if column.name != columns.time:
                    there = timed & ~np.isnan(table.numbers([column.name])[:, 0])
                spaced = topic_survey.spacing(stamps[there])
        yield topic_survey.TopicReport(
            topic=column.name,
            msgtype=column.kind,
            frame_id=table.path.name,
            count=column.filled,
            clock_offset=None,
            **spaced._asdict(),
        )


def _no_tracks(surveys: Collection[topic_survey.Survey]) -> str:
    """Finding that no track speeds are proposed, with all that could be some."""
    of_joints = [survey for survey in surveys if survey.channel.msgtype == JOINT_STATE]
    states = [state for survey in of_joints for state in survey.messages]
    joints = ", ".join(dict.fromkeys(name for one in states for name in one.name))
    numbers = ", ".join(survey.channel.topic for survey in surveys if may_be_a_side(survey))
    return (
        "no track speeds: nothing here looks like them, and without them nothing can be replayed; name "
        "joints, fields or columns in [log.tracks] or [log.columns.tracks] of the robot file, and "
        f"inspect again with --overwrite{joints and f'; joints here are {joints}'}"
        + (numbers and f"; topics with a number: {numbers} (one of each side: topic, right_topic)")
    )


def _findings(seen: robot_file.LogEstimates) -> Iterator[str]:
    log, mapping, mounting = seen.log, seen.mapping, seen.mounting
    for purpose, choice in seen.clocks.items():
        clock = "header stamps" if choice.clock == "header" else "time of recording"
        if not mapping.columns or getattr(mapping, purpose, None) is not None:
            yield f"{purpose}: {clock}; {choice.reason}"
    if log is None:
        return
    fault = None
    if log.truth is not None:
        fault = heading_fault(log.truth) if log.truth.headings else "are missing"
        if fault is not None:
            yield f"truth: headings {fault}: a replay scores positions alone"
    yield from (note for note in log.notes if "out of order" in note or "repeated in" in note)
    for purpose, latency in seen.latencies.items():
        if isinstance(latency, NoLag):
            yield (f"{purpose}: lag behind the gyro not observable: {latency.reason}")
            continue
        lags = "lag" if latency.seconds > 0.0 else "lead"
        places = purpose == "truth" and fault is not None
        against = "the tracks (by speed)" if places else "the gyro (by yaw rate)"
        why = objection(latency)
        yield (
            f"{purpose}: stamps {lags} {against} by {abs(latency.seconds):.2f} s (± {latency.sigma:.1g})"
            + (f"; {why}: no latency is proposed" if why else "")
        )
    if mapping.lacks_counts_per_turn:
        yield (
            "tracks: counters; fill in counts_per_turn, and inspect again with --overwrite for the "
            "effective track and radius"
        )
    if seen.wheels.track_ratio is not None:
        yield _of_track(seen)
    if mounting is not None and (mounting.turning_correlation or 0.0) < -robot_file.CLEAR_SIGN:
        yield (
            "tracks: they turn the other way than the gyro (correlation "
            f"{mounting.turning_correlation:.2f}): left and right may be swapped, or the IMU is "
            "upside down"
        )
    if len(log.tracks.stamps):
        stops = wheels.standstills(log)
        total = sum(end - begin for begin, end in stops)
        spans = ", ".join(f"{begin:.0f} to {end:.0f} s" for begin, end in stops[:MOST_STOPS])
        more = ", ..." if len(stops) > MOST_STOPS else ""
        yield (
            f"standstills: {len(stops)}, {total:.0f} s in all ({spans}{more})"
            if stops
            else "standstills: none of a second or more"
        )
    if mounting is not None and mounting.gyro_bias is not None:
        bias = ", ".join(f"{value:.5f}" for value in mounting.gyro_bias)
        yield f"gyro bias at standstill: ({bias}) rad/s in the IMU's axes"
    yield from (f"suspicious: {text}" for text in unit_suspicions(seen, log))


def unit_suspicions(seen: robot_file.LogEstimates, log: Log) -> Iterator[str]:
    """Report values of a log that seem to be in another unit."""
    rates, estimates = seen.mapping.in_rates, seen.wheels
    if seen.mounting is not None and seen.mounting.specific_force is not None:
        force = float(np.linalg.norm(seen.mounting.specific_force))
        if abs(force - wheels.GRAVITY) > wheels.WRONG_GRAVITY * wheels.GRAVITY:
            guess = wheels.unit_of_gravity(force)
            yield f"mean specific force is {force:.3g}, not {wheels.GRAVITY} m/s²{guess}"
    if log.imu is not None:
        fast = _fast_turning(log.imu)
        if fast > FAST_TURNING:
            yield f"the gyro reads {fast:.3g} and more for 1 % of the time; rad/s, or rather deg/s?"
        if seen.from_twist and seen.vertical is not None and len(log.tracks.stamps) > 1:
            yield from wheels.turning_suspicion(log, seen.vertical)
    if len(log.tracks.speeds):
        fast = float(np.percentile(np.abs(log.tracks.speeds), 99))
        if rates and fast > FAST_RATE and not seen.mapping.lacks_counts_per_turn:
            yield f"joint rates of {fast:.3g}; rad/s, or rather rpm, deg/s or counts?"
        if not rates and fast > FAST_SPEED:
            yield f"track speeds of {fast:.3g}; m/s, or rather mm/s?"
    if not rates and estimates.way_ratio is not None and not 0.5 < estimates.way_ratio < 2.0:
        yield (
            f"the distance over ground is {estimates.way_ratio:.3g} times that of the track speeds, "
            f"by the {estimates.way_source}"
        )


def _fast_turning(imu: ImuSeries) -> float:
    """Rate that the gyro exceeds for 1 % of the time [rad/s]."""
    return float(np.percentile(np.abs(imu.angular_velocity), 99))


def _of_track(seen: robot_file.LogEstimates) -> str:
    """Report the effective track by the gyro, as settings of a controller have it."""
    ratio, sigma = seen.wheels.track_ratio, seen.wheels.track_sigma
    error = "" if sigma is None else f" (± {sigma:.1g})"
    if seen.from_twist:
        return (
            f"tracks: the odometry turns {ratio:.2f}{error} times as far as the gyro: multiply the "
            f"wheel_separation_multiplier of its controller by {ratio:.2f}"
        )
    unit = "times the effective radius" if seen.mapping.in_rates else "m"
    return (
        f"tracks: the effective track is {ratio:.3g}{error} {unit}, by the gyro; divided by the wheel "
        "separation it is a controller's wheel_separation_multiplier"
    )


def _of_rates(track: by_rate.TrackByRate | None) -> Iterator[str]:
    """Report whether the effective track depends on the yaw rate."""
    rates = sorted(abs(one.rate) for one in track.bins) if track is not None else []
    if track is None or len(rates) < 2 or rates[-1] < 1.5 * rates[0]:
        return
    text = f"tracks: from {rates[0]:.1f} to {rates[-1]:.1f} rad/s the effective track"
    if (found := by_rate.extremes(track.bins)) is None:
        yield f"{text} does not depend significantly on the yaw rate"
        return
    low, high = (
        f"{one.track:.3g} (± {one.sigma:.1g}) {track.unit} at {abs(one.rate):.2f} rad/s to the "
        f"{'left' if one.rate > 0.0 else 'right'}"
        for one in found
    )
    yield f"{text} depends on the yaw rate: {low}, {high}; --picture FILE draws it"


def _of_bias(bias: GyroBias | None) -> Iterator[str]:
    if bias is not None and bias.source != "standstill":
        found = f"{bias.value:.4f} ± {bias.sigma:.4f} rad/s about the vertical while driving"
        which = "" if bias.differs(0.0) else ": not significant, not written"
        yield f"gyro bias: {found}, by the {bias.source}{which}"


def _of_wander(wander: FixWanderEstimate | str | None) -> Iterator[str]:
    if isinstance(wander, FixWanderEstimate):
        yield f"fixes: {wander.text}"
    elif wander is not None:
        yield f"fixes: whether their error wanders cannot be seen: {wander}"


def _repeated_shares(log: Log) -> dict[str, float]:
    """Shares of repeated values of moving tracks and of repeated IMU samples."""
    speeds, shares = log.tracks.speeds, {}
    if (moving := (speeds[:-1] != 0.0).any(axis=1)).any():
        shares["tracks"] = float((speeds[1:] == speeds[:-1])[moving].mean())
    if log.imu is not None and len(log.imu.stamps) > 1:
        forces = log.imu.linear_acceleration
        rows = np.column_stack([log.imu.angular_velocity, *([] if forces is None else [forces])])
        shares["imu"] = float((rows[1:] == rows[:-1]).all(axis=1).mean())
    return shares
