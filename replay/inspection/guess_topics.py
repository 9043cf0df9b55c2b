"""Guess of the topic map of an unknown bag, by types and names."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import partial
from itertools import product

import numpy as np

from icreckon.replay.bags import message_types as ros
from icreckon.replay.inspection.topic_survey import Survey
from icreckon.replay.mapping import naming
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
from icreckon.replay.reading.message_rows import (
    BODY_READERS,
    GEODETIC_READERS,
    STATUS_NO_FIX,
    imu_row,
)
from icreckon.replay.reading.stream import ABSENT

NUMBERS: dict[str, float | None] = dict.fromkeys(("Float64", "Float32", "Int64", "UInt64"))
NUMBERS |= {f"{sign}Int{bits}": 2.0**bits for sign in ("", "U") for bits in (32, 16)}
"""Types of std_msgs with one number, and the range of a counter of that type."""
STANDARD = ("geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs", "tf2_msgs", "diagnostic_msgs")
"""Packages of messages that have a meaning of their own, or none."""

Surveys = Mapping[str, Survey]  # by topic


def guess_topics(surveys: Iterable[Survey], fixes: str | None = None) -> TopicMap:
    """Guess the topic of each stream; `fixes` is that of the fixes, if it is known.

    Another Imu with an orientation but no rates is a heading. Poses are the truth if the topic is named
    so, otherwise fixes. Streams that were not found are None.
    """
    recorded = sorted((s for s in surveys if s.recorded), key=lambda s: s.channel.topic)
    other_robots = robots(recorded)[1:]
    by_topic = {survey.channel.topic: survey for survey in recorded}
    by_topic = {k: one for k, one in by_topic.items() if _namespace_of(k) not in other_robots}
    truths = {topic: survey for topic, survey in by_topic.items() if naming.is_truth(topic)}
    sensors = {topic: survey for topic, survey in by_topic.items() if topic not in truths}
    tracks, heading = _tracks(sensors), _heading(sensors)
    track_names = (tracks.topic, *tracks.left) if tracks else ()
    imu = _imu(sensors, {*map(_namespace_of, track_names)})
    if tracks:
        del sensors[tracks.topic]  # an odometry that gives track speeds is no fix, too
    if fixes in by_topic:
        sensors = {fixes: by_topic[fixes]}
    return TopicMap(tracks, imu, _fixes(sensors), _truth(truths, tracks), heading)


def robots(surveys: Iterable[Survey]) -> list[str]:
    """Namespaces of several robots in one bag; none for the topics of one robot.

    Each robot has an IMU and wheels, on topics of the same names within its namespace.
    """
    by_namespace: dict[str, dict[str, Survey]] = {}
    for survey in surveys:
        by_namespace.setdefault(_namespace_of(survey.channel.topic), {})[survey.channel.topic] = (
            survey
        )
    namespaces_by_names: dict[tuple[str, str], list[str]] = {}
    for namespace in sorted(by_namespace.keys() - {""}):
        tracks, imu = _tracks(by_namespace[namespace]), _imu(by_namespace[namespace])
        if tracks and imu:
            names = tracks.topic.replace(namespace, "", 1), imu.topic.replace(namespace, "", 1)
            namespaces_by_names.setdefault(names, []).append(namespace)
    alike = max(namespaces_by_names.values(), key=len, default=[])
    return alike if len(alike) > 1 else []


def _namespace_of(name: str) -> str:
    """Namespace of a topic or joint, as r1 of /r1/odom; "" if there is none."""
    first, _, rest = name.lstrip("/").partition("/")
    return first if rest else ""


def _tracks(surveys: Surveys) -> TrackTopic | None:
    """Guess the track speeds: the first that a guess finds, the surest guess first."""
    named_wheels = partial(_wheel_fields, are_named=True)
    numbered_wheels = partial(_wheel_fields, are_named=False)
    measured = {topic: one for topic, one in surveys.items() if not naming.is_command(topic)}
    for guess in (
        _joints, _topic_pair, named_wheels, _odometry, _driver_pair, numbered_wheels, _twist_fields
    ):  # fmt: skip
        if (tracks := guess(measured)) is not None:
            return tracks
    return None


def _joints(surveys: Surveys) -> TrackTopic | None:
    """Guess a JointState with joints of both sides, by velocities before positions."""
    units: dict[str, TrackUnit] = {"velocity": "rad/s", "position": "rad"}
    for (topic, survey), field in product(_of_types(surveys, ros.JOINT_STATE).items(), units):
        # Messages that have this field for each of their joints.
        states = [one for one in survey.messages if len(getattr(one, field)) == len(one.name)]
        joints = [list(state.name) for state in states]
        # Some drivers publish each wheel in a message of its own.
        all_joints = list(dict.fromkeys(name for names in joints for name in names))
        for left, right in map(naming.sides, (*joints, all_joints)):
            if left and right and not {*left} & {*right}:
                return TrackTopic(topic, left=left, right=right, unit=units[field])
    return None


def _odometry(surveys: Surveys) -> TrackTopic | None:
    """Guess a topic of speed and yaw rate: Odometry before twists, then by its name."""
    of_wheels = {k: one for k, one in surveys.items() if not _is_of_camera(one)}
    topics = _of_types(of_wheels, *BODY_READERS)

    def likelihood(topic: str) -> tuple[bool, bool]:
        is_named = naming.is_of_drive(topic) or naming.ODOMETRY.search(topic.lower()) is not None
        return topics[topic].channel.msgtype == ros.ODOMETRY, is_named

    return TrackTopic(max(topics, key=likelihood)) if topics else None


def _is_of_camera(survey: Survey) -> bool:
    """Test for an odometry by camera or lidar, by its topic and frame."""
    frames = {getattr(one, "child_frame_id", "") for one in survey.messages[:1]}
    return naming.OF_CAMERA.search(" ".join([survey.channel.topic, *frames]).lower()) is not None


def _topic_pair(surveys: Surveys) -> TrackTopic | None:
    """Guess topics of both sides with a number each, as of many encoder boards."""
    for kind, wrap in NUMBERS.items():
        numbers = _of_types(surveys, f"std_msgs/msg/{kind}")
        topics = {topic: topic for topic in numbers if may_be_a_side(numbers[topic])}
        found = naming.wheel_sides(topics)
        if found is not None and found.likelihood.are_named:
            left, right = found.left[0], found.right[0]
            unit = naming.unit_of(left, unknown="rad/s")
            if "Int" in kind:
                unit = {"unit": "counts", "counts_per_turn": ANY_COUNTS, "wrap": wrap}
            return TrackTopic(left, right, left=("data",), right=("data",), **unit)
    return None


def _driver_pair(surveys: Surveys) -> TrackTopic | None:
    """Guess topics of two motor drivers, of one type, by their names or their fields'."""
    by_type: dict[str, list[str]] = {}
    for topic, survey in _special(surveys):
        by_type.setdefault(survey.channel.msgtype, []).append(topic)
    for topics in by_type.values():
        paths = _paths(surveys[topics[0]])
        fields = [path for path in paths if naming.is_of_wheel(path)]
        if naming.is_of_wheel(topics[0]):
            fields += [path for path in paths if path in ("data", "value")]
        found = naming.wheel_sides({topic: topic for topic in topics}, context="wheel")
        if fields and found is not None and (found.likelihood.are_named or len(found.left) == 1):
            field, topic = fields[0], found.left[0]
            named = f"{topic} {field}" if field in ("data", "value") else field
            unit = naming.unit_of(named, unknown="m/s")
            return TrackTopic(topic, found.right[0], left=(field,), right=(field,), **unit)
    return None


