"""Inspection of a log, topic by topic, with a proposed robot file."""

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
from icreckon.estimator.log.failed_sensors import imu_span, stuck_sides, unequal_sides
from icreckon.estimator.log.lag import Lag, NoLag
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.measurements import HeadingFix
from icreckon.estimator.log.path_heading import heading_fault
from icreckon.estimator.robot.robot_file import Robot, Vehicle
from icreckon.replay.bags.bag_files import over_bag
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.bags.message_types import JOINT_STATE
from icreckon.replay.bags.table_files import is_table
from icreckon.replay.base.errors import (
    ApartError,
    EqualStampsError,
    NoRowsError,
    ReplayError,
    coarse_stamps,
)
from icreckon.replay.inspection import imu_mounting, robot_file, static_frames, topic_survey, wheels
from icreckon.replay.inspection import track_by_rate as by_rate
from icreckon.replay.inspection.fix_wander import FixWanderEstimate, estimate_wander, fit_fixes
from icreckon.replay.inspection.guess_columns import guess_columns, time_column_of
from icreckon.replay.inspection.guess_topics import (
    guess_topics,
    is_special,
    may_be_a_side,
    unused_topics,
)
from icreckon.replay.inspection.gyro_bias import LEAST_BY_TRACKS, SURE, gyro_bias
from icreckon.replay.inspection.imu_mounting import turn_apart
from icreckon.replay.inspection.latency import (
    heading_lag,
    objection,
    on_one_clock,
    track_latency,
    truth_lag,
    without_lag,
)
from icreckon.replay.mapping.columns import ColumnMap
from icreckon.replay.mapping.topics import MAPPING_TOPIC, TopicMap
from icreckon.replay.reading.clocks import Choice, choose_clocks
from icreckon.replay.reading.gather import as_paths, first_path, gather
from icreckon.replay.reading.tables import Table
from icreckon.replay.reading.to_log import assemble, evidence_of

UNUSED = ("latency", "gauge")  # keys that an inspection ignores and estimates
FAST_SPEED, FAST_RATE = 20.0, 120.0
"""Speed and wheel rate that a ground robot hardly exceeds [m/s, rad/s]."""
OF_THE_FILE = ("out of order", "repeated in", "go back")  # words of notes on what a file holds
MOST_STOPS = 8  # highest number of standstills that are listed
FASTEST = 1e3  # highest track speed that is read, in m/s or rad/s


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
    paths, first = as_paths(path), first_path(path)
    surveys, notes, tables = _survey_files(paths, definitions)
    mapping = guess_topics(surveys.values(), sizes.log.get("fixes", {}).get("topic"))
    if tables:
        time_column = str(sizes.log.get("columns", {}).get("time", ""))
        mapping = replace(mapping, columns=guess_columns(tables, time_column))
        timeless = [table.path.name for table in tables if not time_column_of(table, time_column)]
        if timeless:
            notes.append(f"no column looks like a time, not used: {', '.join(timeless)}")
    mounts = static_frames.static_mounts(surveys.values())
    if mapping.fixes is not None and mapping.fixes.topic in mounts:
        place = tuple(mounts[mapping.fixes.topic].position.tolist())
        mapping = replace(mapping, fixes=replace(mapping.fixes, position=place))
    mapping = _with_keys(mapping, sizes.log)
    imu_topic = mapping.imu.topic if mapping.imu else ""
    findings = static_frames.unplaced(surveys.values(), mounts, imu_topic)
    mount = mounts.get(imu_topic)
    estimates = _estimates(paths, mapping, definitions, sizes, mount, notes)
    mapping, log, track = estimates.mapping, estimates.log, _track_by_rate(estimates)
    reports = _topic_reports(surveys.values(), mapping, log)
    for table in tables:
        reports += _column_reports(table, mapping.columns)
    findings += [] if mapping.track_keys else [_missing_tracks(surveys.values())]
    findings += unused_topics(surveys.values(), mapping)
    errors = _error_findings(estimates)
    return Inspection(
        path=first,
        duration=_duration(surveys.values(), log if tables else None),
        topics=tuple(reports),
        mapping=mapping,
        mounting=estimates.mounting,
        findings=(*findings, *_findings(estimates), *_rate_finding(track), *errors),
        dropped=log.dropped if log is not None else {},
        notes=(*coarse_stamps(log.notes if log else ()), *notes),
        proposed_robot_file=robot_file.robot_file_text(first, estimates),
        track=track,
    )


