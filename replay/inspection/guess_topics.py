"""Guess of the topic map of an unknown bag, by types and names."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
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
from icreckon.replay.reading.message_rows import GEODETIC_READERS, STATUS_NO_FIX, imu_row
from icreckon.replay.reading.stream import ABSENT

DRIVE_WORDS = ("wheel", "track", "sprocket", "drive")
CAPITAL = re.compile(r"(?<=[a-z])(?=[A-Z])")  # places where a word begins in a name as encL
LEFT = {"l", "vl", "wl", "lwheel", "fl", "ml", "rl", "bl", "lf", "lm", "lr", "lb"}
RIGHT = {"r", "vr", "wr", "rwheel", "fr", "mr", "rr", "br", "rf", "rm", "rb"}
TRUE = re.compile(
    r"truth|ground_?(?:pose|odom|state)|mo_?cap|vicon|opti_?track|(?<![a-z])(?:true|gt)(?![a-z])"
)
# Topics and frames of odometries that are none of the wheels'.
OF_CAMERA = re.compile(
    r"camera|visual|zed|realsense|rtabmap|orb_?slam|vins|lidar|laser|icp|(?<![a-z])(?:vi?o|lio)(?![a-z])"
)
COMMAND = re.compile(
    r"cmd|command|desired|target|setpoint|demand|request|wanted|initial_?pose"
    r"|reference_?(?:vel|speed|rate)|(?<![a-z])(?:ref|sp|set|tgt|req|goal)(?![a-z])"
)
SPEED = re.compile(
    r"(?<!tra)(?<!le)vel|speed|(?<!tempe)rate|omega|rpm|(?<![a-z])(?:count|tick|enc)"
)
NO_SPEED = re.compile(
    r"current(?!_?(?:vel|speed|rate|rpm))|volt|temp|torque|effort|power|pwm|duty|throttle|error|accel"
)
GYRO = re.compile(
    r"(?:(?:^|_|^imu)(?:gyro?(?:scope)?|ang(?:ular)?_?(?:vel(?:ocity)?|rate)|omega)|^(?:imu_?)?[wg]?(?:_rs_s)?)"
    r"_?([xyz])$"
)
ACCELEROMETER = re.compile(
    r"(?:(?:^|_)(?:imu|total|lin(?:ear)?)?acc(?:el(?:eration|erometer)?)?|^(?:imu_?)?a(?:_rs_s)?)_?([xyz])$"
)
YAW_RATE = re.compile(r"(?:^|imu_)(?:yaw_?rate|gyro(?:_?yaw)?|angular_?vel(?:ocity)?|omega)$")
# Speed and yaw rate of a robot by its controller; what stands before them must be alike.
FORWARD = re.compile(
    r"(?:(?:lin(?:ear)?|long(?:itudinal)?|forward)_?(?:vel(?:ocity)?|speed)(?:_x)?|lin(?:ear)?_x|v"
    r"|(?<=_)speed|(?<=_)v_?x)$"
)
TURNING = re.compile(
    r"(?:ang(?:ular)?_?(?:vel(?:ocity)?|speed|rate)(?:_z)?|ang(?:ular)?_z|(?:heading|yaw)_?rate|omega|w"
    r"|(?<=_)w_?z)$"
)
LATITUDE, LONGITUDE, ALTITUDE = (
    re.compile(rf"(^|_)({words})(_deg|_msl)?$")
    for words in ("lat(itude)?", "lon(g|gitude)?|lng", "alt(itude)?")
)
ACCURACY = re.compile(
    r"^(horizontal_?accuracy|h_?acc(uracy)?|eph|position_?(sigma|std|accuracy_x))$"
)
UNIT = re.compile(r"_(?:m?dps|mps2?|m?g|(?:m|deg|rad)(?:_?s_?2?)?|[num]?s(?:ec)?)$")
ELEMENT = re.compile(r"(.*)\[([012])\]$")  # name of an element of a vector, as gyro_rad[0]
RECEIVER = re.compile("gps|gnss|fix|navpvt")
COUNTER, RATE = re.compile("count|tick|enc"), re.compile("vel|speed|rpm")
UNIT_WORDS: tuple[tuple[str, TrackUnit], ...] = (
    ("wheel_speed[", "rad/s"),  # of PX4
    ("vel_estimate", "turns/s"),  # of ODrive
    ("dist", "m"),
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


def guess_topics(surveys: Iterable[Survey], fixes: str | None = None) -> TopicMap:
    """Guess the topic of each stream; `fixes` is that of the fixes, if it is known.

    Track speeds come from a JointState with velocities of left and right joints, from two topics with
    a number each, from numbers of another message by their names, or else from an odometry. The IMU is
    the fastest topic that measures rates; another Imu with an orientation but no rates is a heading.
    Poses are the truth if the topic is named so, otherwise fixes. Streams that were not found are None.
    """
    recorded = sorted((one for one in surveys if one.recorded), key=lambda one: one.channel.topic)
    others = robots(recorded)[1:]
    recorded = [one for one in recorded if _namespace(one) not in others]
    by_topic = {survey.channel.topic: survey for survey in recorded}
    truths = {topic: survey for topic, survey in by_topic.items() if is_truth(topic)}
    sensors = {topic: survey for topic, survey in by_topic.items() if not is_truth(topic)}
    tracks, heading = _tracks(sensors), _heading(sensors)
    imu = _imu(
        sensors, {_first_of(name) for name in (tracks.topic, *tracks.left)} if tracks else ()
    )
    if tracks:
        del sensors[tracks.topic]  # an odometry that gives track speeds is no fix, too
    if fixes in by_topic:
        sensors = {fixes: by_topic[fixes]}
    return TopicMap(tracks, imu, _fixes(sensors), _truth(truths, tracks), heading)


def robots(surveys: Iterable[Survey]) -> list[str]:
    """Namespaces of several robots in one bag; none for the topics of one robot.

    Each has an IMU and wheels on topics of the same names.
    """
    by_namespace: dict[str, dict[str, Survey]] = {}
    for survey in surveys:
        by_namespace.setdefault(_namespace(survey), {})[survey.channel.topic] = survey
    found: dict[tuple[str, str], list[str]] = {}
    for namespace in sorted(by_namespace.keys() - {""}):
        tracks, imu = _tracks(by_namespace[namespace]), _imu(by_namespace[namespace])
        if tracks and imu:
            names = tracks.topic.replace(namespace, "", 1), imu.topic.replace(namespace, "", 1)
            found.setdefault(names, []).append(namespace)
    most = max(found.values(), key=len, default=[])
    return most if len(most) > 1 else []


def _namespace(survey: Survey) -> str:
    return _first_of(survey.channel.topic)


def _first_of(name: str) -> str:
    """First of several names, as r1 of /r1/odom; "" if there is one name."""
    first, _, rest = name.lstrip("/").partition("/")
    return first if rest else ""


def sides(names: list[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Select the joints of the left and the right side, by their names."""
    # Of a side with names of wheels or tracks (`DRIVE_WORDS`), those alone, so not those of an arm.
    # Abbreviations count where no name has the words, and not in the words that all have, as r1/.
    is_in_words = any("left" in one.lower() or "right" in one.lower() for one in names)
    unlike = (k for k, letters in enumerate(zip(*names, strict=False)) if len({*letters}) > 1)
    common = "".join(names[:1])[: next(unlike, 0)]
    start = max((k + 1 for k, letter in enumerate(common) if not letter.isalnum()), default=0)

    def on_side(side: str, abbreviations: set[str]) -> tuple[str, ...]:
        joints, driving = [], []
        for name in names:
            lower, words = name.lower(), CAPITAL.sub("_", name[start:]).lower()
            is_short = not is_in_words and abbreviations & set(re.split(r"[^a-z]+", words))
            if side in lower or is_short:
                joints.append(name)
                if any(word in lower for word in DRIVE_WORDS):
                    driving.append(name)
        return tuple(driving or joints)

    return on_side("left", LEFT), on_side("right", RIGHT)


