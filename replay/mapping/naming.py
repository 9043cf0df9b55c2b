"""Quantities, sides and units that names of topics, fields and columns state."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from icreckon.replay.mapping.track_units import ANY_COUNTS, TrackUnit


def _pattern(part: str, word: str) -> re.Pattern[str]:
    """Pattern of a `part` anywhere in a lower-case name, or of a `word` of it."""
    return re.compile(rf"{part}|(?<![a-z])(?:{word})(?![a-z])")


TRUE = _pattern(r"truth|ground_?(?:pose|odom|state)|mo_?cap|vicon|opti_?track", word="true|gt")
OF_CAMERA = _pattern(  # odometries by camera or lidar instead of wheels
    r"camera|visual|zed|realsense|rtabmap|orb_?slam|vins|lidar|laser|icp", word="vi?o|lio"
)
COMMAND = _pattern(
    r"cmd|command|desired|target|setpoint|demand|request|wanted|initial_?pose"
    r"|reference_?(?:vel|speed|rate)",
    word="ref|sp|set|tgt|req|goal",
)
RECEIVER, ODOMETRY = re.compile("gps|gnss|fix|navpvt"), re.compile("controller|odom")
DRIVE_WORDS = ("wheel", "track", "sprocket", "drive")
# Velocities, but no travel or level; rates, but nothing temperate; counters that begin a word.
SPEED = re.compile(
    r"(?<!tra)(?<!le)vel|speed|(?<!tempe)rate|omega|rpm|(?<![a-z])(?:count|tick|enc)"
)
NO_SPEED = re.compile(  # a current speed is no electric current
    r"current(?!_?(?:vel|speed|rate|rpm))|volt|temp|torque|effort|power|pwm|duty|throttle|error|accel"
)
COUNTER, RATE = re.compile("count|tick|enc"), re.compile("vel|speed|rpm")

# The following are for names as of `plain_name`.
_LINEAR, _ANGULAR, _VELOCITY = r"lin(?:ear)?", r"ang(?:ular)?", r"vel(?:ocity)?"
# Axes of an IMU as gyro_x, imu_angular_velocity_x or w_x; as acc_x, linear_acceleration_x or a_x.
GYRO = re.compile(
    rf"(?:(?:^|_|^imu)(?:gyro?(?:scope)?|{_ANGULAR}_?(?:{_VELOCITY}|rate)|omega|(?:rot(?:ation)?_?)?rate)"
    r"|^(?:imu_?)?[wg]?(?:_rs_s)?)_?([xyz])$"
)
ACCELEROMETER = re.compile(
    rf"(?:(?:^|_)(?:imu|total|{_LINEAR})?acc(?:el(?:eration|erometer)?)?|^(?:imu_?)?a(?:_rs_s)?)"
    r"_?([xyz])$"
)
YAW_RATE = re.compile(rf"(?:^|imu_)(?:yaw_?rate|gyro(?:_?yaw)?|angular_?{_VELOCITY}|omega)$")
# Speed and yaw rate of a robot by its controller; what stands before them must be alike.
FORWARD = re.compile(
    rf"(?:(?:{_LINEAR}|long(?:itudinal)?|forward)_?(?:{_VELOCITY}|speed)(?:_x)?|{_LINEAR}_x|v"
    r"|(?<=_)speed|(?<=_)v_?x)$"
)
TURNING = re.compile(
    rf"(?:{_ANGULAR}_?(?:{_VELOCITY}|speed|rate)(?:_z)?|{_ANGULAR}_z|(?:heading|yaw)_?rate|omega|w"
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

# Units of track speeds by words of a name, of which the first is used: PX4's, ODrive's, others'.
UNIT_WORDS: dict[str, TrackUnit] = {"wheel_speed[": "rad/s", "vel_estimate": "turns/s"}
UNIT_WORDS |= {"dist": "m", "rpm": "rpm", "/min": "rpm", "rad": "rad/s", "deg": "deg/s"}
UNIT_WORDS |= {"mm": "mm/s", "km": "km/h"}
PLACEHOLDER_SIGMA = 0.05  # of fixes without a covariance [m], of headings [rad]; to be replaced
CAPITAL = re.compile(r"(?<=[a-z])(?=[A-Z])")  # places where a word begins in a name as encL
LEFT = {"l", "vl", "wl", "lw", "lwheel", "fl", "ml", "rl", "bl", "lf", "lm", "lr", "lb", "hl"}
RIGHT = {"r", "vr", "wr", "rw", "rwheel", "fr", "mr", "rr", "br", "rf", "rm", "rb", "hr"}


def is_truth(name: str) -> bool:
    """Test for the name of a truth's topic or column."""
    return TRUE.search(name.lower()) is not None


def is_command(name: str) -> bool:
    """Test for the name of a topic or column of commands instead of measurements."""
    return COMMAND.search(name.lower()) is not None


def is_of_drive(name: str) -> bool:
    """Test for the name of a part of the drive, such as a wheel."""
    return any(word in name.lower() for word in DRIVE_WORDS)


def is_of_wheel(name: str) -> bool:
    """Test for the name of a measured speed or count of a wheel."""
    is_wheel = is_of_drive(name) or SPEED.search(name.lower()) is not None
    return is_wheel and not NO_SPEED.search(name.lower()) and not is_command(name)


def is_counter(name: str) -> bool:
    """Test for the name of a cumulative counter, as of encoder ticks."""
    return COUNTER.search(name.lower()) is not None and not RATE.search(name.lower())


def in_degrees(name: str) -> bool:
    """Test a name for a unit of degrees, or degrees per second."""
    return any(word in name.lower() for word in ("deg", "dps", "°"))


