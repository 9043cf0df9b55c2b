"""Guess of the topic map of an unknown bag, by types and names."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from msgspec.structs import replace

from icreckon.replay.bags import message_types as ros
from icreckon.replay.inspection.topic_survey import Survey
from icreckon.replay.mapping.field_paths import number_paths
from icreckon.replay.mapping.topics import (
    FixTopic,
    HeadingTopic,
    ImuTopic,
    TopicMap,
    TrackTopic,
    TruthTopic,
)
from icreckon.replay.mapping.track_units import ANY_COUNTS, TrackUnit
from icreckon.replay.reading.stream import ABSENT

DRIVE_WORDS = ("wheel", "track", "sprocket", "drive")
LEFT = {"l", "lwheel", "fl", "ml", "rl", "bl", "lf", "lm", "lr", "lb"}
RIGHT = {"r", "rwheel", "fr", "mr", "rr", "br", "rf", "rm", "rb"}
TRUE = re.compile(r"truth|ground|(?<![a-z])(?:true|gt)(?![a-z])")
COMMAND = re.compile(
    r"cmd|command|desired|target|setpoint|demand|request|wanted"
    r"|(?<![a-z])(?:ref|sp|set|tgt|req|goal)(?![a-z])"
)
SPEED = re.compile(r"vel|speed|(?<!tempe)rate|omega|rpm|(?<![a-z])(?:count|tick|enc)")
NO_SPEED = re.compile(
    r"current(?!_?(?:vel|speed|rate|rpm))|volt|temp|torque|effort|power|pwm|duty|throttle|error|accel"
)
COUNTER = re.compile("count|tick|enc")
UNIT_WORDS: tuple[tuple[str, TrackUnit], ...] = (
    ("rpm", "rpm"),
    ("/min", "rpm"),
    ("rad", "rad/s"),
    ("deg", "deg/s"),
    ("mm", "mm/s"),
    ("km", "km/h"),
)
NUMBERS: dict[str, float | None] = dict.fromkeys(("Float64", "Float32", "Int64", "UInt64"))
NUMBERS |= {f"{sign}Int{bits}": 2.0**bits for sign in ("", "U") for bits in (32, 16)}
"""Types of std_msgs with one number, and the range of a counter of that type."""
STANDARD = ("geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs", "tf2_msgs", "diagnostic_msgs")
"""Packages of messages that have a meaning of their own, or none."""
PLACEHOLDER_SIGMA = 0.05
"""Placeholder sigma of fixes without a covariance [m] and of headings [rad], for the user to replace."""


def guess_topics(surveys: Iterable[Survey]) -> TopicMap:
    """Guess the topic of each stream.

    Track speeds come from a JointState with velocities of left and right joints, from two topics with
    a number each, from numbers of another message by their names, or else from an odometry. The IMU is
    the fastest topic that measures rates; another Imu with an orientation but no rates is a heading.
    Poses are the truth if the topic is named so, otherwise fixes.

    Returns:
        The mapping; None for streams that were not found.
    """
    found = {one.channel.topic: one for one in surveys if one.recorded}
    found = dict(sorted(found.items()))
    truths = {topic: sample for topic, sample in found.items() if is_truth(topic)}
    own = {topic: sample for topic, sample in found.items() if not is_truth(topic)}
    tracks = _tracks(own)
    taken = tracks.topic if tracks else None
    return TopicMap(
        tracks=tracks,
        imu=_imu(own),
        fixes=_fixes({topic: sample for topic, sample in own.items() if topic != taken}),
        truth=_truth(truths, tracks),
        heading=_heading(own),
    )


def sides(names: list[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Select the driving joints of the left and the right side, by their names."""

    def on(side: str, abbreviations: set[str]) -> list[str]:
        return [
            name
            for name in names
            if side in name.lower() or abbreviations & set(re.split(r"[^a-z]+", name.lower()))
        ]

    def driving(side: list[str]) -> tuple[str, ...]:
        drives = [name for name in side if any(word in name.lower() for word in DRIVE_WORDS)]
        return tuple(drives or side)

    return driving(on("left", LEFT)), driving(on("right", RIGHT))


def is_truth(topic: str) -> bool:
    """Test for a topic or column of the truth, by its name."""
    return TRUE.search(topic.lower()) is not None


def is_command(topic: str) -> bool:
    """Test for a topic or column of commands instead of measurements, by its name."""
    return COMMAND.search(topic.lower()) is not None


def _tracks(samples: Mapping[str, Survey]) -> TrackTopic | None:
    for topic, sample in samples.items():
        if sample.channel.msgtype != ros.JOINT_STATE or is_command(topic):
            continue
        named = [list(one.name) for one in sample.messages if len(one.velocity) == len(one.name)]
        # Some drivers publish each wheel in a message of its own.
        together = list(dict.fromkeys(name for names in named for name in names))
        for names in (*named, together):
            left, right = sides(names)
            if left and right:
                return TrackTopic(topic, left=left, right=right)
    if (numbers := _pair_of_topics(samples) or _fields_of_sides(samples)) is not None:
        return numbers
    candidates = [
        topic
        for topic, sample in samples.items()
        if sample.channel.msgtype in (ros.ODOMETRY, ros.TWIST) and not is_command(topic)
    ]

    def unlikely(topic: str) -> tuple[bool, bool]:
        wheels = any(word in topic.lower() for word in (*DRIVE_WORDS, "controller", "odom"))
        return (samples[topic].channel.msgtype != ros.ODOMETRY, not wheels)

    return TrackTopic(min(candidates, key=unlikely)) if candidates else None


