"""Guess of the topic map of an unknown bag, by types and names."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import product
from re import Pattern

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

Surveys = Sequence[Survey]  # one of each topic, in the order of their names


def guess_topics(surveys: Iterable[Survey], fixes: str | None = None) -> TopicMap:
    """Guess the topic of each stream; `fixes` is that of the fixes, if it is known.

    Another Imu with an orientation but no rates is a heading. Poses are the truth if the topic is named
    so, otherwise fixes. Streams that were not found are None.
    """
    recorded = sorted((s for s in surveys if s.recorded), key=lambda survey: survey.topic)
    other_robots = robots(recorded)[1:]
    by_topic = {s.topic: s for s in recorded if _namespace_of(s.topic) not in other_robots}
    truths = [survey for survey in by_topic.values() if naming.is_truth(survey.topic)]
    sensors = [survey for survey in by_topic.values() if not naming.is_truth(survey.topic)]
    tracks, heading = _tracks(sensors), _heading(sensors)
    track_names = (tracks.topic, *tracks.left) if tracks else ()
    imu = _imu(sensors, {*map(_namespace_of, track_names)})
    # An odometry that gives track speeds is no fix, too.
    may_be_fixes = [survey for survey in sensors if not tracks or survey.topic != tracks.topic]
    if fixes in by_topic:
        may_be_fixes = [by_topic[fixes]]
    return TopicMap(tracks, imu, _fixes(may_be_fixes), _truth(truths, tracks), heading)


def robots(surveys: Iterable[Survey]) -> list[str]:
    """Namespaces of several robots in one bag; none for the topics of one robot.

    Each robot has an IMU and wheels, on topics of the same names within its namespace.
    """
    by_namespace: dict[str, dict[str, Survey]] = {}
    for survey in surveys:
        by_namespace.setdefault(_namespace_of(survey.topic), {})[survey.topic] = survey
    namespaces_by_names: dict[tuple[str, str], list[str]] = {}
    for namespace in sorted(by_namespace.keys() - {""}):
        own = [*by_namespace[namespace].values()]
        tracks, imu = _tracks(own), _imu(own)
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
    measured = [survey for survey in surveys if not naming.is_command(survey.topic)]
    return (
        _joints(measured)
        or _topic_pair(measured)
        or _wheel_fields(measured, are_named=True)
        or _odometry(measured)
        or _driver_pair(measured)
        or _wheel_fields(measured, are_named=False)
        or _twist_fields(measured)
    )


def _joints(surveys: Surveys) -> TrackTopic | None:
    """Guess a JointState with joints of both sides, by velocities before positions."""
    units: dict[str, TrackUnit] = {"velocity": "rad/s", "position": "rad"}
    for survey, field in product(_of_types(surveys, ros.JOINT_STATE), units):
        # Messages that have this field for each of their joints.
        states = [one for one in survey.messages if len(getattr(one, field)) == len(one.name)]
        joints = [list(state.name) for state in states]
        # Some drivers publish each wheel in a message of its own.
        all_joints = list(dict.fromkeys(name for names in joints for name in names))
        for left, right in map(naming.sides, (*joints, all_joints)):
            if left and right and not {*left} & {*right}:
                return TrackTopic(survey.topic, left=left, right=right, unit=units[field])
    return None


def _odometry(surveys: Surveys) -> TrackTopic | None:
    """Guess a topic of speed and yaw rate: Odometry before twists, then by its name."""
    candidates = [one for one in _of_types(surveys, *BODY_READERS) if not _is_of_camera(one)]

    def likelihood(survey: Survey) -> tuple[bool, bool]:
        name = survey.topic
        is_named = naming.is_of_drive(name) or naming.ODOMETRY.search(name.lower()) is not None
        return survey.msgtype == ros.ODOMETRY, is_named

    return TrackTopic(max(candidates, key=likelihood).topic) if candidates else None


def _is_of_camera(survey: Survey) -> bool:
    """Test for an odometry by camera or lidar, by its topic and frame."""
    frames = [getattr(message, "child_frame_id", "") for message in survey.messages[:1]]
    return naming.OF_CAMERA.search(" ".join([survey.topic, *frames]).lower()) is not None


def _topic_pair(surveys: Surveys) -> TrackTopic | None:
    """Guess topics of both sides with a number each, as of many encoder boards."""
    for kind, wrap in NUMBERS.items():
        numbers = _of_types(surveys, f"std_msgs/msg/{kind}")
        found = naming.wheel_sides({s.topic: s.topic for s in numbers if may_be_a_side(s)})
        if found is not None and found.likelihood.are_named:
            left, right = found.left[0], found.right[0]
            unit = naming.unit_of(left, unknown="rad/s")
            if "Int" in kind:
                unit = {"unit": "counts", "counts_per_turn": ANY_COUNTS, "wrap": wrap}
            return TrackTopic(left, right, left=("data",), right=("data",), **unit)
    return None


def _driver_pair(surveys: Surveys) -> TrackTopic | None:
    """Guess topics of two motor drivers, of one type, by their names or their fields'."""
    by_type: dict[str, list[Survey]] = {}
    for survey in _special(surveys):
        by_type.setdefault(survey.msgtype, []).append(survey)
    for drivers in by_type.values():
        paths = _paths(drivers[0])
        fields = [path for path in paths if naming.is_of_wheel(path)]
        if naming.is_of_wheel(drivers[0].topic):
            fields += [path for path in paths if path in ("data", "value")]
        found = naming.wheel_sides({one.topic: one.topic for one in drivers}, context="wheel")
        if fields and found is not None and (found.likelihood.are_named or len(found.left) == 1):
            field, topic = fields[0], found.left[0]
            named = f"{topic} {field}" if field in ("data", "value") else field
            unit = naming.unit_of(named, unknown="m/s")
            return TrackTopic(topic, found.right[0], left=(field,), right=(field,), **unit)
    return None