def _wheel_fields(surveys: Surveys, *, are_named: bool) -> TrackTopic | None:
    """Guess the likeliest topic with fields of wheels, if names show its sides or not."""
    candidates = []
    for topic, survey in surveys.items():
        is_array = survey.channel.msgtype.endswith("MultiArray")
        if not (is_array or is_special(survey)):
            continue
        paths = _paths(survey)
        names = {path: f"{path} {text}".strip() for path, text in paths.items()}
        if (found := naming.wheel_sides(names, topic)) is not None:
            unit = naming.unit_of(topic if is_array else names[found.left[0]], unknown="m/s")
            tracks = TrackTopic(topic, left=found.left, right=found.right, **unit)
            candidates.append((found.likelihood, tracks))
    if not candidates:
        return None
    likelihood, tracks = max(candidates, key=lambda candidate: candidate[0])
    return tracks if likelihood.are_named == are_named else None


def _twist_fields(surveys: Surveys) -> TrackTopic | None:
    """Guess a topic with fields that are named like a robot's speed and yaw rate."""
    for topic, survey in _special(surveys):
        names = naming.twist_names([*_paths(survey)])
        if names is not None:
            return TrackTopic(topic, speed=names[0], yaw_rate=names[1])
    return None


def _special(surveys: Surveys) -> list[tuple[str, Survey]]:
    """Topics that are no commands, with messages of types that are no standard ones."""
    return [(k, one) for k, one in surveys.items() if is_special(one) and not naming.is_command(k)]