class Sides(NamedTuple):
    """Names of one quantity of the wheels of both sides."""

    left: tuple[str, ...]
    right: tuple[str, ...]
    are_named: bool  # False if nothing shows which is which: the first half is put to the left
    rank: tuple[bool, ...]  # the larger, the likelier it is the speed of the wheels


def wheel_sides(names: Mapping[str, str], context: str = "") -> Sides | None:
    """Select the wheels of both sides, by names that differ in side or number alone.

    `names` are those of paths or columns, with further texts; `context` is that of all. Which of
    numbers is left differs: 0 is the right wheel of PX4. None without two sides.
    """
    families: dict[str, dict[str, str]] = {}
    for path, name in names.items():
        if is_of_wheel(f"{context} {name}"):
            families.setdefault(_quantity(name), {})[name] = path
    found: list[Sides] = []
    for quantity, family in families.items():
        left, right = sides([*family])
        is_speed, are_named = SPEED.search(quantity) is not None, bool(left or right)
        has_unit = any(word in quantity for word, _ in UNIT_WORDS)
        half, rest = divmod(len(family), 2)
        if not are_named and not rest and (is_speed or has_unit or is_of_wheel(context)):
            left, right = (*family,)[:half], (*family,)[half:]
        if left and len(left) == len(right) and not {*left} & {*right}:
            is_counter = COUNTER.search(quantity) and not RATE.search(quantity)
            rank = are_named, is_speed, has_unit, not is_counter
            on_left, on_right = (tuple(family[name] for name in side) for side in (left, right))
            found.append(Sides(on_left, on_right, are_named, rank))
    return max(found, key=lambda one: one.rank, default=None)