def _duration(surveys: Collection[topic_survey.Survey], log: Log | None) -> float:
    """Time from the first to the last message, or in a log of tables if longer [s]."""
    recorded = [survey.recorded for survey in surveys if survey.recorded]
    duration = (max(map(max, recorded)) - min(map(min, recorded))) * NANOSECOND if recorded else 0.0
    if log is not None and (len(log.tracks.stamps) or log.imu is not None):
        duration = max(duration, log.duration)
    return duration


def _topic_reports(
    surveys: Collection[topic_survey.Survey], mapping: TopicMap, log: Log | None
) -> list[topic_survey.TopicReport]:
    """Reports of the topics by name, with shares of repeated samples."""
    # Of tracks only samples while they move count.
    repeated: dict[str, float] = {}
    if log is not None and mapping.tracks is not None:
        speeds = log.tracks.speeds
        is_moving = (speeds[:-1] != 0.0).any(axis=1)
        if is_moving.any():
            repeated[mapping.tracks.topic] = float((speeds[1:] == speeds[:-1])[is_moving].mean())
    if log is not None and mapping.imu is not None and log.imu is not None:
        forces = log.imu.linear_acceleration
        rows = np.column_stack([log.imu.angular_velocity, *([] if forces is None else [forces])])
        if len(rows) > 1:
            repeated[mapping.imu.topic] = float((rows[1:] == rows[:-1]).all(axis=1).mean())
    topics = {survey.channel.topic: survey for survey in surveys}
    return [topics[topic].report(repeated.get(topic)) for topic in sorted(topics)]


def _estimates(
    paths: Sequence[Path],
    mapping: TopicMap,
    definitions: Definitions,
    sizes: robot_file.Sizes,
    imu_mount: static_frames.Mount | None,
    notes: list[str],
) -> robot_file.LogEstimates:
    """Estimate mounting, wheels, latencies, gyro bias and wander from a log."""
    # Adds a note on each unusual unit, or on a log that cannot be read.
    log: Log | None = None
    clocks: dict[str, Choice] = {}
    read = partial(gather, paths, own_mapping=False, definitions=definitions)

    def assembled(mapping: TopicMap, purpose: str = "", fastest: float = FASTEST) -> Log:
        """Log of a mapping, or one of its streams alone; by a highest track speed [m/s]."""
        gathered = read(mapping)
        if purpose:
            gathered.streams = {k: one for k, one in gathered.streams.items() if k == purpose}
        return assemble(gathered, _robot_of_radius_1(fastest), paths[0].stem)

    try:
        gathered = read(mapping)
        clocks = choose_clocks(evidence_of(gathered.streams))
        try:
            log = assemble(gathered, _robot_of_radius_1(), paths[0].stem)
        except ApartError:
            mapping = on_one_clock(mapping, assembled)
            log = assembled(mapping)
        keys = wheels.units_and_sides(
            mapping, log, sizes.log, notes, partial(assembled, mapping, "tracks")
        )
        in_units = _with_keys(mapping, keys) if keys else mapping
        # Several tables may have several clocks, and one whose tracks or IMU have times of their own.
        columns = mapping.columns
        if columns and (len(paths) > 1 or any(k and k.time for k in (columns.tracks, columns.imu))):
            in_units = on_one_clock(in_units, assembled)
        if in_units is not mapping:
            mapping = in_units
            log = assembled(mapping)
    except EqualStampsError:
        raise
    except ReplayError as problem:
        if sizes.log:
            raise ReplayError(f"the streams of the robot file: {problem}") from None
        has_tables = any(is_table(file) for file in paths if file.is_file())
        if mapping.columns is not None or not has_tables:
            notes.append(f"the proposed topics cannot be read: {problem}")
    estimates = robot_file.LogEstimates(mapping, clocks, log, sizes, imu_mount=imu_mount)
    if log is None:
        return estimates
    mounting, vertical = _mounting_and_vertical(log, imu_mount)
    latencies = _latencies(log, vertical)
    aligned = _without_latencies(log, latencies)
    if aligned is not log:
        mounting, vertical = _mounting_and_vertical(aligned, imu_mount)
    # Counts have no scale yet, by which wheels could be estimated.
    is_apart = bool(log.imu and vertical is not None and turn_apart(log.tracks, log.imu, vertical))
    wheel_rate = None if mapping.lacks_counts_per_turn or is_apart else vertical
    correlation = mounting.turning_correlation if mounting else None
    wander = fit = None
    if log.fixes is not None and not is_apart:
        fit = fit_fixes(aligned, vertical)
        in_time = log.fixes
        if fit is not None and fit.is_late:
            in_time = with_changed(in_time, stamps=in_time.stamps - round(fit.lag / NANOSECOND))
        aligned = with_changed(aligned, fixes=in_time)
        wander = estimate_wander(aligned, vertical, states_sigma=estimates.states_fix_sigma)
    return with_changed(
        estimates,
        mounting=mounting,
        vertical=vertical,
        wheels=wheels.wheel_estimates(aligned, wheel_rate, correlation),
        latencies=latencies,
        are_apart=is_apart,
        bias=None if vertical is None or is_apart else gyro_bias(aligned, vertical),
        wander=wander,
        fix_fit=fit,
    )


