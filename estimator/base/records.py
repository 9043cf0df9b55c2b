"""Records with field names that plain Python and compiled code both read.

In Python a record is a mutable `msgspec.Struct`, whose attributes are fast. For numba it is an element of
a NumPy structured array whose fields have the same names. A function that uses nothing but attributes of
a record is written once for both. A shared record is both at once: in Python a C structure with these
attributes, for numba an array on its memory (`array_on`).
"""

from __future__ import annotations

import ctypes
from typing import Any, ClassVar, TypeVar, cast, get_type_hints

import msgspec
import numpy as np
from numpy.typing import NDArray

Record = TypeVar("Record")

# Stamp of a sample that has not come yet [ns]; its age exceeds 140 years at any stamp after 1970.
NEVER = -(2**62)
# Layouts of shared records by themselves: numba recognises a layout faster if it is the same object.
LAYOUTS: dict[np.dtype[Any], np.dtype[Any]] = {}


class SharedRecord(ctypes.Structure):
    """Record whose memory compiled code reads and writes; a copy has its own memory.

    Attributes:
        kind: type of the record.
    """

    kind: ClassVar[type]

    def __reduce__(self) -> tuple[Any, ...]:
        whole: Any = self._b_base_
        if whole is None:
            return shared_record, (record_of(self.kind, array_on(self)[0]),)
        # A part of a record is that part of the copy.
        offset = ctypes.addressof(self) - ctypes.addressof(whole)
        parts = (name for name, _ in whole._fields_ if getattr(type(whole), name).offset == offset)
        return getattr, (whole, next(parts))


def shared_record(record: Record) -> Record:
    """Copy a record to memory that Python and compiled code share."""
    shared = _memory_of(record)()
    array_on(shared)[:] = record_array(record, 1)
    return cast(Record, shared)


def array_on(shared: Any) -> NDArray[Any]:
    """Structured array (1,) on the memory of a shared record."""
    layout = np.dtype(type(shared))
    return np.frombuffer(shared, LAYOUTS.setdefault(layout, layout))


def record_array(record: Any, count: int) -> NDArray[Any]:
    """Structured array (count,) of copies of a record.

    Args:
        record: integers, floats, lists of floats, other records and named tuples.
        count: number of copies.
    """
    return np.full(count, np.array(_values(record), dtype=np.dtype(_memory_of(record))))


def record_of(kind: type[Record], element: Any) -> Record:
    """Record of a type from an element of a structured array."""
    values = {}
    for name, of in get_type_hints(kind).items():
        value = element[name]
        values[name] = record_of(of, value) if _names(of) else value.tolist()
    return kind(**values)


def assign(record: Any, source: msgspec.Struct) -> None:
    """Copy the values of a record to another one, which may be shared."""
    for name in source.__struct_fields__:
        value = getattr(source, name)
        if isinstance(value, msgspec.Struct):
            assign(getattr(record, name), value)
        elif isinstance(value, list):
            getattr(record, name)[:] = value
        else:
            setattr(record, name, value)


def _names(record: Any) -> tuple[str, ...]:
    """Field names of a record, named tuple, or their type; () for other values."""
    return cast(
        tuple[str, ...], getattr(record, "__struct_fields__", getattr(record, "_fields", ()))
    )


def _memory_of(value: Any) -> Any:
    """C type of a record or of a value."""
    if names := _names(value):
        fields = [(name, _memory_of(getattr(value, name))) for name in names]
        kind = type(value)
        return type(kind.__name__, (SharedRecord,), {"kind": kind, "_fields_": fields})
    if isinstance(value, list):
        return ctypes.c_double * len(value)
    return ctypes.c_int64 if isinstance(value, int) else ctypes.c_double


def _values(value: Any) -> Any:
    names = _names(value)
    return tuple(_values(getattr(value, name)) for name in names) if names else value