def is_special(survey: Survey) -> bool:
    """Test for messages of a type that is no standard one."""
    return survey.channel.msgtype.split("/")[0] not in STANDARD


def _paths(survey: Survey) -> dict[str, str]:
    """Paths of the numbers of a topic with their texts; none without a message."""
    return number_paths(survey.messages[0]) if survey.messages else {}


def may_be_a_side(survey: Survey) -> bool:
    """Test for a number named like the speed or count of a wheel, on its own topic."""
    parts = survey.channel.msgtype.split("/")
    is_number = parts[0] == "std_msgs" and parts[-1] in NUMBERS
    return is_number and naming.is_of_wheel(survey.channel.topic)


def _measures_rates(survey: Survey) -> bool:
    """Test the samples of an Imu topic for rates that are neither absent nor all zero."""
    measured = (one for one in survey.messages if one.angular_velocity_covariance[0] != ABSENT)
    rates = (message.angular_velocity for message in measured)
    return any((rate.x, rate.y, rate.z) != (0.0, 0.0, 0.0) for rate in rates)


def _measures_forces(survey: Survey) -> bool:
    """Test the samples of an Imu topic for accelerations that are not all zero."""
    rows = (imu_row(message)[3:] for message in survey.messages)
    return any(np.isfinite(row).all() and any(row) for row in rows)


def _heading(surveys: Surveys) -> HeadingTopic | None:
    """Guess an Imu topic with an orientation but no rates, as of two antennas."""
    for topic, survey in _of_types(surveys, ros.IMU).items():
        if _measures_rates(survey):
            continue
        oriented = [one for one in survey.messages if one.orientation_covariance[0] != ABSENT]
        if any(abs(sample.orientation.z) > 0.0 for sample in oriented):
            has_sigma = any(sample.orientation_covariance[8] > 0.0 for sample in oriented)
            return HeadingTopic(topic, sigma=None if has_sigma else naming.PLACEHOLDER_SIGMA)
    return None


def _imu(surveys: Surveys, namespaces: Collection[str] = ()) -> ImuTopic | None:
    """Guess an Imu, best in the `namespaces` of the wheels, or else other messages."""
    imus = _of_types(surveys, ros.IMU)
    counts = {topic: len(one.recorded) for topic, one in imus.items() if _measures_rates(one)}
    if counts:
        topic = max(counts, key=lambda k: (_namespace_of(k) in namespaces, counts[k]))
        forces_topic = None
        if not _measures_forces(imus[topic]):
            others = (k for k in imus if k not in counts and _measures_forces(imus[k]))
            forces_topic = next(others, None)
        return ImuTopic(topic, forces_topic)
    candidates = {}
    for topic, survey in _special(surveys):
        keys = naming.imu_keys([*_paths(survey)])
        if keys and len(keys["angular_velocity"]) == 3:
            candidates[topic] = keys
    if not candidates:
        return None
    topic = max(candidates, key=lambda k: (len(candidates[k]["linear_acceleration"]), k))
    return ImuTopic(topic, **candidates[topic])


