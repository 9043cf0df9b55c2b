"""Records with field names that plain Python and compiled code both read.

In Python a record is a mutable `msgspec.Struct`, whose attributes are fast. For numba it is an element of
a NumPy structured array whose fields have the same names. A function that uses nothing but attributes of
a record is written once for both. A shared record is both at once: in Python a C structure with these
attributes, for numba an array on its memory (`array_on`).
"""

import ctypes
from functools import cache
from typing import Annotated, Any, ClassVar, TypeVar, cast, get_args, get_type_hints

import msgspec
import numpy as np
from numpy.typing import NDArray

Record = TypeVar("Record")

# Stamp of a sample that has not come yet [ns]; its age exceeds 140 years at any stamp after 1970.
NEVER = -(2**62)
# Stamp in a record [ns], which `shifted` changes with the clock.
CLOCK = "stamp of the clock of all sensors"
Stamp = Annotated[int, CLOCK]
# Fields of records, as they are checked in files.
Flag = Annotated[int, msgspec.Meta(ge=0, le=1)]
Count = Annotated[int, msgspec.Meta(ge=0)]
Size = Annotated[float, msgspec.Meta(ge=0.0)]
Interval = Annotated[float, msgspec.Meta(gt=0.0, le=1e9)]
# C type of each type of record. Layouts are the same object, which numba recognises fast.
MEMORIES: dict[type, Any] = {}


class SharedRecord(ctypes.Structure):
    """Record whose memory compiled code reads and writes; a copy has its own memory."""

    kind: ClassVar[type]  # type of the record
    layout: ClassVar[np.dtype[Any]]  # layout of the memory

    def __reduce__(self) -> tuple[Any, ...]:
        whole: Any = self._b_base_  # the record of which this is a part
        if whole is None:
            return shared_record, (record_of(self.kind, array_on(self)[0]),)
        offset = ctypes.addressof(self) - ctypes.addressof(whole)
        parts = (name for name, _ in whole._fields_ if getattr(type(whole), name).offset == offset)
        return getattr, (whole, next(parts))


def zeros(count: int) -> Any:
    """Default of a field of a record: a list of zeros."""
    return msgspec.field(default_factory=lambda: [0.0] * count)


def or_none(stamp: int) -> int | None:
    """Stamp of a record [ns]; None for one that has not come yet."""
    return None if stamp == NEVER else stamp


def shared_record(record: Record) -> Record:
    """Copy a record to memory that Python and compiled code share."""
    shared = _memory_of(record)()
    array_on(shared)[:] = record_array(record, 1)
    return cast(Record, shared)


def array_on(shared: Any) -> NDArray[Any]:
    """Structured array (1,) on the memory of a shared record."""
    return np.frombuffer(shared, shared.layout)


def record_array(record: Any, count: int) -> NDArray[Any]:
    """Structured array (count,) of copies of a record.

    Its fields are integers, floats, lists of floats, arrays of places, other records and named tuples.
    """
    return np.full(count, np.array(_values(record), dtype=_memory_of(record).layout))


def record_of(kind: type[Record], element: Any) -> Record:
    """Record of a type from an element of a structured array."""
    values = {}
    for name, field_kind in _types(cast(Any, kind)).items():
        value = element[name]
        values[name] = record_of(field_kind, value) if _names(field_kind) else value.tolist()
    return kind(**values)


def plain_copy(kind: type[Record], record: Record) -> Record:
    """Copy a record of a type, shared or not, to one that Python alone uses."""
    is_shared = isinstance(record, SharedRecord)
    return record_of(kind, array_on(record)[0]) if is_shared else copied(record)


def copied(record: Record) -> Record:
    """Copy a record to memory of its own."""
    if isinstance(record, SharedRecord):
        return type(record).from_buffer_copy(record)
    if isinstance(record, msgspec.Struct):
        return type(record)(*(copied(getattr(record, name)) for name in record.__struct_fields__))
    return cast(Record, record.copy()) if isinstance(record, list) else record


def assign(record: Any, source: Any) -> None:
    """Copy the values of a record to another one, except settings (named tuples)."""
    if isinstance(source, SharedRecord):
        ctypes.memmove(ctypes.addressof(record), ctypes.addressof(source), ctypes.sizeof(source))
        return
    for name in source.__struct_fields__:
        value = getattr(source, name)
        if isinstance(value, msgspec.Struct):
            assign(getattr(record, name), value)
        elif isinstance(value, list):
            getattr(record, name)[:] = value
        elif not isinstance(value, tuple):
            setattr(record, name, value)


def shifted(record: Record, by: int) -> Record:
    """Copy a record for a clock that is ahead by some ns: all its `Stamp` are later.

    A field may be a record, a named tuple, or a tuple or dict of these.
    """
    kind: Any = record.kind if isinstance(record, SharedRecord) else type(record)
    return cast(Record, _shift_stamps(plain_copy(kind, record), False, by))


def _shift_stamps(value: Any, is_stamp: bool, by: int) -> Any:
    """Copy a value with every stamp in it, except NEVER, later by some time [ns].

    With `is_stamp`, numbers are stamps. Types say which fields of a record or named tuple are.
    """
    if names := _names(value):
        hints, fields = field_types(cast(Any, type(value))), {}
        for name in names:
            fields[name] = _shift_stamps(getattr(value, name), _is_stamp(hints[name]), by)
        is_tuple = isinstance(value, tuple)
        return value._replace(**fields) if is_tuple else msgspec.structs.replace(value, **fields)
    if isinstance(value, dict):
        return {key: _shift_stamps(item, is_stamp, by) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(_shift_stamps(item, is_stamp, by) for item in value)
    if not is_stamp or value is None or value == NEVER:
        return value
    return value + by


@cache
def field_types(kind: Any) -> dict[str, Any]:
    """Types of the fields of a record or named tuple, with their annotations."""
    return get_type_hints(kind, include_extras=True)


@cache
def _is_stamp(hint: Any) -> bool:
    return CLOCK in getattr(hint, "__metadata__", ()) or any(map(_is_stamp, get_args(hint)))


_types = cache(get_type_hints)


def _names(record: Any) -> tuple[str, ...]:
    """Field names of a record, named tuple, or their type; () for other values."""
    of_named_tuple = getattr(record, "_fields", ())
    return cast(tuple[str, ...], getattr(record, "__struct_fields__", of_named_tuple))


def _memory_of(record: Any) -> Any:
    """C type of a record; lists are as long as those of the first record of its type."""
    kind = type(record)
    if kind not in MEMORIES:
        fields = [
            (name, _memory_of_field(getattr(record, name), hint))
            for name, hint in get_type_hints(kind).items()
        ]
        memory: Any = type(kind.__name__, (SharedRecord,), {"kind": kind, "_fields_": fields})
        memory.layout = np.dtype(memory)
        MEMORIES[kind] = memory
    return MEMORIES[kind]


def _memory_of_field(value: Any, kind: Any) -> Any:
    """C type of a field with a value of a type; an array is stored as addresses."""
    if _names(kind):
        return _memory_of(value)
    if isinstance(value, list):
        return ctypes.c_double * len(value)
    if isinstance(value, np.ndarray):
        memory: Any = ctypes.c_uint64
        for count in value.shape[::-1]:
            memory = memory * count
        return memory
    return ctypes.c_double if kind is float else ctypes.c_int64


def _values(value: Any) -> Any:
    """Nested tuples and lists of a record's values, as NumPy reads them."""
    names = _names(value)
    if names:
        return tuple(_values(getattr(value, name)) for name in names)
    return value.tolist() if isinstance(value, np.ndarray) else value
