"""Guess of the column map of an unknown table, by the names of its columns."""

import re
from collections.abc import Sequence

import numpy as np

from icreckon.replay.base.errors import ReplayError
from icreckon.replay.inspection.guess_topics import (
    NO_SPEED,
    PLACEHOLDER_SIGMA,
    SPEED,
    is_command,
    is_truth,
    sides,
    unit_of,
)
from icreckon.replay.mapping.columns import (
    AngleUnit,
    ColumnMap,
    ImuColumns,
    PoseColumns,
    RateUnit,
    TimeUnit,
    TrackColumns,
)
from icreckon.replay.mapping.track_units import counter_range
from icreckon.replay.reading.tables import Table

TIME = re.compile(r"^(t|time|times|timestamp|stamp|date|datetime|utc)$")
TIME_WORDS = re.compile(r"time|stamp")
# Words of a name that may stand with its side where none is a speed's.
BARE = re.compile(
    r"wheels?|tracks?|sprockets?|drives?|motors?|front|rear|back|mid(?:dle)?|side|measured|actual"
    r"|v|k?m|[cm]?m|s|ms|mps|kmh|rad|rads|deg|h|l|r|[fmrb][lr]|[lr][fmrb]|"
)
GYRO = re.compile(
    r"^(?:imu_?)?(?:gyro?(?:scope)?|ang(?:ular)?_?vel(?:ocity)?|omega|w|g)?[_.]?([xyz])$"
)
ACCELEROMETER = re.compile(
    r"^(?:imu_?)?(?:acc(?:el(?:eration|erometer)?)?|lin(?:ear)?_?acc(?:el(?:eration)?)?|a)[_.]?([xyz])$"
)
YAW_RATE = re.compile(r"(?:^|imu_)(?:yaw_?rate|gyro(?:_?yaw)?|angular_?vel(?:ocity)?|omega)$")
LATITUDE, LONGITUDE, ALTITUDE = (
    re.compile(rf"(^|_){short}({long})?(_deg)?$")
    for short, long in (("lat", "itude"), ("lon", "g|gitude"), ("alt", "itude"))
)
UNIT = re.compile(r"_(?:dps|mps2?|m?g|(?:m|deg|rad)(?:_?s_?2?)?|[num]?s(?:ec)?)$")
SINCE_1970: tuple[tuple[float, TimeUnit], ...] = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
ENDINGS: dict[str, TimeUnit] = {"ns": "ns", "nsec": "ns", "us": "us", "ms": "ms", "msec": "ms"}


def guess_columns(tables: Sequence[Table], time_column: str = "") -> ColumnMap | None:
    """Guess the columns of each stream; None if a table has no column of the time.

    Columns belong to the truth if their name, or that of their table, satisfies `is_truth`. Columns of
    commands are skipped. `time_column` is used where a table has it.
    """
    times = [_time_column(table, time_column) for table in tables]
    if not times or None in times:
        return None
    time, unit = str(times[0]), _time_unit(tables[0], str(times[0]))
    tracks, imu, fixes, truth = None, None, None, None
    for table, own in zip(tables, times, strict=True):
        other = None if own == time else own
        names = [one.name for one in table.columns if one.is_number and one.name != own]
        of_truth = [name for name in names if is_truth(table.path.stem) or is_truth(name)]
        measured = [name for name in names if name not in of_truth and not is_command(name)]
        tracks = tracks or _tracks(measured, other, table)
        imu = imu or _imu(measured, other)
        fixes = fixes or _fixes(measured, other)
        truth = truth or _truth(of_truth, other)
    return ColumnMap(time, unit, tracks, imu, fixes, truth)


def _plain(name: str) -> str:
    """Lower-case name without its unit: acc_x for `Acc x [m/s²]` and for `acc_x_g`."""
    return UNIT.sub("", re.sub(r"\W+", "_", re.sub(r"[\[(].*", "", name.lower()).strip()))