def _quantity(name: str) -> str:
    """Remove sides, places and numbers from a name, as in #_#_wheel_speed."""
    words = CAPITAL.sub("_", name).lower()
    words = re.sub(r"left|right|front|rear|back|mid(?:dle)?|\d+", "#", words)
    return re.sub("[a-z]+", lambda word: "#" if word[0] in LEFT | RIGHT else word[0], words)


def twist_names(names: Sequence[str]) -> tuple[str, str] | None:
    """Names of the speed and the yaw rate of a robot, or None."""
    found: dict[tuple[str, bool], str] = {}
    for name in names:
        plain = plain_name(name)
        for pattern in (FORWARD, TURNING):
            if match := pattern.search(plain):
                found.setdefault((plain[: match.start()], pattern is FORWARD), name)
    pairs = ((found[start, True], found.get((start, False))) for start, ahead in found if ahead)
    return next(((speed, turning) for speed, turning in pairs if turning), None)


def imu_keys(names: Sequence[str]) -> dict[str, Any] | None:
    """Keys of [log.imu] by the names of rates, or a yaw rate alone, and of forces."""
    # Bare x, y and z are a position rather than rates.
    named = [name for name in names if len(plain_name(name)) > 1]
    rates, forces = axes_of(named, GYRO), axes_of(named, ACCELEROMETER)
    yaw_rate = first_like(names, YAW_RATE)
    if not rates and yaw_rate is not None:
        rates = (yaw_rate,)
    if not rates:
        return None
    keys = {"angular_velocity": rates, "linear_acceleration": forces if len(forces) == 3 else ()}
    rate_unit = "deg/s" if any(map(in_degrees, rates)) else "rad/s"
    rate_unit = "mdps" if any("mdps" in name.lower() for name in rates) else rate_unit
    is_in_mg = any(name.lower().endswith("_mg") for name in forces)
    return keys | {"rate_unit": rate_unit, "acceleration_unit": "mg" if is_in_mg else "m/s2"}


