"""Records of the filter as C structures, and their initial values."""

import ctypes
from typing import Any

from icreckon.estimator.base.records import CLOCK, field_types
from icreckon.estimator.tracing.c_kernel import literal
from icreckon.estimator.tracing.c_writer import INT, REAL, Type


class Records:
    """Structures in C of the types of records.

    Args:
        bits: number of bits of each number, 64 or 32.
        without: fields that the structure of a type of record does not get.

    Attributes:
        types: C type of each type of record.
        text: definitions of the structures.
        integers: types of whole numbers that are no `int64_t`, by structure and field.
    """

    def __init__(self, bits: int, without: dict[type, frozenset[str]]) -> None:
        self._bits, self._without = bits, without
        self.types: dict[type, Type] = {}
        self.text: list[str] = []
        self.integers: dict[tuple[str, str], str] = {}

    def add(self, memory: Any) -> Type:
        """Add a type of record and those in it, by the memory that Python and numba share."""
        record_type = memory.kind
        if record_type in self.types:
            return self.types[record_type]
        name, hints = f"icr_{record_type.__name__}", field_types(record_type)
        fields, lines = [], []
        for field, memory_type in self._fields(memory):
            if hasattr(memory_type, "kind"):  # a record in the record
                c_type = self.add(memory_type)
                lines.append(f"    {c_type.name} {field};")
            elif issubclass(memory_type, ctypes.Array):
                c_type = Type("array", "real", shape=(memory_type._length_,))
                lines.append(f"    icr_real {field}[{memory_type._length_}];")
            elif memory_type is ctypes.c_double:
                c_type = REAL
                lines.append(f"    icr_real {field};")
            else:
                c_type, integer = INT, "int64_t"  # for stamps; counts and flags need 32 bits
                if CLOCK not in getattr(hints[field], "__metadata__", ()):
                    integer = self.integers[name, field] = "int32_t"
                lines.append(f"    {integer} {field};")
            fields.append((field, c_type))
        self.types[record_type] = Type("record", name, tuple(fields))
        # Those of four bytes last: between others they would need padding.
        lines.sort(key=lambda line: line.split()[0] in ("int32_t", "icr_real"))
        self.text.append("\n".join(["typedef struct {", *lines, f"}} {name};", ""]))
        return self.types[record_type]

    def initial(self, record: Any, path: str) -> list[str]:
        """Assignments in C, at `path`, of the numbers of a record that are not zero."""
        lines: list[str] = []
        for field, memory_type in self._fields(record):
            value, place = getattr(record, field), f"{path}.{field}"
            if hasattr(memory_type, "kind"):
                lines += self.initial(value, place)
            elif memory_type is ctypes.c_double and value:
                lines.append(f"    {place} = {literal(value, self._bits)};")
            elif memory_type is ctypes.c_int64 and value:
                lines.append(f"    {place} = INT64_C({value});")
        return lines

    def _fields(self, memory: Any) -> list[tuple[str, Any]]:
        """Name and type of the fields of a record's memory that its structure has."""
        without = self._without.get(memory.kind, frozenset())
        return [(name, memory_type) for name, memory_type in memory._fields_ if name not in without]
