"""Table reader: CSV and Parquet files to streams, by a column map."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Flags, Floats, Stamps
from icreckon.replay.bags.message_types import NAVSATFIX
from icreckon.replay.bags.table_files import are_few, is_table, read_table
from icreckon.replay.base.errors import OF_STAMPS, EqualStampsError, NoRowsError, ReplayError
from icreckon.replay.mapping.columns import (
    NANOSECONDS_OF,
    ColumnMap,
    HeadingColumns,
    ImuColumns,
    PoseColumns,
    TimeUnit,
    TrackColumns,
)
from icreckon.replay.reading.conversions import imu_rows, in_radians, pose_rows
from icreckon.replay.reading.stream import COLUMNS, NAN, Stream

MOST_NAMED = 5  # most columns that a message names
RESOLUTIONS = [10.0**digits for digits in range(15, 5, -1)]
"""Resolutions of stamps that are looked for, from 1e6 to 0.001 s [ns]."""
ROUNDING = 2e3  # largest error of a stamp by its binary digits [ns]
SAMPLED, PLAUSIBLE_STEPS_S = ("tracks", "imu"), (5e-5, 5.0)
"""Streams of a robot's own sensors, and shortest and longest time between their samples [s]."""
INSTANCE = "I"  # column with the number of the sensor in tables of ArduPilot
MOST_REPEATED = 0.05  # share of repeated stamps that is reported
# Times from here on are damage: differences of them overflow int64 nanoseconds.
LARGEST_TIME = 2.0**62
NUMBER_OR_EMPTY = r"^\s*([-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|NaN|NAN|Inf))?\s*$"
"""Cells of a column of texts that are numbers."""


class Column(NamedTuple):
    """A column: name, type, whether it holds numbers, and number of non-empty cells."""

    name: str
    kind: str
    is_number: bool
    filled: int


def _kind(kind: Any) -> Any:
    """Type of the values of a column."""
    import pyarrow as pa

    return kind.value_type if pa.types.is_dictionary(kind) else kind


