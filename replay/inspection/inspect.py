"""Inspection of a log, topic by topic, with a proposed robot file."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.log import Log
from icreckon.replay.bags.bag_files import over_bag
from icreckon.replay.bags.decoding import Definitions
from icreckon.replay.bags.table_files import is_table
from icreckon.replay.base.errors import NoRowsError, ReplayError, coarse_stamps
from icreckon.replay.estimates.imu_mounting import Mounting
from icreckon.replay.estimates.track_by_rate import TrackByRate
from icreckon.replay.inspection import static_frames, topic_survey
from icreckon.replay.inspection.findings import findings, missing_tracks
from icreckon.replay.inspection.guess_columns import guess_columns, time_column_of, unused_columns
from icreckon.replay.inspection.guess_topics import guess_topics, unused_topics
from icreckon.replay.inspection.log_estimates import NO_SIZES, Sizes, log_estimates, with_keys
from icreckon.replay.inspection.robot_file import robot_file_text
from icreckon.replay.mapping.columns import ColumnMap
from icreckon.replay.mapping.topics import TopicMap
from icreckon.replay.reading.gather import as_paths, first_path
from icreckon.replay.reading.tables import Table


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
    mounting: Mounting | None
    findings: tuple[str, ...]
    dropped: dict[str, int]
    notes: tuple[str, ...]
    proposed_robot_file: str
    track: TrackByRate | None = None


def inspect(
    path: Path | str | Sequence[Path | str],
    *,
    definitions: Definitions = (),
    sizes: Sizes = NO_SIZES,
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
    if not tables and not any(survey.recorded for survey in surveys):
        raise ReplayError(f"{first}: nothing to inspect, no topic has a message")
    mapping = guess_topics(surveys, sizes.log.get("fixes", {}).get("topic"))
    if tables:
        time_column = str(sizes.log.get("columns", {}).get("time", ""))
        mapping = replace(mapping, columns=guess_columns(tables, time_column))
        timeless = [table.path.name for table in tables if not time_column_of(table, time_column)]
        if timeless:
            notes.append(f"no column looks like a time, not used: {', '.join(timeless)}")
    mounts = static_frames.static_mounts(surveys)
    if mapping.fixes is not None and mapping.fixes.topic in mounts:
        place = tuple(mounts[mapping.fixes.topic].position.tolist())
        mapping = replace(mapping, fixes=replace(mapping.fixes, position=place))
    mapping = with_keys(mapping, sizes.log)
    imu_topic = mapping.imu.topic if mapping.imu else ""
    mount = mounts.get(imu_topic)
    estimates = log_estimates(paths, mapping, definitions, sizes, mount, notes)
    mapping, log = estimates.mapping, estimates.log
    reports = _topic_reports(surveys, mapping, log)
    for table in tables:
        reports += _column_reports(table, mapping.columns)
    topic_findings = static_frames.unplaced(surveys, mounts, imu_topic)
    if not mapping.track_keys:
        topic_findings.append(missing_tracks(surveys))
    topic_findings += unused_topics(surveys, mapping)
    topic_findings += unused_columns(tables, mapping.columns)
    return Inspection(
        path=first,
        duration=_duration(surveys, log if tables else None),
        topics=tuple(reports),
        mapping=mapping,
        mounting=estimates.mounting,
        findings=(*topic_findings, *findings(estimates)),
        dropped=log.dropped if log is not None else {},
        notes=(*coarse_stamps(log.notes if log else ()), *notes),
        proposed_robot_file=robot_file_text(first, estimates),
        track=estimates.track,
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
    topics = {survey.topic: survey for survey in surveys}
    return [topics[topic].report(repeated.get(topic)) for topic in sorted(topics)]


def _survey_files(
    paths: Sequence[Path], definitions: Definitions
) -> tuple[list[topic_survey.Survey], list[str], list[Table]]:
    """Survey all files in one pass: topics, notes, tables."""
    # By name and type: a topic with messages in several bags has one survey.
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
            known = surveys.setdefault((new.topic, new.msgtype), new)
            if known is not new:
                known.extend(new)
    return list(surveys.values()), notes, tables


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