def _wheel_fields(surveys: Surveys, *, are_named: bool) -> TrackTopic | None:
    """Guess the likeliest topic with fields of wheels, if names show its sides or not."""
    candidates = []
    for survey in surveys:
        is_array = survey.msgtype.endswith("MultiArray")
        if not (is_array or is_special(survey)):
            continue
        names = {path: f"{path} {text}".strip() for path, text in _paths(survey).items()}
        if (found := naming.wheel_sides(names, survey.topic)) is not None:
            unit_name = survey.topic if is_array else names[found.left[0]]
            unit = naming.unit_of(unit_name, unknown="m/s")
            tracks = TrackTopic(survey.topic, left=found.left, right=found.right, **unit)
            candidates.append((found.likelihood, tracks))
    if not candidates:
        return None
    likelihood, tracks = max(candidates, key=lambda candidate: candidate[0])
    return tracks if likelihood.are_named == are_named else None


def _twist_fields(surveys: Surveys) -> TrackTopic | None:
    """Guess a topic with fields that are named like a robot's speed and yaw rate."""
    for survey in _special(surveys):
        names = naming.twist_names([*_paths(survey)])
        if names is not None:
            return TrackTopic(survey.topic, speed=names[0], yaw_rate=names[1])
    return None


def _special(surveys: Surveys) -> list[Survey]:
    """Topics that are no commands, with messages of types that are no standard ones."""
    return [one for one in surveys if is_special(one) and not naming.is_command(one.topic)]


def is_special(survey: Survey) -> bool:
    """Test for messages of a type that is no standard one."""
    return survey.msgtype.split("/")[0] not in STANDARD


def _paths(survey: Survey) -> dict[str, str]:
    """Paths of the numbers of a topic with their texts; none without a message."""
    return number_paths(survey.messages[0]) if survey.messages else {}


def may_be_a_side(survey: Survey) -> bool:
    """Test for a number named like the speed or count of a wheel, on its own topic."""
    parts = survey.msgtype.split("/")
    is_number = parts[0] == "std_msgs" and parts[-1] in NUMBERS
    return is_number and naming.is_of_wheel(survey.topic)


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
    for survey in _of_types(surveys, ros.IMU):
        if _measures_rates(survey):
            continue
        oriented = [one for one in survey.messages if one.orientation_covariance[0] != ABSENT]
        if any(abs(sample.orientation.z) > 0.0 for sample in oriented):
            has_sigma = any(sample.orientation_covariance[8] > 0.0 for sample in oriented)
            return HeadingTopic(survey.topic, None if has_sigma else naming.PLACEHOLDER_SIGMA)
    return None


def _imu(surveys: Surveys, namespaces: Collection[str] = ()) -> ImuTopic | None:
    """Guess an Imu, best in the `namespaces` of the wheels, or else other messages."""
    imus = _of_types(surveys, ros.IMU)
    gyros = [survey for survey in imus if _measures_rates(survey)]
    if gyros:
        gyro = max(gyros, key=lambda s: (_namespace_of(s.topic) in namespaces, len(s.recorded)))
        if _measures_forces(gyro):
            return ImuTopic(gyro.topic)
        others = (one for one in imus if not _measures_rates(one) and _measures_forces(one))
        return ImuTopic(gyro.topic, next((other.topic for other in others), None))
    candidates = {}
    for survey in _special(surveys):
        keys = naming.imu_keys([*_paths(survey)])
        if keys and len(keys["angular_velocity"]) == 3:
            candidates[survey.topic] = keys
    if candidates:
        topic = max(candidates, key=lambda k: (len(candidates[k]["linear_acceleration"]), k))
        return ImuTopic(topic, **candidates[topic])
    rates = _vectors(surveys, naming.GYRO)
    if rates is None:
        return None
    forces_topic, forces = _vectors(surveys, naming.ACCELEROMETER) or (None, ())
    return ImuTopic(rates[0], forces_topic, angular_velocity=rates[1], linear_acceleration=forces)