class Table:
    """A table file; a ReplayError if it cannot be read, or two columns share a name.

    Attributes:
        path: the file.
        columns: its columns.
        notes: what was left out.
    """

    def __init__(self, path: Path) -> None:
        import pyarrow as pa

        self.path = path
        try:
            self._table, self._others, notes = read_table(path)
            columns = [*self._table.column_names, *self._others]
        except ReplayError as problem:
            raise ReplayError(f"{path}: {problem}") from None
        except UnicodeDecodeError:
            raise ReplayError(
                f"{path}: the names of its columns are not UTF-8; `iconv -f latin1 -t utf-8` converts it"
            ) from None
        except (pa.ArrowException, OSError) as problem:
            reason = " ".join(str(problem).split())
            raise ReplayError(f"{path}: the table cannot be read: {reason}") from None
        names = [name.lstrip("\ufeff").lstrip("#").strip() for name in columns]
        if all(re.match(NUMBER_OR_EMPTY, name) for name in names):
            raise ReplayError(
                f"{path}: the first line has numbers; add a line of names, as time,left,right,gyro_z"
            )
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            named = ", ".join(map(repr, twice[:MOST_NAMED]))
            raise ReplayError(f"{path}: several columns are named {named}")
        count = self._table.num_columns
        self._table = self._table.rename_columns(names[:count])
        self._others = dict(zip(names[count:], self._others.values(), strict=True))
        if not self._table.num_rows:
            raise NoRowsError(f"{path}: the table has no rows")
        self.notes = [f"{path.name}: {note}" for note in notes]
        if {INSTANCE, "TimeUS"} <= set(names):
            self._keep_first_instance()
        self._leave_out_few_texts()
        self.columns = tuple(
            Column(
                field.name,
                str(_kind(field.type)),
                pa.types.is_floating(field.type) or pa.types.is_integer(field.type),
                len(self._table) - self._table.column(place).null_count,
            )
            for place, field in enumerate(self._table.schema)
        ) + tuple(Column(name, kind, False, len(self)) for name, kind in self._others.items())

    def _keep_first_instance(self) -> None:
        """Keep the rows of the first of several sensors alike, as ArduPilot logs them."""
        from pyarrow import compute

        instances = self._table.column(INSTANCE)
        first = compute.min(instances)
        of_first = compute.equal(instances, first)
        if (others := len(self) - (compute.sum(of_first).as_py() or 0)) and first.is_valid:
            self._table = self._table.filter(of_first)
            text = f"{others} rows of other sensors than the first (column {INSTANCE!r} is not {first})"
            self.notes.append(f"{self.path.name}: {text}: left out")

    def _leave_out_few_texts(self) -> None:
        """Make a column numbers that holds a text in few rows, which become empty."""
        import pyarrow as pa
        from pyarrow import compute

        strays = []
        for place, name in enumerate(self._table.column_names):
            column = self._table.column(place)
            cells = _strays(column)
            if cells is None or not are_few(cells.number, len(column)):
                continue
            texts = compute.utf8_trim_whitespace(column.cast(pa.string()))
            empty = compute.or_(cells.where, compute.equal(texts, "")).fill_null(True)
            no_text = pa.scalar(None, pa.string())
            try:
                numbers = compute.if_else(empty, no_text, texts).cast(pa.float64())
            except pa.ArrowInvalid:
                continue
            self._table = self._table.set_column(place, name, numbers)
            if cells.number:
                strays.append(f"column {name!r} holds {cells.text}")
        if strays:
            others = f"; {len(strays) - 3} other columns hold text" if len(strays) > 3 else ""
            self.notes.append(f"{self.path.name}: {'; '.join(strays[:3])}{others}: left out there")

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def present(self, names: Sequence[str]) -> set[str]:
        """Names that are columns of the table, also as "FILE.column"."""
        own_names = {column.name for column in self.columns}
        return {name for name in names if self._bare(name) in own_names}

    def _bare(self, name: str) -> str:
        """Name of a column without that of the file before it."""
        has_it = any(column.name == name for column in self.columns)
        return name if has_it else name.removeprefix(f"{self.path.stem}.")

    def numbers(self, names: Sequence[str]) -> Floats:
        """Columns as numbers (n, k); NaN for an empty cell, or without the column.

        Raises:
            ReplayError: a column holds something else.
        """
        here, missing = self.present(names), np.full(len(self), NAN)
        return np.column_stack([self._numbers(name) if name in here else missing for name in names])

    def _numbers(self, name: str) -> Floats:
        import pyarrow as pa

        column = self._column(self._bare(name), "numbers")
        if pa.types.is_null(column.type):
            return np.full(len(column), NAN)
        if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
            kind = _kind(column.type)
            if (strays := _strays(column)) and strays.number:
                raise ReplayError(
                    f"{self.path}: column {name!r} holds {strays.text}, not numbers alone"
                )
            filled = column.drop_null()
            such = f" (such as {str(filled[0].as_py())!r})" if len(filled) else ""
            raise ReplayError(f"{self.path}: column {name!r} holds {kind}, not numbers{such}")
        return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(), dtype=float)

    def _column(self, name: str, wanted: str) -> Any:
        if kind := self._others.get(name):
            raise ReplayError(f"{self.path}: column {name!r} holds {kind}, not {wanted}")
        return self._table.column(name)

    def stray_texts(self) -> Iterator[str]:
        """Yield a note for each column of numbers that some text makes a column of texts."""
        for name in self._table.column_names:
            if (strays := _strays(self._table.column(name))) and strays.number:
                what = f"column {name!r} holds {strays.text}"
                yield f"{self.path.name}: {what}; without it these are numbers"

    def stamps(self, name: str, unit: TimeUnit) -> tuple[Stamps, Any]:
        """Times of a column as stamps (n,) [ns], and the mask (n,) of possible ones.

        Raises:
            ReplayError: the column holds no times, or none that fit the unit.
        """
        import pyarrow as pa

        column = self._column(name, "times")
        has_time = ~np.asarray(column.is_null().to_numpy(zero_copy_only=False), dtype=bool)
        if pa.types.is_timestamp(column.type):
            whole = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64())
            return np.asarray(whole.fill_null(0).to_numpy(), dtype=np.int64), has_time
        factor = NANOSECONDS_OF[unit]
        values = self._numbers(name)
        has_time &= np.isfinite(values)
        wraps = _wraps(values, has_time)
        values = values + wraps
        possible = has_time & (np.abs(values) < LARGEST_TIME / factor)
        if 2 * possible.sum() < has_time.sum():
            first = values[has_time & ~possible][0]
            raise ReplayError(
                f"{self.path}: column {name!r} holds {first:.6g}, too much for times in {unit}; set "
                "time_unit in [log.columns]"
            )
        if pa.types.is_integer(column.type):
            exact = np.asarray(column.fill_null(0).cast(pa.int64()).to_numpy(), dtype=np.int64)
            return (exact + wraps) * factor, possible
        # Whole units first: a float of ns since 1970 would be coarse by hundreds of ns.
        values = np.where(possible, values, 0.0)
        whole = np.floor(values)
        fractions = np.round((values - whole) * factor).astype(np.int64)
        return whole.astype(np.int64) * factor + fractions, possible