def fix_keys(names: Sequence[str]) -> dict[str, Any] | None:
    """Keys of [log.fixes] by the names of places on the globe and their accuracy."""
    latitude, longitude = first_like(names, LATITUDE), first_like(names, LONGITUDE)
    if latitude is None or longitude is None:
        return None
    accuracy = first_like(names, ACCURACY)
    keys = {"latitude": latitude, "longitude": longitude, "altitude": first_like(names, ALTITUDE)}
    return keys | {"sigma": accuracy, "position_sigma": None if accuracy else PLACEHOLDER_SIGMA}


def plain_name(name: str) -> str:
    """Lower-case name without its unit: acc_x for `Acc x [m/s²]` and `acc_g[0]`."""
    if element := ELEMENT.match(name):
        return f"{plain_name(element[1])}_{'xyz'[int(element[2])]}"
    without_brackets = re.sub(r"[\[(].*", "", name.lower()).strip()
    return UNIT.sub("", re.sub(r"\W+", "_", without_brackets))


def axes_of(names: Sequence[str], pattern: re.Pattern[str]) -> tuple[str, ...]:
    """Names of the axes x, y, z, of z alone if there is no x, or none."""
    # The group of the pattern is the axis.
    by_axis = {}
    for name in names:
        if match := pattern.search(plain_name(name)):
            by_axis[match.group(1)] = name
    if by_axis.keys() >= set("xyz"):
        return by_axis["x"], by_axis["y"], by_axis["z"]
    return (by_axis["z"],) if "z" in by_axis and "x" not in by_axis else ()


def first_like(names: Sequence[str], pattern: re.Pattern[str]) -> str | None:
    """First name that has the pattern, lower-case and without its unit."""
    return next((name for name in names if pattern.search(plain_name(name))), None)


def in_degrees(name: str) -> bool:
    """Test a name for a unit of degrees, or degrees per second."""
    return any(word in name.lower() for word in ("deg", "dps", "°"))


def is_truth(topic: str) -> bool:
    """Test for a topic or column of the truth, by its name."""
    return TRUE.search(topic.lower()) is not None


def is_command(topic: str) -> bool:
    """Test for a topic or column of commands instead of measurements, by its name."""
    return COMMAND.search(topic.lower()) is not None


def _tracks(surveys: Mapping[str, Survey]) -> TrackTopic | None:
    """Guess the track speeds: joints, two topics, fields, or else an odometry."""
    for topic, survey in _of_types(surveys, ros.JOINT_STATE).items():
        if is_command(topic):
            continue
        units: dict[str, TrackUnit] = {"velocity": "rad/s", "position": "rad"}
        for values, unit in units.items():
            states = survey.messages
            joints = [
                list(one.name) for one in states if len(getattr(one, values)) == len(one.name)
            ]
            # Some drivers publish each wheel in a message of its own.
            all_joints = list(dict.fromkeys(name for names in joints for name in names))
            for names in (*joints, all_joints):
                left, right = sides(names)
                if left and right and not {*left} & {*right}:
                    return TrackTopic(topic, left=left, right=right, unit=unit)
    if (pair := _topic_pair(surveys)) is not None:
        return pair
    by_fields, sides_of_fields = _wheel_fields(surveys) or (None, None)
    if sides_of_fields is not None and sides_of_fields.are_named:
        return by_fields
    candidates = [
        topic
        for topic, survey in _of_types(surveys, *ros.OF_A_BODY).items()
        if not (is_command(topic) or _is_of_camera(survey))
    ]

    def likelihood(topic: str) -> tuple[bool, bool]:
        words = (*DRIVE_WORDS, "controller", "odom")
        is_named = any(word in topic.lower() for word in words)
        return surveys[topic].channel.msgtype == ros.ODOMETRY, is_named

    if candidates:
        return TrackTopic(max(candidates, key=likelihood))
    return _driver_pair(surveys) or by_fields or _twist_fields(surveys)


def _is_of_camera(survey: Survey) -> bool:
    """Test for an odometry by camera or lidar, by its topic and frame."""
    frames = {getattr(one, "child_frame_id", "") for one in survey.messages[:1]}
    return OF_CAMERA.search(" ".join([survey.channel.topic, *frames]).lower()) is not None