def _robot_of_radius_1(fastest: float = FASTEST) -> Robot:
    """Robot with a sprocket radius of 1 m, so that rates are read as speeds."""
    return Robot(name="unknown", vehicle=Vehicle(1.0, 1.0, 1.0, max_track_speed=fastest))


def _mounting_and_vertical(
    log: Log, mount: static_frames.Mount | None
) -> tuple[imu_mounting.Mounting | None, Floats | None]:
    """Mounting of the IMU and rate about the vertical (n,) [rad/s]; None if unknown."""
    mounting = imu_mounting.estimate_mounting(log)
    if mounting is not None and mount is not None:
        mounting = static_frames.with_static_yaw(mounting, mount, log) or mounting
    vertical = imu_mounting.vertical_rate(log.imu, mounting) if log.imu and mounting else None
    return mounting, vertical


def _track_by_rate(estimates: robot_file.LogEstimates) -> by_rate.TrackByRate | None:
    """Effective track by the gyro, of the whole log and over the yaw rate."""
    ratio, bias, log = estimates.wheels.track_ratio, estimates.bias, estimates.log
    if ratio is None or estimates.vertical is None or log is None:
        return None
    whole, unit = estimates.effective_track, "m"
    if whole is None:
        whole, unit = ratio, "times the controller's gauge"
        if estimates.mapping.in_rates:
            unit = "times the effective radius"
    is_clear = bias is not None and (bias.source == "standstill" or bias.differs(0.0))
    clear_bias = bias.value if bias is not None and is_clear else 0.0
    aligned = _without_latencies(log, estimates.latencies)
    windows = by_rate.track_windows(aligned, estimates.vertical, clear_bias)
    # The log's tracks are read with a radius or gauge of 1 m: V_r - V_l gets the unit of `whole`.
    bins = by_rate.track_by_rate(windows * (1.0, whole / ratio))
    return by_rate.TrackByRate(whole, unit, tuple(bins))


def _with_keys(guess: TopicMap, filled_in: Mapping[str, Mapping[str, Any]]) -> TopicMap:
    """Merge keys of [log] tables, by table, into a guessed mapping, except `UNUSED`."""
    # A guessed stream is dropped if they use its topic for another stream.
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


def guess_mapping(
    path: Path | str | Sequence[Path | str], *, definitions: Definitions = ()
) -> TopicMap | None:
    """Guess the topics of bags; None for tables, and for bags with their own mapping.

    Raises:
        ReplayError: no such file, or nothing of it is readable.
    """
    surveys, _, tables = _survey_files(as_paths(path), definitions)
    if tables or any(topic == MAPPING_TOPIC for topic, _ in surveys):
        return None
    return guess_topics(surveys.values())


def _latencies(log: Log, vertical: Floats | None) -> dict[str, Lag | NoLag]:
    """Latencies of tracks and truth against the gyro, by purpose; {} without a gyro."""
    if log.imu is None or vertical is None:
        return {}
    found: dict[str, Lag | NoLag] = {}
    if len(log.tracks.speeds) and np.abs(log.tracks.speeds).max() <= imu_mounting.ABSURD:
        found["tracks"] = track_latency(log.tracks, log.imu, vertical)
    headings = [other for other in log.others if isinstance(other, HeadingFix)]
    if headings:
        found["heading"] = heading_lag(headings, log.imu, vertical)
    truth = log.truth
    if truth is not None:
        if truth.headings and heading_fault(truth) is not None:
            truth = truth.positions_alone()  # the headings do not fit the path
        found["truth"] = truth_lag(truth, log.tracks, log.imu, vertical)
    return found