def _time_column(table: Table, known: str) -> str | None:
    names = [column.name for column in table.columns]
    dates = [column.name for column in table.columns if column.kind.startswith("timestamp")]
    exact = [name for name in names if TIME.match(_plain(name))]
    likely = [name for name in names if TIME_WORDS.search(_plain(name))]
    return known if known in names else next(iter([*exact, *dates, *likely]), None)


def _time_unit(table: Table, name: str) -> TimeUnit:
    """Unit by the ending of the name, else by the size of times since 1970; else "s"."""
    for word in re.split(r"[^a-z]+", name.lower()):
        if word in ENDINGS:
            return ENDINGS[word]
    try:
        values = table.numbers([name])[:, 0]
    except ReplayError:
        return "s"
    largest = np.nanmax(np.abs(values)) if np.isfinite(values).any() else 0.0
    return next((unit for size, unit in SINCE_1970 if largest > size), "s")


def _tracks(names: Sequence[str], time: str | None, table: Table) -> TrackColumns | None:
    likely = [name for name in names if not NO_SPEED.search(name.lower())]
    left, right = sides([name for name in likely if SPEED.search(name.lower())])
    if not (left and right):
        left, right = sides([name for name in likely if _is_bare(name)])
    if not (left and right) or len(left) != len(right):
        return None
    keys = unit_of(left[0], unknown="m/s")
    if keys["unit"] == "counts":
        numbers = table.numbers((*left, *right))
        keys["wrap"] = counter_range(numbers)[0] if len(left) == 1 else None
    return TrackColumns(left=left, right=right, time=time, **keys)


def _is_bare(name: str) -> bool:
    """Return True for a name with no other quantity than its side, as `left_m_s`."""
    words = re.split(r"[^a-z]+", re.sub("left|right", " ", name.lower()))
    return all(BARE.fullmatch(word) for word in words)


def _axes(names: Sequence[str], pattern: re.Pattern[str]) -> tuple[str, ...]:
    """Names of the axes x, y, z, of z alone if there is no x, or none."""
    by_axis = {match.group(1): name for name in names if (match := pattern.match(_plain(name)))}
    if set("xyz") <= set(by_axis):
        return tuple(by_axis[axis] for axis in "xyz")
    return (by_axis["z"],) if "z" in by_axis and "x" not in by_axis else ()


def _imu(names: Sequence[str], time: str | None) -> ImuColumns | None:
    # Bare x, y and z are a position rather than rates.
    named = [name for name in names if len(_plain(name)) > 1]
    rates, forces = _axes(named, GYRO), _axes(named, ACCELEROMETER)
    if not (rates := rates or tuple(filter(None, [_first(names, YAW_RATE)]))):
        return None
    unit: RateUnit = "deg/s" if any(map(_in_degrees, rates)) else "rad/s"
    forces = forces if len(forces) == 3 else ()
    return ImuColumns(angular_velocity=rates, linear_acceleration=forces, rate_unit=unit, time=time)


def _first(names: Sequence[str], pattern: re.Pattern[str]) -> str | None:
    return next((name for name in names if pattern.search(_plain(name))), None)


def _in_degrees(name: str) -> bool:
    return any(word in name.lower() for word in ("deg", "dps", "°"))


def _fixes(names: Sequence[str], time: str | None) -> PoseColumns | None:
    latitude, longitude = _first(names, LATITUDE), _first(names, LONGITUDE)
    if latitude is None or longitude is None:
        return None
    return PoseColumns(
        latitude=latitude,
        longitude=longitude,
        altitude=_first(names, ALTITUDE),
        position_sigma=PLACEHOLDER_SIGMA,
        time=time,
    )


def _truth(names: Sequence[str], time: str | None) -> PoseColumns | None:
    x, y, yaw = (
        _first(names, re.compile(rf"(?:^|[_.])(?:{ending})$"))
        for ending in ("x", "y", "yaw|heading|theta")
    )
    unit: AngleUnit = "deg" if yaw and _in_degrees(yaw) else "rad"
    return PoseColumns(x=x, y=y, yaw=yaw, yaw_unit=unit, time=time) if x and y else None