def _topic_pair(surveys: Mapping[str, Survey]) -> TrackTopic | None:
    """Guess topics of both sides with a number each, as of many encoder boards."""
    for kind, wrap in NUMBERS.items():
        numbers = _of_types(surveys, f"std_msgs/msg/{kind}")
        found = wheel_sides({topic: topic for topic in numbers if may_be_a_side(numbers[topic])})
        if found is not None and found.are_named:
            pair = TrackTopic(found.left[0], found.right[0], left=("data",), right=("data",))
            if "Int" in kind:
                return replace(pair, unit="counts", counts_per_turn=ANY_COUNTS, wrap=wrap)
            return replace(pair, **unit_of(pair.topic, unknown="rad/s"))
    return None


def _driver_pair(surveys: Mapping[str, Survey]) -> TrackTopic | None:
    """Guess topics of two motor drivers, of one type, by their names or their fields'."""
    by_type: dict[str, list[str]] = {}
    for topic, survey in _special(surveys):
        by_type.setdefault(survey.channel.msgtype, []).append(topic)
    for topics in by_type.values():
        paths = _paths(surveys[topics[0]])
        fields = [path for path in paths if is_of_wheel(path)]
        if is_of_wheel(topics[0]):
            fields += [path for path in paths if path in ("data", "value")]
        found = wheel_sides({topic: topic for topic in topics}, context="wheel")
        if fields and found is not None and (found.are_named or len(found.left) == 1):
            pair = TrackTopic(found.left[0], found.right[0], left=(fields[0],), right=(fields[0],))
            name = f"{pair.topic} {fields[0]}" if fields[0] in ("data", "value") else fields[0]
            return replace(pair, **unit_of(name, unknown="m/s"))
    return None


def _wheel_fields(surveys: Mapping[str, Survey]) -> tuple[TrackTopic, Sides] | None:
    """Guess a topic with fields that are named like speeds or counts of the wheels."""
    candidates = []
    for topic, survey in surveys.items():
        is_array = survey.channel.msgtype.endswith("MultiArray")
        if not (is_array or is_special(survey)) or is_command(topic):
            continue
        paths = _paths(survey)
        names = {path: f"{path} {text}".strip() for path, text in paths.items()}
        if (found := wheel_sides(names, topic)) is None:
            continue
        unit = unit_of(topic if is_array else names[found.left[0]], unknown="m/s")
        track = TrackTopic(topic, left=found.left, right=found.right)
        candidates.append((replace(track, **unit), found))
    return max(candidates, key=lambda one: one[1].rank, default=None)


def _twist_fields(surveys: Mapping[str, Survey]) -> TrackTopic | None:
    """Guess a topic with fields that are named like a robot's speed and yaw rate."""
    for topic, survey in _special(surveys):
        names = twist_names([*_paths(survey)])
        if names is not None:
            return TrackTopic(topic, speed=names[0], yaw_rate=names[1])
    return None


def _special(surveys: Mapping[str, Survey]) -> list[tuple[str, Survey]]:
    """Topics that are no commands, with messages of types that are no standard ones."""
    return [(k, one) for k, one in surveys.items() if is_special(one) and not is_command(k)]


def is_special(survey: Survey) -> bool:
    """Test for messages of a type that is no standard one."""
    return survey.channel.msgtype.split("/")[0] not in STANDARD


def _paths(survey: Survey) -> dict[str, str]:
    """Paths of the numbers of a topic with their texts; none without a message."""
    return number_paths(survey.messages[0]) if survey.messages else {}


def unit_of(name: str, unknown: TrackUnit) -> dict[str, Any]:
    """Unit of track speeds by a word of a name, as keys of `TrackKeys`."""
    # `unknown` is the unit without such a word. A person fills in the counts per turn.
    name = name.lower()
    if COUNTER.search(name) and not RATE.search(name):
        return {"unit": "counts", "counts_per_turn": ANY_COUNTS}
    return {"unit": next((unit for word, unit in UNIT_WORDS if word in name), unknown)}