def _pair_of_topics(samples: Mapping[str, Survey]) -> TrackTopic | None:
    """Topics of both sides with a number each, as of many encoder boards."""
    for kind, wrap in NUMBERS.items():
        left, right = sides(
            [
                topic
                for topic, sample in samples.items()
                if sample.channel.msgtype == f"std_msgs/msg/{kind}" and may_be_a_side(sample)
            ]
        )
        if len(left) == len(right) == 1 and left != right:
            pair = TrackTopic(left[0], right[0], left=("data",), right=("data",))
            if "Int" in kind:
                return replace(pair, unit="counts", counts_per_turn=ANY_COUNTS, wrap=wrap)
            return replace(pair, **unit_of(left[0], unknown="rad/s"))
    return None


def _fields_of_sides(samples: Mapping[str, Survey]) -> TrackTopic | None:
    """Topic whose messages have numbers named like the speeds or counts of both sides."""
    for topic, sample in samples.items():
        if sample.channel.msgtype.split("/")[0] in STANDARD or not sample.messages:
            continue
        paths = number_paths(sample.messages[0])
        left, right = sides([path for path in paths if is_of_wheel(f"{topic} {path}")])
        if left and len(left) == len(right) and not {*left} & {*right}:
            track = TrackTopic(topic, left=left, right=right)
            return replace(track, **unit_of(left[0], unknown="m/s"))
    return None


def unit_of(name: str, unknown: TrackUnit) -> dict[str, Any]:
    """Unit by a name, as keys of `TrackKeys`; a person fills in counts per turn."""
    name = name.lower()
    if COUNTER.search(name):
        return {"unit": "counts", "counts_per_turn": ANY_COUNTS}
    return {"unit": next((unit for word, unit in UNIT_WORDS if word in name), unknown)}


def may_be_a_side(sample: Survey) -> bool:
    """Test for a number named like the speed or count of a wheel, on its own topic."""
    kind = sample.channel.msgtype.split("/")
    is_number = kind[0] == "std_msgs" and kind[-1] in NUMBERS
    return is_number and is_of_wheel(sample.channel.topic)


def is_of_wheel(name: str) -> bool:
    """Test for the name of a measured speed or count of a wheel."""
    name = name.lower()
    is_wheel = any(word in name for word in DRIVE_WORDS) or SPEED.search(name) is not None
    return is_wheel and not NO_SPEED.search(name) and not is_command(name)


def _measures_rates(sample: Survey) -> bool:
    return any(
        message.angular_velocity_covariance[0] != ABSENT
        and (message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z)
        != (0.0, 0.0, 0.0)
        for message in sample.messages
    )


def _heading(samples: Mapping[str, Survey]) -> HeadingTopic | None:
    for topic, sample in samples.items():
        if sample.channel.msgtype != ros.IMU or _measures_rates(sample):
            continue
        turned = [one for one in sample.messages if one.orientation_covariance[0] != ABSENT]
        if any(abs(one.orientation.z) > 0.0 for one in turned):
            known = any(one.orientation_covariance[8] > 0.0 for one in turned)
            return HeadingTopic(topic, sigma=None if known else PLACEHOLDER_SIGMA)
    return None


def _imu(samples: Mapping[str, Survey]) -> ImuTopic | None:
    rates = {
        topic: len(sample.recorded)
        for topic, sample in samples.items()
        if sample.channel.msgtype == ros.IMU and _measures_rates(sample)
    }
    return ImuTopic(max(rates, key=lambda topic: rates[topic])) if rates else None


def _fixes(samples: Mapping[str, Survey]) -> FixTopic | None:
    measured = {topic: one for topic, one in samples.items() if not is_command(topic)}
    topic = _first(measured, ros.POSE_WITH_COVARIANCE, ros.POSE)
    if topic is not None:
        known = samples[topic].channel.msgtype == ros.POSE_WITH_COVARIANCE
    elif (topic := _first(samples, ros.NAVSATFIX)) is not None:
        known = any(one.position_covariance_type for one in samples[topic].messages)
    else:
        return None
    return FixTopic(topic, position_sigma=None if known else PLACEHOLDER_SIGMA)


def _truth(samples: Mapping[str, Survey], tracks: TrackTopic | None) -> TruthTopic | None:
    topic = _first(samples, ros.POSE, ros.POSE_WITH_COVARIANCE, ros.ODOMETRY, ros.NAVSATFIX)
    if topic is None:
        return None
    # True track speeds are read with the names of the joints in [log.tracks].
    has_joint_names = tracks is not None and bool(tracks.left)
    joints = _first(samples, ros.JOINT_STATE) if has_joint_names else None
    twist, source = _first(samples, ros.TWIST), _first(samples, ros.STRING)
    return TruthTopic(topic, twist=twist, tracks=joints, source_topic=source)


def _first(samples: Mapping[str, Survey], *types: str) -> str | None:
    """First topic of the first of these types that is there."""
    for kind in types:
        for topic, one in samples.items():
            if one.channel.msgtype == kind:
                return topic
    return None