def _without_latencies(log: Log, latencies: Mapping[str, Lag | NoLag]) -> Log:
    """Log with stamps of track speeds and truth corrected where the latency is clear."""
    tracks, truth = (latencies.get(purpose) for purpose in ("tracks", "truth"))
    if isinstance(tracks, Lag) and not objection(tracks):
        log = with_changed(log, tracks=without_lag(log.tracks, tracks))
    if isinstance(truth, Lag) and not objection(truth) and log.truth is not None:
        poses = without_lag(log.truth.poses, truth)
        log = with_changed(log, truth=with_changed(log.truth, poses=poses))
    return log


def _survey_files(
    paths: Sequence[Path], definitions: Definitions
) -> tuple[dict[tuple[str, str], topic_survey.Survey], list[str], list[Table]]:
    """Survey all files in one pass: topics by name and type, notes, tables."""
    # A topic with messages in several bags has one survey.
    surveys: dict[tuple[str, str], topic_survey.Survey] = {}
    notes: list[str] = []
    tables = []
    for path in paths:
        if path.is_file() and is_table(path):
            try:
                table = Table(path)
            except NoRowsError as problem:
                if len(paths) == 1:
                    raise
                notes.append(f"{problem}: not used")
                continue
            tables.append(table)
            notes += [*table.notes, *table.stray_texts()]
            continue
        survey_bag = partial(topic_survey.survey_bag, source=str(path), definitions=definitions)
        bag_surveys, bag_notes = over_bag(path, survey_bag)
        notes += bag_notes
        for new in bag_surveys:
            known = surveys.setdefault((new.channel.topic, new.channel.msgtype), new)
            if known is not new:
                known.extend(new)
    return surveys, notes, tables


def _column_reports(table: Table, columns: ColumnMap | None) -> Iterator[topic_survey.TopicReport]:
    """Report each column; times and numbers with their spacing in time, if known."""
    spacings: dict[str, dict[str, Any]] = {}
    numeric = [column.name for column in table.columns if column.is_number]
    if columns is not None and table.present([columns.time]):
        with suppress(ReplayError):  # no spacing is known if the times cannot be read
            stamps, has_time = table.stamps(columns.time, columns.time_unit)
            for name in numeric:
                has_number = ~np.isnan(table.numbers([name])[:, 0])
                spacings[name] = topic_survey.spacing(stamps[has_time & has_number])
            spacings[columns.time] = topic_survey.spacing(stamps[has_time])
    for column in table.columns:
        spacing = spacings.get(column.name, {})
        name, kind, file = column.name, column.kind, table.path.name
        yield topic_survey.TopicReport(name, kind, file, column.filled, **spacing)


def _missing_tracks(surveys: Collection[topic_survey.Survey]) -> str:
    """Finding that there are no track speeds, with candidates for a person."""
    joints: dict[str, None] = {}  # in the order of the messages
    for survey in surveys:
        if survey.channel.msgtype == JOINT_STATE:
            joints |= dict.fromkeys(name for state in survey.messages for name in state.name)
    numbers = ", ".join(survey.channel.topic for survey in surveys if may_be_a_side(survey))
    text = (
        "no track speeds: nothing here looks like them, and without them nothing can be replayed; name "
        "joints, fields or columns in [log.tracks] or [log.columns.tracks] of the robot file, and "
        "inspect again with --overwrite"
    )
    undefined = ", ".join(
        f"{survey.channel.topic} ({survey.channel.msgtype})"
        for survey in surveys
        if survey.recorded and not survey.messages and is_special(survey)
    )
    if undefined:
        text += f"; the bag holds no definition of {undefined}: give its .msg file with --msg"
    if joints:
        text += f"; joints here are {', '.join(joints)}"
    if numbers:
        text += f"; topics with a number: {numbers} (one of each side: topic, right_topic)"
    return text