def may_be_a_side(survey: Survey) -> bool:
    """Test for a number named like the speed or count of a wheel, on its own topic."""
    parts = survey.channel.msgtype.split("/")
    is_number = parts[0] == "std_msgs" and parts[-1] in NUMBERS
    return is_number and is_of_wheel(survey.channel.topic)


def is_of_wheel(name: str) -> bool:
    """Test for the name of a measured speed or count of a wheel."""
    name = name.lower()
    is_wheel = any(word in name for word in DRIVE_WORDS) or SPEED.search(name) is not None
    return is_wheel and not NO_SPEED.search(name) and not is_command(name)


def _measures_rates(survey: Survey) -> bool:
    """Test the samples of an Imu topic for rates that are neither absent nor all zero."""
    for message in survey.messages:
        rate, is_absent = message.angular_velocity, message.angular_velocity_covariance[0] == ABSENT
        if not is_absent and (rate.x, rate.y, rate.z) != (0.0, 0.0, 0.0):
            return True
    return False


def _measures_forces(survey: Survey) -> bool:
    """Test the samples of an Imu topic for accelerations, likewise."""
    rows = (imu_row(message)[3:] for message in survey.messages)
    return any(np.isfinite(row).all() and any(row) for row in rows)


def _heading(surveys: Mapping[str, Survey]) -> HeadingTopic | None:
    """Guess an Imu topic with an orientation but no rates, as of two antennas."""
    for topic, survey in _of_types(surveys, ros.IMU).items():
        if _measures_rates(survey):
            continue
        samples = survey.messages
        oriented = [sample for sample in samples if sample.orientation_covariance[0] != ABSENT]
        if any(abs(sample.orientation.z) > 0.0 for sample in oriented):
            has_sigma = any(sample.orientation_covariance[8] > 0.0 for sample in oriented)
            return HeadingTopic(topic, sigma=None if has_sigma else PLACEHOLDER_SIGMA)
    return None


def _imu(surveys: Mapping[str, Survey], namespaces: Collection[str] = ()) -> ImuTopic | None:
    """Guess the Imu topic with most rates, and a topic of accelerations alone.

    Those in the namespaces of the wheels come first.

    Without an Imu, fields of another type that are named like three rates, and forces.
    """
    imus = _of_types(surveys, ros.IMU)
    counts = {topic: len(one.recorded) for topic, one in imus.items() if _measures_rates(one)}
    if counts:
        topic = max(counts, key=lambda topic: (_first_of(topic) in namespaces, counts[topic]))
        apart = (one for one in imus if one not in counts and _measures_forces(imus[one]))
        return ImuTopic(topic, None if _measures_forces(imus[topic]) else next(apart, None))
    found: list[tuple[int, str, dict[str, Any]]] = []
    for topic, survey in _special(surveys):
        keys = imu_keys([*_paths(survey)])
        if keys is not None and len(keys["angular_velocity"]) == len("xyz"):
            found.append((len(keys["linear_acceleration"]), topic, keys))
    if found:
        _, topic, keys = max(found, key=lambda one: one[:2])
        return ImuTopic(topic, **keys)
    gyro, accelerometer = (_vectors(surveys, pattern) for pattern in (GYRO, ACCELEROMETER))
    if gyro is None:
        return None
    forces_topic, forces = accelerometer or (None, ())
    return ImuTopic(gyro[0], forces_topic, angular_velocity=gyro[1], linear_acceleration=forces)


