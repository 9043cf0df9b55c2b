"""Table files: CSV and Parquet to tables in memory, within limits."""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from icreckon.estimator.base.frames import quaternion_to_yaw
from icreckon.replay.bags import unpacking
from icreckon.replay.base.errors import ReplayError

PARQUET_MAGIC = b"PAR1"
PACKED_CSV_SUFFIXES = (".csv.gz", ".csv.bz2")
CSV_SUFFIXES = (".csv", ".tsv", ".tum", *PACKED_CSV_SUFFIXES)
TABLE_SUFFIXES = (*CSV_SUFFIXES, ".parquet")
"""Endings of tables; a file with another name may be one, too, see `is_table`."""
DELIMITERS = "\t;,"
FIRST_BYTES = 1 << 20  # bytes of a CSV file that must hold its first line and a decimal point
FRACTION = re.compile(r"[+-]?\d*([.,])\d+(?:[eE][+-]?\d+)?")
"""Number with a fraction; in many countries 0,25."""
UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")
MOST_COLUMNS = 10_000
POSE_CELLS, UNIT_ERROR = 8, 0.01
"""Cells of a line of a trajectory, and largest error of the norm of its quaternion [-]."""
FEW = 0.01  # share of the rows that may be damaged: they are left out
ENOUGH = 20  # rows from which on one damaged row is allowed
SHOWN = 60  # characters of a damaged row that a message shows
TEXTS = ("string", "binary")  # Arrow types of texts, also as `large_string` and `large_binary`
CELL_BYTES = 8  # size of a number in memory [bytes]


def is_table(path: Path) -> bool:
    """Test for a table file: Parquet by its first bytes, CSV by its name."""
    if not path.is_file():
        return False
    if path.name.lower().endswith((*CSV_SUFFIXES, ".txt")):
        return True
    with suppress(OSError):  # the reader reports the error
        return _is_parquet(path)
    return False


def _is_parquet(path: Path) -> bool:
    """Test the first bytes of a file; OSError if it cannot be read."""
    with path.open("rb") as file:
        return file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC


Read = tuple[Any, dict[str, str], list[str]]
"""Columns of numbers, times and texts as a pyarrow.Table, texts as dictionaries; types of the other
columns, such as lists, by name; and notes on rows that were left out."""


def are_few(count: int, rows: int) -> bool:
    """Return True if a table is read although `count` of its rows are damaged."""
    # One row in a short table, too: often a logger was stopped within the last one.
    return count <= FEW * rows or (count == 1 and rows >= ENOUGH)


def read_table(path: Path) -> Read:
    """Read a table file: Parquet by its first bytes, a trajectory, otherwise CSV.

    CSV has a line of names; its delimiter is a comma, a semicolon or a tab; with the latter two,
    numbers may have decimal commas. A trajectory (time x y z qx qy qz qw in each line, as of TUM and
    evo) is a table of a truth.

    Raises:
        ReplayError: it has more than `MOST_COLUMNS` columns, unpacks to more than the limit, or many rows
            have another number of cells than the line of names.
        pyarrow.ArrowException: it is no such table.
        OSError: it cannot be read.
    """
    if _is_parquet(path):
        return _read_parquet(path)
    return _read_trajectory(path) if is_trajectory(path) else _read_csv(path)


def is_trajectory(path: Path) -> bool:
    """Test the first line of data for a time, a position and a unit quaternion."""
    first = ""
    with suppress(OSError), path.open(encoding="utf-8", errors="replace") as file:
        lines = file.read(FIRST_BYTES).splitlines()
        first = next((line for line in lines if line.strip() and line[0] != "#"), "")
    try:
        cells = np.array(first.split(), dtype=float)
    except ValueError:
        return False
    return len(cells) == POSE_CELLS and bool(abs(np.linalg.norm(cells[4:]) - 1.0) < UNIT_ERROR)


def _read_trajectory(path: Path) -> Read:
    """Read the planar poses of a TUM trajectory as columns of a truth."""
    from pyarrow import table

    try:
        rows = np.loadtxt(path, ndmin=2)
    except ValueError as problem:
        raise ReplayError(f"the trajectory cannot be read: {problem}") from None
    time = np.round(rows[:, 0] * 1e9).astype(np.int64).astype("datetime64[ns]")
    poses = {"true_x": rows[:, 1], "true_y": rows[:, 2], "true_yaw": quaternion_to_yaw(rows[:, 4:])}
    return table({"time": time} | poses), {}, []


def _comments(lines: Sequence[str]) -> int:
    """Number of comments (`# ...`) before the names, which may begin with # too."""
    marked = next((k for k, line in enumerate(lines) if not line.startswith("#")), 0)
    if not marked:
        return 0
    last, below = lines[marked - 1], lines[marked]
    has_names = any(last.count(one) == below.count(one) > 0 for one in DELIMITERS)
    return marked - 1 if has_names else marked


