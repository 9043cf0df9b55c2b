"""Survey of a bag's messages, topic by topic, in one pass."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Stamps
from icreckon.replay.bags.bag_files import Bag
from icreckon.replay.bags.decoding import Definitions, decoder, header_reader
from icreckon.replay.bags.message_types import IMU, JOINT_STATE, NAVSATFIX, TF, TF_ROS1
from icreckon.replay.bags.records import Channel
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.reading.message_rows import imu_row

SAMPLES = 200  # messages of a topic that are decoded to guess its stream
SAMPLE_BYTES = 1_000_000  # most bytes of these messages
LONGEST_FRAME = 200  # most characters of a frame's name that are kept
SHAPE_CHECKS: dict[str, Callable[[Any], object]] = {
    JOINT_STATE: lambda message: (message.name, message.velocity),
    IMU: imu_row,
    NAVSATFIX: lambda message: (message.status.status, message.position_covariance_type),
    TF: lambda message: message.transforms,
    TF_ROS1: lambda message: message.transforms,
}
"""Checks of the decoded types; each raises if a definition is not the standard one of its name."""
GAP = 5.0  # smallest gap as a multiple of the usual interval between two messages [-]


@dataclass(frozen=True)
class TopicReport:
    """Statistics of a topic."""

    topic: str  # name
    msgtype: str  # message type
    frame_id: str  # frame of the first message, "" if it has none
    count: int  # number of messages
    mean_rate: float | None = None  # one over the median interval [Hz]; None for fewer than two
    largest_gap: float | None = None  # longest time between recorded messages [s], or None likewise
    clock_offset: float | None = None  # median header stamp minus recording time [s], None without
    gaps: int | None = None  # number of intervals longer than `GAP` times the usual one, or None
    # share of samples equal to the previous one: of the values of track speeds while the tracks
    # moved, of the samples of the IMU; None for other topics
    repeated_share: float | None = None


def spacing(times: Stamps) -> dict[str, Any]:
    """Rate and gaps of times (n,) in any order [ns], for `TopicReport`; {} if unknown."""
    times = np.sort(times)
    if len(times) < 2 or times[-1] == times[0]:
        return {}
    # As floats: far-off times would overflow.
    steps = np.diff(times.astype(np.float64)) * NANOSECOND
    median = float(np.median(steps))
    usual = median or float(steps.mean())  # the median is 0 if most times are equal
    gaps = int((steps > GAP * median).sum())
    return {"mean_rate": 1.0 / usual, "largest_gap": float(steps.max()), "gaps": gaps}


@dataclass
class Survey:
    """Data gathered from a topic."""

    channel: Channel  # the topic and its type
    recorded: array[int] = field(default_factory=lambda: array("q"))  # times of recording [ns]
    offsets: array[int] = field(default_factory=lambda: array("q"))  # header less recording [ns]
    frame_id: str = ""  # frame of the first message that has one
    # some decoded ones, of the types in `SHAPE_CHECKS`; the first one of other types
    messages: list[Any] = field(default_factory=list)
    sampled: int = 0  # bytes of the messages that were decoded

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self.channel.topic

    @property
    def msgtype(self) -> str:
        """Type of its messages."""
        return self.channel.msgtype

    @property
    def most(self) -> int:
        """Most messages of the topic's type that are decoded."""
        return SAMPLES if self.msgtype in SHAPE_CHECKS else 1

    def extend(self, other: Self) -> None:
        """Append the survey of the topic in another file."""
        self.recorded.extend(other.recorded)
        self.offsets.extend(other.offsets)
        self.frame_id = self.frame_id or other.frame_id
        self.messages.extend(other.messages[: self.most - len(self.messages)])
        self.sampled += other.sampled

    def report(self, repeated_share: float | None) -> TopicReport:
        """Compute the statistics of the topic, with the share of repeated samples."""
        return TopicReport(
            topic=self.topic,
            msgtype=self.msgtype,
            frame_id=self.frame_id,
            count=len(self.recorded),
            clock_offset=float(np.median(self.offsets) * NANOSECOND) if self.offsets else None,
            repeated_share=repeated_share,
            **spacing(np.array(self.recorded, dtype=np.int64)),
        )


def survey_bag(bag: Bag, source: str, definitions: Definitions) -> tuple[list[Survey], list[str]]:
    """Survey all messages of a bag: a survey of each channel, and notes on the bag.

    A channel whose type cannot be decoded has no sample messages; a message with a damaged header counts,
    but is not decoded. `source` names the bag in errors.
    """
    surveys = {channel: Survey(channel) for channel in bag.counts}
    headers = {channel: header_reader(channel) for channel in surveys}
    decoders = {}
    for channel in surveys:
        with suppress(ReplayError):
            decoders[channel] = decoder(channel, source, definitions)
    for record in bag.messages({channel.topic for channel in surveys}):
        survey = surveys[record.channel]
        survey.recorded.append(record.time)
        read_header = headers[record.channel]
        if read_header is not None:
            try:
                stamp, frame_id = read_header(record.data)
            except (struct.error, IndexError, TypeError, UnicodeDecodeError):
                continue
            survey.offsets.append(stamp - record.time)
            survey.frame_id = survey.frame_id or frame_id[:LONGEST_FRAME]
        sampled = survey.sampled + len(record.data)
        has_room = len(survey.messages) < survey.most and sampled <= SAMPLE_BYTES
        if record.channel in decoders and has_room:
            survey.sampled = sampled
            try:
                message = decoders[record.channel](record.data)
                if check := SHAPE_CHECKS.get(record.channel.msgtype):
                    check(message)
                survey.messages.append(message)
            except Exception:  # noqa: S112
                # Not a message of its type; `read_log` counts these.
                continue
    return list(surveys.values()), list(bag.notes)