def _wraps(values: Floats, there: Flags) -> Stamps:
    """Range of a 32-bit timer (`millis()`, `micros()`) times its wraps so far (n,)."""
    wraps, timer = np.zeros(len(values), np.int64), 2**32
    known = values[there]
    if len(known) and known.min() >= 0.0 and known.max() < timer:
        steps = np.diff(known, prepend=known[0])
        turns = (steps < -timer // 2).astype(np.int64) - (steps > timer // 2)
        wraps[there] = timer * np.cumsum(turns)
    return wraps


class _Strays(NamedTuple):
    """Cells of a column of texts that are no numbers."""

    where: Any  # their mask
    number: int  # number of them
    text: str  # description of the first


def _strays(column: Any) -> _Strays | None:
    """Find the cells that are no numbers in a column of texts, most of which are."""
    import pyarrow as pa
    from pyarrow import compute

    texts = column.cast(pa.string()) if pa.types.is_dictionary(column.type) else column
    if not pa.types.is_string(texts.type):
        return None
    # Empty cells of such a column are empty texts.
    other = compute.invert(compute.match_substring_regex(texts, NUMBER_OR_EMPTY)).fill_null(False)
    count = compute.sum(other).as_py() or 0
    if 2 * count >= len(texts):
        return None
    if not count:
        return _Strays(other, 0, "")
    first = compute.index(other, True).as_py()
    text = f"text in {count} of {len(texts)} rows (row {first + 1}: {texts[first].as_py()!r})"
    return _Strays(other, count, text)


def table_streams(table: Table, columns: ColumnMap) -> list[Stream]:
    """Read the streams that have columns in a table, which may be some of them.

    Raises:
        ReplayError: a column holds no numbers, or no times.
    """
    streams: list[Stream] = []
    for purpose, spec in wanted_columns(columns):
        names, time = spec.names, spec.time or columns.time
        there = table.present(names)
        is_whole = len(there) == len(set(names))
        if not (table.present([time]) and there and (is_whole or purpose in SAMPLED)):
            continue
        stamps, timed = table.stamps(time, spec.time_unit or columns.time_unit)
        stamps = stamps - round(spec.clock_offset / NANOSECOND)
        if isinstance(spec, TrackColumns) and spec.clock_drift and timed.any():
            gained = spec.clock_drift * (stamps - stamps[timed].min())
            stamps = stamps - np.where(timed, gained, 0.0).round().astype(np.int64)
        values = table.numbers(names)
        has_value = ~np.isnan(values).all(axis=1)
        is_kept = has_value & timed
        label, source = f"columns {', '.join(names)}", str(table.path)
        stream = Stream(purpose, label, source=source, time="auto", from_table=True)
        stream.missing = set(names) - there
        stream.lose("no time", int((has_value & ~timed).sum()))
        column, kept = f"{table.path.name}: column {time!r}", stamps[is_kept]
        wrong_unit = _wrong_unit(column, kept) if purpose in SAMPLED else None
        notes = _resolution_note(column, kept), wrong_unit
        earlier_notes = {note for earlier in streams for note in earlier.notes}
        stream.notes += [note for note in notes if note and note not in earlier_notes]
        stream.msgtype, rows = _rows(spec, values)
        stream.add(kept, rows[is_kept])
        streams.append(stream)
    return streams


def _wrong_unit(column: str, stamps: Stamps) -> str | None:
    """Note on implausible steps of a sensor's stamps (n,), or None."""
    steps = np.diff(np.unique(stamps)) * NANOSECOND
    least, most = PLAUSIBLE_STEPS_S
    if not len(steps) or least <= (step := float(np.median(steps))) <= most:
        return None
    return f"{OF_STAMPS}{column} has a row every {step:.3g} s: is time_unit right?"


def _resolution_note(column: str, stamps: Stamps) -> str | None:
    """Note on stamps (n,) with too few digits; an EqualStampsError if all are equal."""
    times = np.unique(stamps)
    # The largest power of ten [ns] that divides all times.
    errors = ((step, np.abs(times - np.round(times / step) * step)) for step in RESOLUTIONS)
    resolution = next((step for step, error in errors if error.max(initial=0) < ROUNDING), None)
    are_distinct = len(times) > (1.0 - MOST_REPEATED) * len(stamps)
    if resolution is None or are_distinct or len(stamps) < 3:
        return None
    seconds = resolution * NANOSECOND
    text = f"{column} has a resolution of {seconds:g} s: written with too few digits?"
    if len(times) == 1:
        raise EqualStampsError(f"{text} All {len(stamps)} times are {times[0] * NANOSECOND:.6g} s")
    return f"{OF_STAMPS}{text} {1.0 - len(times) / len(stamps):.0%} of its times are repeated"


def are_parts(logs: Sequence[Sequence[Path]], columns: ColumnMap | None) -> bool:
    """Return True if logs, each of files, have unlike columns of the track speeds."""
    if columns is None:
        return False
    names = columns.tracks.names if columns.tracks else ()
    of_bag = set(names) or {""}
    found = (
        set().union(*(Table(file).present(names) if is_table(file) else of_bag for file in files))
        for files in logs
    )
    return len(set(map(frozenset, found))) > 1


Columns = TrackColumns | ImuColumns | PoseColumns | HeadingColumns


def wanted_columns(columns: ColumnMap) -> Iterator[tuple[str, Columns]]:
    """Yield each stream of a column map: its purpose, and its columns."""
    for purpose in ("tracks", "imu", "fixes", "truth", "heading"):
        if (spec := getattr(columns, purpose)) is not None:
            yield purpose, spec


def _rows(spec: Columns, values: Floats) -> tuple[str, Floats]:
    """Equivalent message type, and the rows that its reader would return."""
    if isinstance(spec, TrackColumns):
        return COLUMNS, values
    if isinstance(spec, ImuColumns):
        return COLUMNS, imu_rows(spec, values)
    if isinstance(spec, HeadingColumns):
        yaw = in_radians(spec.yaw, values[:, 0], spec.unit)
        yaw = 0.5 * np.pi - yaw if spec.clockwise else yaw
        return COLUMNS, np.column_stack([yaw, np.full(len(yaw), spec.sigma**2)])
    return (NAVSATFIX if spec.latitude else COLUMNS), pose_rows(spec, values)
