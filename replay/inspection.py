"""Inspection: what a bag holds, topic by topic, and a robot file to start from."""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from dataclasses import replace as with_changed
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from estimator.log import NANOSECOND, Log
from estimator.robot import Robot, Vehicle
from replay.bag_files import Bag, over_bag
from replay.bags import read_log
from replay.decoding import decoder, header_reader
from replay.errors import ReplayError
from replay.guess import Sample, guess_topics
from replay.mounting import Mounting, estimate_mounting
from replay.proposal import robot_file_text
from replay.records import Channel
from replay.streams import IMU, JOINT_STATE, imu_row
from replay.topics import TopicMap

SAMPLES = 200
"""Messages of a topic that are looked into to guess what it is."""
SHAPE_CHECKS: dict[str, Callable[[Any], object]] = {
    JOINT_STATE: lambda message: (message.name, message.velocity),
    IMU: imu_row,
}
"""The types that are looked into; each raises when a definition is not the one of that name."""
CLOCKS_APART = 1.0
"""Header stamps whose offsets differ by more than this come from different clocks [s]."""


@dataclass(frozen=True)
class TopicReport:
    """What a topic holds.

    Attributes:
        topic: name.
        msgtype: message type.
        frame_id: frame of the first message, "" where it has none.
        count: number of messages.
        mean_rate: messages per second of recording [Hz], or None for fewer than two.
        largest_gap: longest time between two messages, by recording [s], or None likewise.
        clock_offset: median of header stamp minus time of recording [s], or None without headers.
        repeated_share: for the track speeds, share of values that only repeat the one before, of
            the values while the tracks moved; None for other topics.
    """

    topic: str
    msgtype: str
    frame_id: str
    count: int
    mean_rate: float | None
    largest_gap: float | None
    clock_offset: float | None
    repeated_share: float | None = None


@dataclass(frozen=True)
class Inspection:
    """What a bag holds.

    Attributes:
        path: the bag.
        duration: from the first to the last message, by time of recording [s].
        topics: one report for each topic, by name.
        mapping: which topic is which stream, as guessed.
        mounting: what the log tells about its IMU, or None.
        dropped: what screening would drop, as in `Log`.
        notes: what is worth telling of the bag.
        proposed_robot_file: a robot file to start from, as TOML; what no log can tell is a
            placeholder, marked in a comment.
    """

    path: Path
    duration: float
    topics: tuple[TopicReport, ...]
    mapping: TopicMap
    mounting: Mounting | None
    dropped: dict[str, int]
    notes: tuple[str, ...]
    proposed_robot_file: str


def inspect(path: Path | str) -> Inspection:
    """Look into a bag; one that was cut short is looked into up to the break.

    Args:
        path: the bag, as for `read_log`.

    Raises:
        ReplayError: no such file, no bag, or nothing of it can be read.
    """
    path = Path(path)
    surveys, notes = over_bag(path, lambda bag: (_survey(bag, str(path)), tuple(bag.notes)))
    reports = {survey.channel.topic: survey.report() for survey in surveys}
    mapping = guess_topics(
        {
            survey.channel.topic: Sample(
                survey.channel.msgtype, len(survey.recorded), survey.messages
            )
            for survey in surveys
        }
    )
    clocks_differ = _clocks_differ(mapping, reports)
    if clocks_differ:
        mapping = _by_recording(mapping)
    log = None
    try:
        log = _log_in_units_of_radius(path, mapping)
    except ReplayError as problem:
        notes = (*notes, f"the proposed topics cannot be read: {problem}")
    if log is not None and mapping.tracks is not None:
        report = reports[mapping.tracks.topic]
        reports[report.topic] = with_changed(report, repeated_share=_repeated_share(log))
    mounting = estimate_mounting(log) if log is not None else None
    times = [survey.recorded for survey in surveys if survey.recorded]
    duration = (max(map(max, times)) - min(map(min, times))) * NANOSECOND if times else 0.0
    return Inspection(
        path=path,
        duration=duration,
        topics=tuple(reports[name] for name in sorted(reports)),
        mapping=mapping,
        mounting=mounting,
        dropped=log.dropped if log is not None else {},
        notes=notes,
        proposed_robot_file=robot_file_text(path, mapping, mounting, log, clocks_differ),
    )


