"""Types and expressions of translated functions."""

from __future__ import annotations

from typing import Any, NamedTuple


class Type(NamedTuple):
    """Type of a C expression."""

    kind: str  # real, int, bool, complex, none, tuple, record or array
    name: str = ""  # C name of a tuple or record; type of the elements of an array
    fields: tuple[tuple[str, Type], ...] = ()  # names and types of the fields of a tuple or record
    shape: tuple[int, ...] = ()  # sizes of an array

    def field(self, name: str) -> Type:
        """Type of a field."""
        return dict(self.fields)[name]

    @property
    def c(self) -> str:
        """Declaration in C, without the name."""
        if self.kind == "array":
            return f"{ELEMENTS[self.name]} *"
        return f"{self.name} *" if self.kind == "record" else SCALARS.get(self.kind, self.name)


SCALARS = {
    "real": "real",
    "int": "int64_t",
    "bool": "bool",
    "complex": "complex_number",
    "none": "void",
}
ELEMENTS = {"real": "real", "int": "int64_t", "place": "const uint16_t"}
REAL, INT, BOOL, COMPLEX, NONE = (Type(kind) for kind in SCALARS)
NUMBERS = (BOOL, INT, REAL, COMPLEX)


class Code(NamedTuple):
    """C expression and its type; `value` is that of a constant."""

    text: str
    type: Type
    value: Any = None
