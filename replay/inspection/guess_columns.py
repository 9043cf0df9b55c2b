"""Guess of the column map of an unknown table, by the names of its columns."""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from icreckon.replay.base.errors import ReplayError
from icreckon.replay.estimates.imu_mounting import NO_GRAVITY
from icreckon.replay.mapping import naming
from icreckon.replay.mapping.columns import (
    AngleUnit,
    ColumnMap,
    ImuColumns,
    PoseColumns,
    TimeUnit,
    TrackColumns,
)
from icreckon.replay.mapping.track_units import counter_range
from icreckon.replay.reading.conversions import jumps_by_360
from icreckon.replay.reading.tables import Table

TIME = re.compile(
    r"^(t|time|times|timestamp|stamp|date|datetime|utc|sec|seconds|millis|micros|ms|us)$"
)
TIME_WORDS = re.compile(r"time|stamp")
# Words of a name that may stand with its side where none is a speed's.
BARE = re.compile(
    r"wheels?|tracks?|sprockets?|drives?|motors?|front|rear|back|mid(?:dle)?|side|measured|actual"
    r"|v|w|k?m|[cm]?m|s|ms|mps|kmh|rad|rads|deg|h|l|r|[fhmrbvw][lr]|[lr][fmrb]|"
)
# Last words of the names of a pose.
POSE_NAMES = [
    re.compile(rf"(?:^|[_.])(?:{one})$")
    for one in ("[tp]?x|east(?:ing)?", "[tp]?y|north(?:ing)?", "yaw|heading|theta")
]
# Words in names of the axes of other vectors.
NO_PLACE = re.compile(
    r"(?:^|[_.])(?:rates?|gyro\w*?|acc\w*?|vel(?:ocity)?|force|mag|ang\w*?|omega)[_.]"
)
PLACE_IN_PARTS = re.compile(r"(?:^|[_.])t?[xy]_[cm]m$")  # names of positions in mm and cm
# Names of a file of poses that nobody measured apart from the robot's own sensors.
ESTIMATED = re.compile(r"odom|wheel|encoder|ekf|ukf|fused|filter|estimat|predict|reckon")
SINCE_1970: tuple[tuple[float, TimeUnit], ...] = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
ENDINGS: dict[str, TimeUnit] = {"ns": "ns", "nsec": "ns", "us": "us", "ms": "ms", "msec": "ms"}
ENDINGS |= {"micros": "us", "millis": "ms"}
LONGEST_STEP = 2.0  # longest usual time between rows [s]; whole numbers with more are no seconds


class _Time(NamedTuple):
    """Keys of a stream's time; None for those of the map."""

    time: str | None
    time_unit: TimeUnit | None


def guess_columns(tables: Sequence[Table], time_column: str = "") -> ColumnMap | None:
    """Guess the columns of each stream; None if no table has a column of the time.

    A stream is taken from the first table that has it; rates and forces may be in two. Columns belong to
    the truth if their name, or that of their table, satisfies `is_truth`, or if the table has positions
    and no other stream, as of a total station. Columns of commands are skipped. `time_column` is used
    where a table has it; a table without a time is skipped.
    """
    main: tuple[str, TimeUnit] | None = None
    tracks, fixes, truth = None, None, None
    imu_names: dict[_Time, list[str]] = {}
    for table in tables:
        table_time = time_column_of(table, time_column)
        if table_time is None:
            continue
        unit = _time_unit(table, table_time)
        main = main or (table_time, unit)
        # A stream states its time only where that is not the main one.
        main_time, main_unit = main
        time = _Time(
            None if table_time == main_time else table_time, None if unit == main_unit else unit
        )
        stem = table.path.stem
        names = [column.name for column in table.columns if column.is_number]
        names = [name for name in names if name != table_time]
        true_names = [name for name in names if naming.is_truth(stem) or naming.is_truth(name)]
        measured = [k for k in names if k not in true_names and not naming.is_command(k)]
        own_tracks = _tracks(measured, time, table)
        has_others = own_tracks or naming.imu_keys(measured) or naming.fix_keys(measured)
        if not has_others and not ESTIMATED.search(stem.lower()):
            true_names += measured
        tracks = tracks or own_tracks
        if tracks and tracks.yaw_rate in measured:
            measured.remove(tracks.yaw_rate)  # it is no gyro
        # Bare axes have the name of the file before them, as in "Gyroscope.x". The last name of an axis
        # counts: those of the first table come last.
        full = [f"{stem}.{name}" if name in {*"xyz"} else name for name in measured]
        imu_names[time] = [*_with_gravity(full, table), *imu_names.get(time, [])]
        # On the globe: x and y could be odometry instead.
        if fixes is None and (keys := naming.fix_keys(measured)):
            fixes = PoseColumns(**keys, **time._asdict())
        truth = truth or _truth(true_names, time, table)
    if main is None:
        return None
    imu = None
    for time, names in imu_names.items():
        if keys := naming.imu_keys(names):
            imu = ImuColumns(**keys, **time._asdict())
            break
    return ColumnMap(*main, tracks, imu, fixes, truth)