@dataclass
class _Survey:
    """One pass over a topic's messages."""

    channel: Channel
    recorded: list[int] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    frame_id: str = ""
    messages: list[Any] = field(default_factory=list)

    def report(self) -> TopicReport:
        times = np.sort(np.array(self.recorded, dtype=np.int64))
        several = len(times) > 1 and times[-1] > times[0]
        return TopicReport(
            topic=self.channel.topic,
            msgtype=self.channel.msgtype,
            frame_id=self.frame_id,
            count=len(times),
            mean_rate=(len(times) - 1) / float((times[-1] - times[0]) * NANOSECOND)
            if several
            else None,
            largest_gap=float(np.diff(times).max() * NANOSECOND) if several else None,
            clock_offset=float(np.median(self.offsets) * NANOSECOND) if self.offsets else None,
        )


def _survey(bag: Bag, source: str) -> list[_Survey]:
    surveys = {channel: _Survey(channel) for channel in bag.counts}
    headers = {channel: header_reader(channel) for channel in surveys}
    decoders = {}
    for channel in surveys:
        if channel.msgtype in SHAPE_CHECKS:
            # A type that cannot be decoded is listed all the same.
            with suppress(ReplayError):
                decoders[channel] = decoder(channel, source)
    for record in bag.messages({channel.topic for channel in surveys}):
        survey = surveys[record.channel]
        survey.recorded.append(record.time)
        read_header = headers[record.channel]
        if read_header is not None:
            try:
                header = read_header(record.data)
            except (struct.error, IndexError, TypeError, UnicodeDecodeError):
                continue
            survey.offsets.append(header.stamp - record.time)
            survey.frame_id = survey.frame_id or header.frame_id
        if record.channel in decoders and len(survey.messages) < SAMPLES:
            try:
                message = decoders[record.channel](record.data)
                SHAPE_CHECKS[record.channel.msgtype](message)
                survey.messages.append(message)
            except Exception:  # noqa: S112
                # Not a message of its type; `read_log` counts these.
                continue
    return list(surveys.values())


def _mapped_topics(mapping: TopicMap) -> list[str]:
    entries = (mapping.tracks, mapping.imu, mapping.fixes, mapping.truth)
    return [entry.topic for entry in entries if entry is not None]


def _clocks_differ(mapping: TopicMap, reports: dict[str, TopicReport]) -> bool:
    """Whether header stamps come from clocks that are far apart, of all topics with a header.

    All topics count, not only the mapped ones: a fix that is not mapped now may be later.
    """
    offsets = [
        report.clock_offset for report in reports.values() if report.clock_offset is not None
    ]
    return bool(_mapped_topics(mapping)) and np.ptp(offsets or [0.0]) > CLOCKS_APART


def _by_recording(mapping: TopicMap) -> TopicMap:
    return TopicMap(
        tracks=mapping.tracks and replace(mapping.tracks, time="recording"),
        imu=mapping.imu and replace(mapping.imu, time="recording"),
        fixes=mapping.fixes and replace(mapping.fixes, time="recording"),
        truth=mapping.truth and replace(mapping.truth, time="recording"),
    )


def _log_in_units_of_radius(path: Path, mapping: TopicMap) -> Log:
    unit = Vehicle(mass=1.0, track_gauge=1.0, sprocket_radius=1.0)
    return read_log(path, Robot(name="unknown", vehicle=unit), topics=mapping)


def _repeated_share(log: Log) -> float | None:
    speeds = log.tracks.speeds
    moving = (speeds[:-1] != 0.0).any(axis=1)
    if not moving.any():
        return None
    return float((speeds[1:] == speeds[:-1])[moving].mean())
