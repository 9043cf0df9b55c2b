"""Plain Python functions over records as C99, with the functions that they call.

These functions are those that numba compiles (`jit_kernel`): numbers, records with field names, named
tuples, arrays of known size, branches and loops. Types of parameters follow from the annotations, or,
where these leave them open, from the first call. Checks that raise are left out: their callers are C code
of this package. The C file defines `real`, `complex_number` with its arithmetic, `smaller` and `larger`.
"""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, get_args, get_origin, get_type_hints

from icreckon.estimator.tracing import c_writer
from icreckon.estimator.tracing.c_writer import BOOL, COMPLEX, INT, NONE, NUMBERS, REAL, Code, Type


@dataclass
class Functions:
    """Functions in C, each after those that it calls."""

    bits: int  # number of bits of each number, 64 or 32
    records: dict[type, Type]  # C type of each type of record
    constants: dict[tuple[str, str], Code]  # expressions in place of fields, by record and name
    integers: dict[tuple[str, str], str]  # types of whole numbers that are no `int64_t`, likewise

    def __post_init__(self) -> None:
        self.text: list[str] = []  # definitions of the functions so far
        self.tuples: dict[Type, str] = {}  # definitions of their tuples
        self._translated: dict[tuple[Any, tuple[Type, ...]], tuple[str, Type]] = {}
        self._names: set[str] = set()

    def translate(self, function: Callable[..., Any], **types: Type) -> None:
        """Translate a function; `types` of parameters come before their annotations."""
        hints = get_type_hints(function)
        names = inspect.signature(function).parameters
        known = [types.get(name) or self.of_annotation(hints[name]) for name in names]
        self.name_and_result(function, [c_type or NONE for c_type in known])

    def name_and_result(
        self, function: Callable[..., Any], types: Sequence[Type]
    ) -> tuple[str, Type]:
        """Name in C and type of the result of a function; translate it if it is new."""
        names = list(inspect.signature(function).parameters)
        hints = get_type_hints(function)
        used_types = []
        for name, argument_type in zip(names, types, strict=True):
            annotated = self.of_annotation(hints.get(name))
            is_used = annotated is not None and (annotated in NUMBERS or annotated.kind == "tuple")
            used_types.append(annotated if annotated and is_used else argument_type)
        key = function, tuple(used_types)
        if key not in self._translated:
            name = function.__name__.lstrip("_")
            while name in self._names:
                name += "_"
            self._names.add(name)
            result = self.of_annotation(hints.get("return"))
            parameters = dict(zip(names, used_types, strict=True))
            writer = c_writer.FunctionWriter(self, function, parameters, result)
            text = writer.function(name)
            self._translated[key] = name, writer.result or NONE
            self.text.append(text)
        return self._translated[key]

    def of_annotation(self, hint: Any) -> Type | None:
        """Type that an annotation states; None if it leaves it open."""
        plain = {float: REAL, int: INT, bool: BOOL, complex: COMPLEX, type(None): NONE}
        if hint in plain:
            return plain[hint]
        if isinstance(hint, type) and hint in self.records:
            return self.records[hint]
        if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):
            fields = get_type_hints(hint).items()
            typed = [(name, self.of_annotation(field_hint) or REAL) for name, field_hint in fields]
            return self.tuple_type(typed, hint.__name__)
        if get_origin(hint) is tuple and Ellipsis not in get_args(hint):
            types = [self.of_annotation(element) for element in get_args(hint)]
            known = [c_type for c_type in types if c_type is not None]
            if len(known) == len(types):
                return self.tuple_type([(f"_{k}", c_type) for k, c_type in enumerate(known)])
        return None

    def tuple_type(self, fields: Sequence[tuple[str, Type]], name: str = "") -> Type:
        """Type of a tuple, which is defined if it is new."""
        parts = [c_type.kind[0] if c_type in NUMBERS else c_type.name for _, c_type in fields]
        name = name or "tuple_" + "".join(parts)
        result = Type("tuple", name, tuple(fields))
        if result not in self.tuples:
            lines = "".join(f"    {c_type.c} {field};\n" for field, c_type in fields)
            self.tuples[result] = f"typedef struct {{\n{lines}}} {name};\n"
        return result