def _vectors(surveys: Surveys, pattern: Pattern[str]) -> tuple[str, tuple[str, ...]] | None:
    """Guess a topic with one vector, by its name, and the fields of that."""
    for survey in surveys:
        if survey.msgtype == ros.VECTOR or is_special(survey):
            ends = {path: path.rpartition(".")[2] for path in _paths(survey)}
            names = {f"{survey.topic}_{end}": path for path, end in ends.items() if end in {*"xyz"}}
            axes = naming.axes_of([*names], pattern)
            if len(axes) == len("xyz") and not naming.is_command(survey.topic):
                return survey.topic, tuple(names[axis] for axis in axes)
    return None


def unused_topics(surveys: Surveys, mapping: TopicMap) -> Iterator[str]:
    """Findings on robots, wheels, odometries and positions that a mapping lacks."""
    if names := robots(surveys):
        yield (
            f"topics of {len(names)} robots ({', '.join(names)}): those of {names[0]} are proposed; for "
            "another, put its topics into the file and inspect again with --overwrite"
        )
    for survey in _of_types(surveys, ros.ODOMETRY):
        if survey.recorded and _is_of_camera(survey) and mapping.velocity is None:
            yield (
                f"{survey.topic}: an odometry by camera or lidar, which is none of the wheels'; as a "
                f'measurement in addition, topic = "{survey.topic}" in [log.velocity]'
            )
    tracks = mapping.tracks
    if tracks is not None and tracks.right_topic is not None:
        sides = {survey.topic for survey in surveys if may_be_a_side(survey)}
        others = sides - {tracks.topic, tracks.right_topic}
        quantity = naming.family_of(tracks.topic)
        if wheels := sorted(topic for topic in others if naming.family_of(topic) == quantity):
            yield f"tracks: a topic of each side is read; not used: {', '.join(wheels)}"
    used = {stream.topic for stream in (mapping.fixes, mapping.truth) if stream is not None}
    kinds = ros.POSE, ros.POSE_WITH_COVARIANCE, ros.NAVSATFIX
    unused = {survey.topic for survey in _of_types(surveys, *kinds)} - used
    if positions := sorted(topic for topic in unused if not naming.is_command(topic)):
        yield f"positions not used: {', '.join(positions)}; a topic of [log.fixes] or [log.truth]?"


def _fixes(surveys: Surveys) -> FixTopic | None:
    """Guess the topic of fixes: measured poses, or else positions on the globe."""
    measured = [survey for survey in surveys if not naming.is_command(survey.topic)]
    if (poses := _first_of_types(measured, ros.POSE_WITH_COVARIANCE, ros.POSE)) is not None:
        topic, has_sigma = poses.topic, poses.msgtype == ros.POSE_WITH_COVARIANCE
    elif (receiver := _first_of_types(surveys, ros.NAVSATFIX)) is not None:
        has_fix = (one for one in receiver.messages if one.status.status > STATUS_NO_FIX)
        rows = map(GEODETIC_READERS[ros.NAVSATFIX], has_fix)
        topic = receiver.topic
        has_sigma = any(row is not None and np.isfinite(row[-1]) for row in rows)
    else:
        special = [survey for survey in surveys if is_special(survey)]
        # Receivers first: other places may be those of a filter.
        special.sort(key=lambda survey: not naming.RECEIVER.search(survey.topic.lower()))
        for survey in special:
            if keys := naming.fix_keys([*_paths(survey)]):
                return FixTopic(survey.topic, **keys)
        return None
    return FixTopic(topic, position_sigma=None if has_sigma else naming.PLACEHOLDER_SIGMA)


def _truth(surveys: Surveys, tracks: TrackTopic | None) -> TruthTopic | None:
    """Guess the topics of a truth among those named so; `tracks` are as measured."""

    def first(*types: str) -> str | None:
        survey = _first_of_types(surveys, *types)
        return None if survey is None else survey.topic

    topic = first(ros.POSE, ros.POSE_WITH_COVARIANCE, ros.ODOMETRY, ros.NAVSATFIX)
    if topic is None:
        return None
    # True track speeds are read with the names of the joints in [log.tracks].
    has_joint_names = tracks is not None and bool(tracks.left)
    joints = first(ros.JOINT_STATE) if has_joint_names else None
    return TruthTopic(topic, twist=first(ros.TWIST), tracks=joints, source_topic=first(ros.STRING))


def _first_of_types(surveys: Surveys, *types: str) -> Survey | None:
    """First topic of the first of these message types that there is, or None."""
    return next((survey for kind in types for survey in _of_types(surveys, kind)), None)


def _of_types(surveys: Surveys, *types: str) -> list[Survey]:
    """Topics with messages of these types."""
    return [survey for survey in surveys if survey.msgtype in types]