def _findings(estimates: robot_file.LogEstimates) -> Iterator[str]:
    """Findings on clocks, headings, lags, tracks, standstills, bias at rest, units."""
    log, mapping, mounting = estimates.log, estimates.mapping, estimates.mounting
    for purpose, choice in estimates.clocks.items():
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
    yield from (note for note in log.notes if any(words in note for words in OF_THE_FILE))
    if mapping.columns and (tracks := mapping.columns.tracks) and tracks.clock_offset:
        drift = f", and gains {1e3 * tracks.clock_drift:.2f} ms/s" if tracks.clock_drift else ""
        yield f"tracks: their clock is {tracks.clock_offset:+.2f} s off the IMU's{drift}, by yaw rates"
    for purpose, latency in estimates.latencies.items():
        yield _lag_finding(purpose, latency, by_yaw_rate=purpose != "truth" or fault is None)
    if mapping.lacks_counts_per_turn:
        yield (
            "tracks: counters; fill in counts_per_turn, and inspect again with --overwrite for the "
            "effective track and radius"
        )
    if estimates.wheels.track_ratio is not None:
        yield _track_finding(estimates)
    if mounting is not None and (mounting.turning_correlation or 0.0) < -wheels.CLEAR_SIGN:
        yield (
            "tracks: they turn the other way than the gyro (correlation "
            f"{mounting.turning_correlation:.2f}): left and right may be swapped, the gyro's signs "
            "wrong, or the IMU upside down"
        )
    rate = estimates.vertical
    if estimates.are_apart and log.imu is not None and rate is not None:
        side = imu_mounting.backward_side(log.tracks, log.imu, rate)
        backward = f"the {side} side counts backward, a minus before its names?"
        cause = backward if side else "another robot's topic, or another time's?"
        yield f"tracks: they turn, and the gyro turns, but not together: {cause}"
    if mounting is not None and (mount := estimates.imu_mount) is not None:
        contradiction = static_frames.contradiction(mounting, mount)
        yield from [contradiction] if contradiction else []
    yield from _failed_sensors(log, estimates)
    if len(log.tracks.stamps):
        stops = wheels.standstills(log)
        total = sum(end - begin for begin, end in stops)
        spans = ", ".join(f"{begin:.0f} to {end:.0f} s" for begin, end in stops[:MOST_STOPS])
        more = ", ..." if len(stops) > MOST_STOPS else ""
        found = f"{len(stops)}, {total:.0f} s in all ({spans}{more})"
        yield f"standstills: {found if stops else 'none of a second or more'}"
    if mounting is not None and mounting.gyro_bias is not None:
        bias = ", ".join(f"{value:.5f}" for value in mounting.gyro_bias)
        moves = "; it changes over the log, as with the temperature: gyro_bias_walk is proposed"
        moves = moves if estimates.bias is not None and estimates.bias.walk else ""
        yield f"gyro bias at standstill: ({bias}) rad/s in the IMU's axes{moves}"
    yield from (f"suspicious: {text}" for text in unit_suspicions(estimates, log))


def _failed_sensors(log: Log, estimates: robot_file.LogEstimates) -> Iterator[str]:
    """Findings on sensors that fail in the log or a part of it."""
    yield from (f"tracks: {stuck.text}" for stuck in stuck_sides(log.tracks, None))
    rates, is_usable = estimates.vertical, imu_mounting.are_usable(log.tracks)
    if log.imu is not None and rates is not None and is_usable and not estimates.mapping.from_twist:
        found = unequal_sides(log.tracks, log.imu, rates)
        if found is not None:
            yield f"tracks: {found.text}: look at counts, gears and radius of both sides"
    span = imu_span(log)
    if span is not None:
        yield f"imu: {span[2]}: look at its driver and cable"


def _lag_finding(purpose: str, lag: Lag | NoLag, *, by_yaw_rate: bool) -> str:
    """Finding on the lag of a stream behind the gyro, or the tracks."""
    if isinstance(lag, NoLag):
        return f"{purpose}: lag behind the gyro not observable: {lag.reason}"
    lags = "lag" if lag.seconds > 0.0 else "lead"
    against = "the gyro (by yaw rate)" if by_yaw_rate else "the tracks (by speed)"
    reason = objection(lag)
    refusal = f"; {reason}: no latency is proposed" if reason else ""
    size = f"{abs(lag.seconds):.2f} s (± {lag.sigma:.1g})"
    return f"{purpose}: stamps {lags} {against} by {size}{refusal}"