def unused_columns(tables: Sequence[Table], columns: ColumnMap | None) -> Iterator[str]:
    """Findings on wheels like those of the mapping, and positions, that it lacks."""
    if columns is None:
        return
    names = {column.name for table in tables for column in table.columns if column.is_number}
    if columns.tracks is not None and (used := columns.tracks.left):
        of_imu = columns.imu.angular_velocity if columns.imu else ()
        wheels = [
            name
            for name in sorted(names - {*used, *columns.tracks.right, *of_imu})
            if naming.is_of_wheel(name)
            and naming.unit_of(name, "m/s") == naming.unit_of(used[0], "m/s")
            and not naming.is_truth(name)
        ]
        if len(wheels) > 1:
            yield f"tracks: {', '.join(wheels)} not used; left and right take all wheels of a side"
    if columns.truth is None:
        places = [name for name in names if PLACE_IN_PARTS.search(name.lower())]
        if places:
            yield f"positions not used: {', '.join(sorted(places))}; a truth is in metres"
    yaws = [name for name in names if POSE_NAMES[2].search(naming.plain_name(name))]
    if yaws and not columns.heading and (columns.truth is None or columns.truth.yaw is None):
        yield f"headings not used: {', '.join(sorted(yaws))}; see [log.columns.heading]"


def _with_gravity(names: Sequence[str], table: Table) -> list[str]:
    """Names without accelerations whose mean has no gravity, as of phones."""
    forces = naming.axes_of(names, naming.ACCELEROMETER)
    rows = table.numbers(forces) if len(forces) == 3 else np.zeros((0, 3))
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows) or np.linalg.norm(rows.mean(axis=0)) > NO_GRAVITY:
        return [*names]
    return [name for name in names if name not in forces]


def time_column_of(table: Table, known: str) -> str | None:
    """Column of the time: `known` if it is there, otherwise the likeliest one."""
    names = [column.name for column in table.columns]
    if known in names:
        return known
    dates = [column.name for column in table.columns if column.kind.startswith("timestamp")]
    exact = [name for name in names if TIME.match(naming.plain_name(name))]
    likely = [name for name in names if TIME_WORDS.search(naming.plain_name(name))]
    return next(iter([*exact, *dates, *likely]), None)


def _time_unit(table: Table, name: str) -> TimeUnit:
    """Unit by a word of the name, the size of times since 1970, or the rows' steps."""
    for word in re.split(r"[^a-z]+", name.lower()):
        if word in ENDINGS:
            return ENDINGS[word]
    try:
        values = table.numbers([name])[:, 0]
    except ReplayError:
        return "s"
    times = np.unique(values[np.isfinite(values)])
    largest = np.abs(times).max(initial=0.0)
    if since_1970 := [unit for size, unit in SINCE_1970 if largest > size]:
        return since_1970[0]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if step <= LONGEST_STEP or (times % 1.0).any():
        return "s"
    return "ms" if step <= 1e3 * LONGEST_STEP else "us"


def _tracks(names: Sequence[str], time: _Time, table: Table) -> TrackColumns | None:
    """Guess the columns of the track speeds, or else of a speed and a yaw rate."""
    likely = [name for name in names if not naming.NO_SPEED.search(name.lower())]
    found = _wheel_sides(likely)
    if found is None:
        twist = naming.twist_names(likely)
        return twist and TrackColumns(speed=twist[0], yaw_rate=twist[1], **time._asdict())
    left, right = found.left, found.right
    keys = naming.unit_of(left[0], unknown="m/s")
    if keys["unit"] == "counts":
        counts = table.numbers((*left, *right))
        keys["wrap"] = counter_range(counts)[0] if len(left) == 1 else None
    return TrackColumns(left=left, right=right, **time._asdict(), **keys)


def _wheel_sides(names: Sequence[str]) -> naming.Sides | None:
    """Columns of both sides; those with a word of speed are preferred."""
    speeds = [name for name in names if naming.SPEED.search(name.lower())]
    bare = [name for name in names if _states_a_side_alone(name)]
    numbered = [name for name in names if naming.is_of_wheel(name) or "dist" in name.lower()]
    for candidates, are_named in ((speeds, True), (bare, True), (numbered, False)):
        found = naming.wheel_sides({name: name for name in candidates}, context="wheel")
        if found is not None and found.likelihood.are_named == are_named:
            return found
    return None


def _states_a_side_alone(name: str) -> bool:
    """Test for a name with no other quantity than its side and unit, as `left_m_s`."""
    words = re.split(r"[^a-z]+", re.sub("left|right", " ", name.lower()))
    return all(map(BARE.fullmatch, words))


def _truth(names: Sequence[str], time: _Time, table: Table) -> PoseColumns | None:
    """Guess the columns of a truth's x, y and yaw; None without a position."""
    names = [name for name in names if not NO_PLACE.search(naming.plain_name(name))]
    x, y, yaw = (naming.first_like(names, pattern) for pattern in POSE_NAMES)
    in_degrees = yaw and (naming.in_degrees(yaw) or jumps_by_360(table.numbers([yaw])[:, 0]))
    unit: AngleUnit = "deg" if in_degrees else "rad"
    return PoseColumns(x=x, y=y, yaw=yaw, yaw_unit=unit, **time._asdict()) if x and y else None