def _vectors(
    surveys: Mapping[str, Survey], pattern: re.Pattern[str]
) -> tuple[str, tuple[str, ...]] | None:
    """Guess a topic with one vector, by its name, and the fields of that."""
    for topic, survey in surveys.items():
        if survey.channel.msgtype == ros.VECTOR or is_special(survey):
            ends = {path: path.rpartition(".")[2] for path in _paths(survey)}
            names = {f"{topic}_{end}": path for path, end in ends.items() if end in {*"xyz"}}
            axes = axes_of([*names], pattern)
            if len(axes) == len("xyz") and not is_command(topic):
                return topic, tuple(names[axis] for axis in axes)
    return None


def unused_topics(surveys: Collection[Survey], mapping: TopicMap) -> Iterator[str]:
    """Findings on robots, wheels, odometries and positions that a mapping lacks."""
    tracks = mapping.tracks
    if names := robots(surveys):
        yield (
            f"topics of {len(names)} robots ({', '.join(names)}): those of {names[0]} are proposed; for "
            "another, put its topics into the file and inspect again with --overwrite"
        )
    odometries = (one for one in surveys if one.channel.msgtype == ros.ODOMETRY and one.recorded)
    for survey in odometries:
        topic = survey.channel.topic
        if _is_of_camera(survey) and mapping.velocity is None:
            yield (
                f"{topic}: an odometry by camera or lidar, which is none of the wheels'; as a "
                f'measurement in addition, topic = "{topic}" in [log.velocity]'
            )
    if tracks is not None and tracks.right_topic is not None:
        sides_of_log = {survey.channel.topic for survey in surveys if may_be_a_side(survey)}
        others = sides_of_log - {tracks.topic, tracks.right_topic}
        quantity = _quantity(tracks.topic)
        if wheels := sorted(topic for topic in others if _quantity(topic) == quantity):
            yield f"tracks: a topic of each side is read; not used: {', '.join(wheels)}"
    used = {stream.topic for stream in (mapping.fixes, mapping.truth) if stream is not None}
    kinds = (ros.POSE, ros.POSE_WITH_COVARIANCE, ros.NAVSATFIX)
    found = {survey.channel.topic for survey in surveys if survey.channel.msgtype in kinds}
    if positions := sorted(topic for topic in found - used if not is_command(topic)):
        text = f"positions not used: {', '.join(positions)}"
        yield f"{text}; a topic of [log.fixes] or [log.truth]?"


def _fixes(surveys: Mapping[str, Survey]) -> FixTopic | None:
    """Guess the topic of fixes: measured poses, or else positions on the globe."""
    measured = {topic: one for topic, one in surveys.items() if not is_command(topic)}
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
        special.sort(key=lambda topic: not RECEIVER.search(topic.lower()))
        found = ((topic, fix_keys([*_paths(surveys[topic])])) for topic in special)
        return next((FixTopic(topic, **keys) for topic, keys in found if keys), None)
    return FixTopic(topic, position_sigma=None if has_sigma else PLACEHOLDER_SIGMA)


def _truth(surveys: Mapping[str, Survey], tracks: TrackTopic | None) -> TruthTopic | None:
    """Guess the topics of a truth among those named so; `tracks` are as measured."""
    poses = (ros.POSE, ros.POSE_WITH_COVARIANCE, ros.ODOMETRY, ros.NAVSATFIX)
    topic = _first_topic(surveys, *poses)
    if topic is None:
        return None
    # True track speeds are read with the names of the joints in [log.tracks].
    has_joint_names = tracks is not None and bool(tracks.left)
    joints = _first_topic(surveys, ros.JOINT_STATE) if has_joint_names else None
    twist, source = _first_topic(surveys, ros.TWIST), _first_topic(surveys, ros.STRING)
    return TruthTopic(topic, twist=twist, tracks=joints, source_topic=source)


def _first_topic(surveys: Mapping[str, Survey], *types: str) -> str | None:
    """First topic of the first of these message types that there is, or None."""
    return next((topic for msgtype in types for topic in _of_types(surveys, msgtype)), None)


def _of_types(surveys: Mapping[str, Survey], *types: str) -> dict[str, Survey]:
    """Topics with messages of these types."""
    return {topic: one for topic, one in surveys.items() if one.channel.msgtype in types}