def unit_of(name: str, unknown: TrackUnit) -> dict[str, Any]:
    """Unit of track speeds by a word of a name, as keys of `TrackKeys`."""
    # `unknown` is the unit without such a word. A person fills in the counts per turn.
    if is_counter(name):
        return {"unit": "counts", "counts_per_turn": ANY_COUNTS}
    units = (unit for word, unit in UNIT_WORDS.items() if word in name.lower())
    return {"unit": next(units, unknown)}


def plain_name(name: str) -> str:
    """Lower-case name without its unit: acc_x for `Acc x [m/s²]` and `acc_g[0]`."""
    if element := ELEMENT.match(name):
        return f"{plain_name(element[1])}_{'xyz'[int(element[2])]}"
    without_brackets = re.sub(r"[\[(].*", "", name.lower()).strip()
    return UNIT.sub("", re.sub(r"\W+", "_", without_brackets))


def first_like(names: Sequence[str], pattern: re.Pattern[str]) -> str | None:
    """First name that has the pattern, lower-case and without its unit."""
    return next((name for name in names if pattern.search(plain_name(name))), None)


def axes_of(names: Sequence[str], pattern: re.Pattern[str]) -> tuple[str, ...]:
    """Names of the axes x, y, z, of z alone if there is no x, or none."""
    found = ((pattern.search(plain_name(name)), name) for name in names)
    by_axis = {match[1]: name for match, name in found if match}  # the group of the pattern
    if by_axis.keys() >= set("xyz"):
        return by_axis["x"], by_axis["y"], by_axis["z"]
    return (by_axis["z"],) if "z" in by_axis and "x" not in by_axis else ()


def imu_keys(names: Sequence[str]) -> dict[str, Any] | None:
    """Keys of [log.imu] by the names of rates, or a yaw rate alone, and of forces."""
    # Bare x, y and z are a position rather than rates.
    named = [name for name in names if len(plain_name(name)) > 1]
    yaw_rate, forces = first_like(names, YAW_RATE), axes_of(named, ACCELEROMETER)
    rates = axes_of(named, GYRO) or (() if yaw_rate is None else (yaw_rate,))
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


def sides(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Select the joints of the left and the right side, by their names.

    If no name has the words left or right, abbreviations count, after what all names begin with (r1/).
    Of a side with names of wheels or tracks, those alone are selected, so not the joints of an arm.
    """
    are_in_words = any(side in name.lower() for name in names for side in ("left", "right"))
    unlike = (k for k, letters in enumerate(zip(*names, strict=False)) if len({*letters}) > 1)
    common = "".join(names[:1])[: next(unlike, 0)]
    start = len(re.sub(r"[^\W_]*\Z", "", common))

    def on_side(side: str, abbreviations: set[str]) -> tuple[str, ...]:
        if are_in_words:
            joints = [name for name in names if side in name.lower()]
        else:
            words_of = {name: CAPITAL.sub("_", name[start:]).lower() for name in names}
            joints = [k for k in names if abbreviations & {*re.split("[^a-z]+", words_of[k])}]
        return tuple(filter(is_of_drive, joints)) or tuple(joints)

    return on_side("left", LEFT), on_side("right", RIGHT)


class Likelihood(NamedTuple):
    """Signs that names are those of wheel speeds, in the order of their weight."""

    are_named: bool  # False if nothing shows the sides: the first half is put to the left
    is_speed: bool  # whether the names have a word of speeds or counts
    has_unit: bool
    is_rate: bool  # False for counters


class Sides(NamedTuple):
    """Names of one quantity of the wheels of both sides."""

    left: tuple[str, ...]
    right: tuple[str, ...]
    likelihood: Likelihood


def wheel_sides(names: Mapping[str, str], context: str = "") -> Sides | None:
    """Select the wheels of both sides, by names that differ in side or number alone.

    `names` are those of paths or columns, with further texts; `context` is that of all. Which of
    numbers is left differs: 0 is the right wheel of PX4. None without two sides.
    """
    families: dict[str, dict[str, str]] = {}
    for path, name in names.items():
        if is_of_wheel(f"{context} {name}"):
            families.setdefault(family_of(name), {})[name] = path
    found = (_sides_of(*family, is_of_wheel(context)) for family in families.items())
    return max(filter(None, found), key=lambda one: one.likelihood, default=None)


def family_of(name: str) -> str:
    """Name without sides, places and numbers, as #_#_wheel_speed."""
    words = CAPITAL.sub("_", name).lower()
    words = re.sub(r"left|right|front|rear|back|mid(?:dle)?|\d+", "#", words)
    return re.sub("[a-z]+", lambda word: "#" if word[0] in LEFT | RIGHT else word[0], words)


def _sides_of(quantity: str, paths: Mapping[str, str], is_wheel: bool) -> Sides | None:
    """Split the paths of a quantity by their names; in halves without sides."""
    names = tuple(paths)
    left, right = sides(names)
    are_named, is_speed = bool(left or right), SPEED.search(quantity) is not None
    has_unit = any(word in quantity for word in UNIT_WORDS)
    if not are_named and len(names) % 2 == 0 and (is_speed or has_unit or is_wheel):
        left, right = names[: len(names) // 2], names[len(names) // 2 :]
    if not left or len(left) != len(right) or {*left} & {*right}:
        return None
    on_left, on_right = (tuple(paths[name] for name in side) for side in (left, right))
    likelihood = Likelihood(are_named, is_speed, has_unit, not is_counter(quantity))
    return Sides(on_left, on_right, likelihood)