def _read_csv(path: Path) -> Read:
    """Read a CSV file, without its damaged rows if they are few."""
    from pyarrow import ArrowInvalid, BufferReader, csv

    text = _csv_bytes(path)
    beginning = bytes(text[:FIRST_BYTES])
    if beginning.startswith(UTF_16_MARKS):
        raise ReplayError("it is UTF-16; `iconv -f utf-16 -t utf-8` converts it")
    lines = beginning.decode("utf-8", "replace").splitlines() or [""]
    comments = _comments(lines)
    names, *rows = lines[comments:]
    delimiter = max(DELIMITERS, key=names.count)
    _check_columns(names.count(delimiter) + 1)
    numbers = csv.ConvertOptions(decimal_point=_decimal_point(rows, delimiter))
    below_comments = csv.ReadOptions(skip_rows=comments)

    def read(invalid_row_handler: Callable[[Any], str] | None) -> Any:
        options = csv.ParseOptions(delimiter=delimiter, invalid_row_handler=invalid_row_handler)
        return csv.read_csv(BufferReader(text), below_comments, options, numbers)

    try:
        return read(None), {}, []
    except ArrowInvalid:
        # pyarrow writes a traceback when it hands a row that is not UTF-8 to a handler.
        if not _is_utf_8(text):
            raise
    damaged, first_row = 0, ""

    def skip(row: Any) -> str:
        """Count a pyarrow.csv.InvalidRow, describe the first, make pyarrow skip it."""
        nonlocal damaged, first_row
        if not damaged:
            text = row.text if len(row.text) <= SHOWN else f"{row.text[:SHOWN]}..."
            first_row = f"{row.actual_columns} instead of {row.expected_columns}, in {text!r}"
        damaged += 1
        return "skip"

    table = read(skip)
    count = int(table.num_rows) + damaged
    damage = f"{damaged} of {count} rows with another number of cells than names ({first_row})"
    if damaged and not are_few(damaged, count):
        raise ReplayError(f"the table cannot be read: it has {damage}; correct or delete them")
    return table, {}, [f"left out {damage}"] if damaged else []


def _csv_bytes(path: Path) -> Any:
    """Bytes of a CSV file (a pyarrow.Buffer), unpacked up to the limit."""
    from pyarrow import input_stream, memory_map, py_buffer

    if not path.name.lower().endswith(PACKED_CSV_SUFFIXES):
        return memory_map(str(path)).read_buffer()
    text = bytearray()
    with input_stream(path, compression="detect") as stream:
        while part := stream.read(FIRST_BYTES):
            text += part
            if len(text) > unpacking.MOST_IN_MEMORY:
                raise unpacking.too_large("the table", unpacking.MOST_IN_MEMORY)
    return py_buffer(text)


def _is_utf_8(text: Any) -> bool:
    """Test bytes (a pyarrow.Buffer) without a copy of them."""
    try:
        str(memoryview(text), "utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _decimal_point(rows: list[str], delimiter: str) -> str:
    """Decimal point of a table: a comma if most fractions in these rows have one."""
    if delimiter == ",":
        return "."
    cells = [cell.strip().strip('"') for row in rows for cell in row.split(delimiter)]
    fractions = list(filter(None, map(FRACTION.fullmatch, cells)))
    commas = sum(fraction[1] == "," for fraction in fractions)
    return "," if 2 * commas > len(fractions) else "."


def _read_parquet(path: Path) -> Read:
    """Read columns of numbers, times and texts, within the limit of the size."""
    from pyarrow import parquet
    from pyarrow.types import is_null, is_primitive

    with parquet.ParquetFile(path) as file:
        row_groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
        schema = file.schema_arrow
    _check_columns(len(schema.names))
    types = {field.name: field.type for field in schema}
    texts = [name for name, kind in types.items() if str(kind).removeprefix("large_") in TEXTS]
    # Numbers and times have cells of one size; a column without any value has the type null.
    sized = {name for name, kind in types.items() if is_primitive(kind) or is_null(kind)}
    columns = [name for name in types if name in sized.union(texts)]
    # The stated size may be too small: a column of equal numbers takes hardly any bytes in a file.
    cells = sum(group.num_rows for group in row_groups) * len(columns)
    size = max(sum(group.total_byte_size for group in row_groups), cells * CELL_BYTES)
    if size > max(unpacking.MOST_IN_MEMORY, path.stat().st_size):
        raise unpacking.too_large("the table", unpacking.MOST_IN_MEMORY)
    with parquet.ParquetFile(path, read_dictionary=texts, pre_buffer=False) as file:
        table = file.read(columns=columns, use_threads=False)
    return table, {name: str(kind) for name, kind in types.items() if name not in columns}, []


def _check_columns(count: int) -> None:
    """Raise a ReplayError for more than `MOST_COLUMNS` columns."""
    if count > MOST_COLUMNS:
        raise ReplayError(f"it has {count} columns, and at most {MOST_COLUMNS} are read")