def unit_suspicions(estimates: robot_file.LogEstimates, log: Log) -> Iterator[str]:
    """Report values of a log that seem to be in another unit."""
    in_rates, mounting = estimates.mapping.in_rates, estimates.mounting
    ratio = estimates.wheels.distance_ratio
    if mounting is not None and mounting.specific_force is not None:
        force = float(np.linalg.norm(mounting.specific_force))
        if abs(force - wheels.GRAVITY) > wheels.WRONG_GRAVITY * wheels.GRAVITY:
            guess = wheels.unit_of_gravity(force)
            yield f"mean specific force is {force:.3g}, not {wheels.GRAVITY} m/s²{guess}"
    if log.imu is not None:
        fast = wheels.fast_turning(log.imu)
        if fast > wheels.FAST_TURNING:
            yield f"the gyro reads {fast:.3g} and more for 1 % of the time; rad/s, or rather deg/s?"
        vertical = estimates.vertical
        if estimates.mapping.from_twist and vertical is not None and len(log.tracks.stamps) > 1:
            yield from wheels.turning_suspicion(log, vertical)
    if len(log.tracks.speeds):
        fast = float(np.percentile(np.abs(log.tracks.speeds), 99))
        if in_rates and fast > FAST_RATE and not estimates.mapping.lacks_counts_per_turn:
            yield (
                f"wheel rates of {fast:.3g} rad/s: in another unit (rpm, deg/s, counts), or of motors "
                "before a gear (scale in [log.tracks])?"
            )
        if not in_rates and fast > FAST_SPEED:
            yield f"track speeds of {fast:.3g}; m/s, or rather mm/s?"
    if not in_rates and ratio is not None and not 0.5 < ratio < 2.0:
        size = f"{ratio:.3g} times that of the track speeds"
        yield f"the distance over ground is {size}, by the {estimates.wheels.distance_source}"


def _track_finding(estimates: robot_file.LogEstimates) -> str:
    """Finding on the effective track by the gyro, as settings of a controller have it."""
    ratio, sigma = estimates.wheels.track_ratio, estimates.wheels.track_sigma
    error = "" if sigma is None else f" (± {sigma:.1g})"
    if estimates.mapping.from_twist:
        return (
            f"tracks: the odometry turns {ratio:.2f}{error} times as far as the gyro: multiply the "
            f"wheel_separation_multiplier of its controller by {ratio:.2f}"
        )
    unit = "times the effective radius" if estimates.mapping.in_rates else "m"
    return (
        f"tracks: the effective track is {ratio:.3g}{error} {unit}, by the gyro; divided by the wheel "
        "separation it is a controller's wheel_separation_multiplier"
    )


def _rate_finding(track: by_rate.TrackByRate | None) -> Iterator[str]:
    """Finding on whether the effective track depends on the yaw rate."""
    rates = sorted(abs(rate_bin.rate) for rate_bin in track.bins) if track is not None else []
    # Yaw rates that are much alike would not show it.
    if track is None or len(rates) < 2 or rates[-1] < 1.5 * rates[0]:
        return
    text = f"tracks: from {rates[0]:.1f} to {rates[-1]:.1f} rad/s the effective track"
    extremes = by_rate.extremes(track.bins)
    if extremes is None:
        yield f"{text} does not depend significantly on the yaw rate"
        return
    narrower, wider = (
        f"{width:.3g} (± {sigma:.1g}) {track.unit} at {abs(rate):.2f} rad/s to the "
        f"{'left' if rate > 0.0 else 'right'}"
        for rate, width, sigma, _ in extremes
    )
    yield f"{text} depends on the yaw rate: {narrower}, {wider}; --picture FILE draws it"


def _error_findings(estimates: robot_file.LogEstimates) -> Iterator[str]:
    """Findings on a gyro bias while driving, and on the error of the fixes."""
    bias, wander = estimates.bias, estimates.wander
    if bias is not None and bias.source != "standstill":
        size = f"{bias.value:.4f} ± {bias.sigma:.4f} rad/s about the vertical while driving"
        refusal = "" if bias.differs(0.0) else ": not significant, not written"
        if refusal and abs(bias.value) > SURE * bias.sigma:
            refusal = f": below {LEAST_BY_TRACKS:g} rad/s the tracks may be it, not written"
        yield f"gyro bias: {size}, by the {bias.source}{refusal}"
    if (fit := estimates.fix_fit) is not None and fit.is_late:
        lags = "lag" if fit.lag > 0.0 else "lead"
        yield f"fixes: stamps {lags} the tracks by {abs(fit.lag):.2f} s (± {fit.lag_sigma:.1g})"
    if isinstance(wander, FixWanderEstimate):
        yield f"fixes: {wander.text}"
    elif wander is not None:
        yield f"fixes: whether their error wanders cannot be seen: {wander}"
