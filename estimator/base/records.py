"""Records with field names that plain Python and compiled code both read.

In Python a record is a mutable `msgspec.Struct`, whose attributes are fast. For numba it is an element of
a NumPy structured array whose fields have the same names. A function that uses nothing but attributes of
a record is written once for both.
"""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

Record = TypeVar("Record", bound=msgspec.Struct)

# Stamp of a sample that has not come yet [ns]; its age exceeds 140 years at any stamp after 1970.
NEVER = -(2**62)


def record_array(record: msgspec.Struct, count: int) -> NDArray[Any]:
    """Structured array (count,) of copies of a record.

    Args:
        record: integers, floats, lists of floats and other records.
        count: number of copies.
    """
    return np.full(count, np.array(_values(record), dtype=_dtype(record)))


def record_of(kind: type[Record], element: Any) -> Record:
    """Record of a type from an element of a structured array."""
    values = {}
    for field in msgspec.structs.fields(kind):
        value = element[field.name]
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct):
            values[field.name] = record_of(field.type, value)
        else:
            values[field.name] = value.tolist()
    return kind(**values)


def _dtype(value: Any) -> Any:
    if isinstance(value, msgspec.Struct):
        fields = {name: _dtype(getattr(value, name)) for name in value.__struct_fields__}
        names, formats = list(fields), list(fields.values())
        return np.dtype({"names": names, "formats": formats}, align=True)
    if isinstance(value, list):
        return np.dtype((np.float64, (len(value),)))
    return np.dtype(np.int64 if isinstance(value, int) else np.float64)


def _values(value: Any) -> Any:
    if isinstance(value, msgspec.Struct):
        return tuple(_values(getattr(value, name)) for name in value.__struct_fields__)
    return value
