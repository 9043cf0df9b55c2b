"""Plain Python functions over records as C99, with the functions that they call.

They are those that numba compiles (`jit_kernel`): numbers, records with field names, named tuples, arrays
of known size, branches and loops. Types of parameters follow from the annotations, or, where these leave
them open, from the first call. Checks that raise are left out: their callers are C code of this package.
The C file defines `real`, `complex_number` with its arithmetic, `smaller` and `larger`.
"""

import inspect
from collections.abc import Callable, Sequence
from typing import Any, get_args, get_origin, get_type_hints

from icreckon.estimator.tracing.c_types import BOOL, COMPLEX, INT, NONE, NUMBERS, REAL, Code, Type
from icreckon.estimator.tracing.c_writer import FunctionWriter


class Functions:
    """Functions in C, each after those that it calls.

    Args:
        bits: number of bits of each number, 64 or 32.
        record_types: C type of each type of record.
        constants: expressions in C in place of fields, by type of record and name.
        integers: types of whole numbers that are no `int64_t`, likewise.

    Attributes:
        text: definitions of the functions so far.
        tuples: definitions of their tuples.
    """

    def __init__(
        self,
        bits: int,
        record_types: dict[type, Type],
        constants: dict[tuple[str, str], Code],
        integers: dict[tuple[str, str], str],
    ) -> None:
        self.bits, self.records = bits, record_types
        self.constants, self.integers = constants, integers
        self.text: list[str] = []
        self.tuples: dict[Type, str] = {}
        self._found: dict[tuple[Any, tuple[Type, ...]], tuple[str, Type]] = {}
        self._names: set[str] = set()

    def translate(self, function: Callable[..., Any], **types: Type) -> None:
        """Translate a function; types of the parameters without annotations are given."""
        hints = get_type_hints(function)
        names = inspect.signature(function).parameters
        found = [types.get(name) or self.of_annotation(hints[name]) for name in names]
        self.called(function, [one or NONE for one in found])

    def called(self, function: Callable[..., Any], types: Sequence[Type]) -> tuple[str, Type]:
        """Name and result of a function for arguments of these types."""
        names = list(inspect.signature(function).parameters)
        hints = get_type_hints(function)
        of = []
        for name, given in zip(names, types, strict=True):
            stated = self.of_annotation(hints.get(name))
            of.append(stated if stated in NUMBERS or (stated and stated.kind == "tuple") else given)
        key = function, tuple(of)
        if key not in self._found:
            name = function.__name__.lstrip("_")
            while name in self._names:
                name += "_"
            self._names.add(name)
            result = self.of_annotation(hints.get("return"))
            writer = FunctionWriter(self, function, dict(zip(names, of, strict=True)), result)
            text = writer.function(name)
            self._found[key] = name, writer.result or NONE
            self.text.append(text)
        return self._found[key]

    def of_annotation(self, hint: Any) -> Type | None:
        """Type that an annotation states; None if it leaves it open."""
        plain = {float: REAL, int: INT, bool: BOOL, complex: COMPLEX, type(None): NONE}
        if hint in plain:
            return plain[hint]
        if isinstance(hint, type) and hint in self.records:
            return self.records[hint]
        if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):
            fields = get_type_hints(hint).items()
            known = [(name, self.of_annotation(of) or REAL) for name, of in fields]
            return self.tuple_type(known, hint.__name__)
        if get_origin(hint) is tuple and Ellipsis not in get_args(hint):
            found = [self.of_annotation(of) for of in get_args(hint)]
            if all(found):
                return self.tuple_type([(f"_{k}", of or REAL) for k, of in enumerate(found)])
        return None

    def tuple_type(self, fields: Sequence[tuple[str, Type]], name: str = "") -> Type:
        """Type of a tuple, which is defined if it is new."""
        name = name or "tuple_" + "".join(
            of.kind[0] if of in NUMBERS else of.name for _, of in fields
        )
        found = Type("tuple", name, tuple(fields))
        if found not in self.tuples:
            lines = "".join(f"    {of.c} {field};\n" for field, of in fields)
            self.tuples[found] = f"typedef struct {{\n{lines}}} {name};\n"
        return found