def unused_topics(surveys: Collection[Survey], mapping: TopicMap) -> Iterator[str]:
    """Findings on robots, wheels, odometries and positions that a mapping lacks."""
    tracks = mapping.tracks
    if names := robots(surveys):
        yield (
            f"topics of {len(names)} robots ({', '.join(names)}): those of {names[0]} are proposed; for "
            "another, put its topics into the file and inspect again with --overwrite"
        )
    for survey in surveys:
        topic, is_odometry = survey.channel.topic, survey.channel.msgtype == ros.ODOMETRY
        if is_odometry and survey.recorded and _is_of_camera(survey) and mapping.velocity is None:
            yield (
                f"{topic}: an odometry by camera or lidar, which is none of the wheels'; as a "
                f'measurement in addition, topic = "{topic}" in [log.velocity]'
            )
    if tracks is not None and tracks.right_topic is not None:
        sides_of_log = {survey.channel.topic for survey in surveys if may_be_a_side(survey)}
        others = sides_of_log - {tracks.topic, tracks.right_topic}
        quantity = naming.family_of(tracks.topic)
        if wheels := sorted(topic for topic in others if naming.family_of(topic) == quantity):
            yield f"tracks: a topic of each side is read; not used: {', '.join(wheels)}"
    used = {stream.topic for stream in (mapping.fixes, mapping.truth) if stream is not None}
    kinds = (ros.POSE, ros.POSE_WITH_COVARIANCE, ros.NAVSATFIX)
    found = {survey.channel.topic for survey in surveys if survey.channel.msgtype in kinds}
    if positions := sorted(topic for topic in found - used if not naming.is_command(topic)):
        yield f"positions not used: {', '.join(positions)}; a topic of [log.fixes] or [log.truth]?"


def _fixes(surveys: Surveys) -> FixTopic | None:
    """Guess the topic of fixes: measured poses, or else positions on the globe."""
    measured = {topic: one for topic, one in surveys.items() if not naming.is_command(topic)}
    topic = _first_topic(measured, ros.POSE_WITH_COVARIANCE, ros.POSE)
    if topic is not None:
        has_sigma = surveys[topic].channel.msgtype == ros.POSE_WITH_COVARIANCE
    elif (topic := _first_topic(surveys, ros.NAVSATFIX)) is not None:
        has_fix = (one for one in surveys[topic].messages if one.status.status > STATUS_NO_FIX)
        rows = map(GEODETIC_READERS[ros.NAVSATFIX], has_fix)
        has_sigma = any(row is not None and np.isfinite(row[-1]) for row in rows)
    else:
        special = [topic for topic, survey in surveys.items() if is_special(survey)]
        # Receivers first: other places may be those of a filter.
        special.sort(key=lambda topic: not naming.RECEIVER.search(topic.lower()))
        found = ((topic, naming.fix_keys([*_paths(surveys[topic])])) for topic in special)
        return next((FixTopic(topic, **keys) for topic, keys in found if keys), None)
    return FixTopic(topic, position_sigma=None if has_sigma else naming.PLACEHOLDER_SIGMA)


def _truth(surveys: Surveys, tracks: TrackTopic | None) -> TruthTopic | None:
    """Guess the topics of a truth among those named so; `tracks` are as measured."""
    topic = _first_topic(surveys, ros.POSE, ros.POSE_WITH_COVARIANCE, ros.ODOMETRY, ros.NAVSATFIX)
    if topic is None:
        return None
    # True track speeds are read with the names of the joints in [log.tracks].
    has_joint_names = tracks is not None and bool(tracks.left)
    joints = _first_topic(surveys, ros.JOINT_STATE) if has_joint_names else None
    twist, source = _first_topic(surveys, ros.TWIST), _first_topic(surveys, ros.STRING)
    return TruthTopic(topic, twist=twist, tracks=joints, source_topic=source)


def _first_topic(surveys: Surveys, *types: str) -> str | None:
    """First topic of the first of these message types that there is, or None."""
    return next((topic for msgtype in types for topic in _of_types(surveys, msgtype)), None)


def _of_types(surveys: Surveys, *types: str) -> dict[str, Survey]:
    """Topics with messages of these types."""
    return {topic: one for topic, one in surveys.items() if one.channel.msgtype in types}
