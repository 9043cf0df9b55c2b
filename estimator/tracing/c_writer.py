"""Body of one Python function as C99, statement by statement, see `c_functions`."""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
from collections.abc import Sequence
from operator import add, mul, sub, truediv
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from icreckon.estimator.tracing.c_kernel import function_name, literal

LIBRARY = "icreckon."
ARITHMETIC = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
COMPUTED: dict[type, Any] = dict(zip(ARITHMETIC, (add, sub, mul, truediv), strict=True))
RELATION = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
COMPLEX_FUNCTIONS = {ast.Add: "sum", ast.Sub: "difference", ast.Mult: "product"}
BESSEL = ("j0", "y0", "y1", "yn")
RESERVED = ("new", "this", "real", "short", "long", "int", "float", "double", *BESSEL)
OF_MATH = ("sqrt", "exp", "expm1", "cos", "sin", "atan2")


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
    "index": "int32_t",  # of a loop
}
ELEMENTS = {"real": "real", "int": "int64_t", "place": "const uint16_t"}
REAL, INT, BOOL, COMPLEX, NONE, INDEX = (Type(kind) for kind in SCALARS)
NUMBERS = (BOOL, INT, REAL, COMPLEX)  # from the narrowest to the widest


class Code(NamedTuple):
    """C expression with its type."""

    text: str
    type: Type
    value: Any = None  # value of a constant, otherwise None


class FunctionWriter:
    """Writer of one of the `Functions`, for certain types of its parameters."""

    def __init__(
        self, functions: Any, function: Any, parameters: dict[str, Type], result: Type | None
    ) -> None:
        self._functions, self._function, self._parameters = functions, function, parameters
        self._bits = functions.bits
        self.result = result  # without annotation None, until a return statement has been written
        self._globals = function.__globals__
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        self._tree: Any = tree.body[0]
        self._locals = dict(parameters)
        self._unrolled: dict[str, int] = {}
        self._lines: list[str] = []
        self._declared: list[str] = []
        self._indent = "    "
        self._count = 0

    def function(self, name: str) -> str:
        """Write the function with a name in C."""
        for statement in self._tree.body:
            self._statement(statement)
        parameters = [
            f"{c_type.c} {_safe(parameter)}".replace("* ", "*")
            for parameter, c_type in self._parameters.items()
        ]
        head = f"static {(self.result or NONE).c} {name}({', '.join(parameters) or 'void'})"
        unused = [f"    (void){_safe(parameter)};" for parameter in self._parameters]
        return "\n".join([head, "{", *unused, *self._declared, *self._lines, "}", ""])

    def _fail(self, node: ast.AST, what: str = "") -> NotImplementedError:
        return NotImplementedError(
            f"{self._function.__qualname__}: {what or ast.unparse(node).splitlines()[0]} has no form in C"
        )

    def _add(self, line: str) -> None:
        self._lines.append(self._indent + line)

    def _new_name(self, letter: str) -> str:
        """Name of a variable that is new in the function."""
        self._count += 1
        return f"{letter}_{self._count - 1}"

    def _local(self, name: str, c_type: Type, *, is_alias: bool = False) -> None:
        """Declare a local variable if it is new; an alias of an array has no elements."""
        if name not in self._locals:
            self._locals[name] = c_type
            name = _safe(name)
            if c_type.kind == "array" and not is_alias:
                declared = f"{ELEMENTS[c_type.name]} {name}[{math.prod(c_type.shape)}] = {{0}}"
            elif c_type.kind in ("array", "record"):
                declared = f"{c_type.c}{name} = NULL"
            else:
                starts_at_zero = c_type in (*NUMBERS, INDEX) and c_type != COMPLEX
                declared = f"{c_type.c} {name}" + (" = 0" if starts_at_zero else "")
            self._declared += [f"    {declared};", f"    (void){name};"]

    # --- statements ------------------------------------------------------------------------------

    def _statement(self, node: ast.stmt) -> None:
        """Write a statement; docstrings and checks that raise are left out."""
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Raise():
                return
            case ast.Expr(value=value):
                self._add(f"{self._code(value).text};")
            case ast.Assign(targets=targets, value=value):
                self._assign(targets, value)
            case ast.AugAssign(target=target, op=op, value=value):
                before, change = self._code(target), self._code(value)
                self._store(target, self._arithmetic(node, op, before, change))
            case ast.If(test=test, body=body, orelse=orelse):
                if all(isinstance(statement, ast.Raise) for statement in body) and not orelse:
                    return
                self._add(f"if ({self._truth(test)}) {{")
                self._block(body)
                if orelse:
                    self._add("} else {")
                    self._block(orelse)
                self._add("}")
            case ast.While(test=test, body=body, orelse=[]):
                self._add(f"while ({self._truth(test)}) {{")
                self._block(body)
                self._add("}")
            case ast.For(target=ast.Name(id=name), iter=over, body=body, orelse=[]):
                self._for(name, over, body)
            case ast.Return(value=None):
                self._add("return;")
            case ast.Return(value=value) if value is not None:
                self._return(value)
            case _:
                raise self._fail(node)

    def _block(self, body: Sequence[ast.stmt]) -> None:
        """Write the statements of a block, indented once more."""
        outer, self._indent = self._indent, self._indent + "    "
        for statement in body:
            self._statement(statement)
        self._indent = outer

    def _for(self, name: str, over: ast.expr, body: Sequence[ast.stmt]) -> None:
        """Loop over a range or over an array (n,)."""
        if isinstance(over, ast.Call) and _name_of(over.func) == "range":
            self._for_range(name, over, body)
            return
        array = self._code(over)
        if array.type.kind != "array" or len(array.type.shape) != 1:
            raise self._fail(over)
        index = self._new_name("k")
        self._local(name, REAL if array.type.name == "real" else INT)
        self._add(f"for (int {index} = 0; {index} < {array.type.shape[0]}; {index}++) {{")
        self._add(f"    {_safe(name)} = {array.text}[{index}];")
        self._block(body)
        self._add("}")

    def _for_range(self, name: str, over: ast.Call, body: Sequence[ast.stmt]) -> None:
        """Loop over a range; unrolled if its variable is the index of a tuple."""
        bounds = [self._code(arg) for arg in over.args]
        start, stop = bounds[:2] if len(bounds) > 1 else (Code("0", INT, 0), bounds[0])
        if self._indexes_tuple(name, body):
            for k in range(start.value, stop.value):
                self._unrolled[name] = k
                for statement in body:
                    self._statement(statement)
                del self._unrolled[name]
            return
        stride = bounds[2].value if len(bounds) > 2 else 1
        if stride not in (1, -1):
            raise self._fail(over)
        if stop.value is None:
            stop = self._in_variable(Code(f"({INDEX.c})({stop.text})", INDEX))
        relation, step = (">", "--") if stride < 0 else ("<", "++")
        self._local(name, INDEX)
        index = _safe(name)
        self._add(
            f"for ({index} = ({INDEX.c})({start.text}); {index} {relation} {stop.text}; {index}{step}) {{"
        )
        self._block(body)
        self._add("}")

    def _indexes_tuple(self, name: str, body: Sequence[ast.stmt]) -> bool:
        """Return True if a loop's variable is the index of a tuple."""
        nodes = [node for statement in body for node in ast.walk(statement)]
        subscripts = [node for node in nodes if isinstance(node, ast.Subscript)]
        owners = [_name_of(node.value) for node in subscripts if _name_of(node.slice) == name]
        return any(self._locals.get(owner, NONE).kind == "tuple" for owner in owners)

    def _return(self, value: ast.expr) -> None:
        code = self._code(value, self.result)
        self.result = self.result or code.type
        self._add(f"return {self._as(code, self.result).text};")

    def _assign(self, targets: Sequence[ast.expr], value: ast.expr) -> None:
        """Assign one value to one or more targets, or a tuple part by part."""
        first = targets[0]
        if len(targets) > 1:
            code = self._code(value)
            if not isinstance(value, ast.Constant):
                code = self._in_variable(code)
            for target in targets:
                self._store(target, code)
        elif isinstance(first, ast.Tuple) and isinstance(value, ast.Tuple):
            # All values before the first assignment, as in a swap.
            values = []
            for element in value.elts:
                code, is_constant = self._code(element), isinstance(element, ast.Constant)
                values.append(code if is_constant else self._in_variable(code))
            for target, code in zip(first.elts, values, strict=True):
                self._store(target, code)
        elif isinstance(first, ast.Tuple):
            whole = self._in_variable(self._code(value))
            for target, (field, c_type) in zip(first.elts, whole.type.fields, strict=True):
                self._store(target, Code(f"{whole.text}.{field}", c_type))
        else:
            self._store(first, self._code(value))

    def _in_variable(self, code: Code) -> Code:
        """Assign an expression to a new variable, so that it is evaluated once."""
        if code.type.kind in ("record", "array"):
            return code
        name = self._new_name("t")
        self._add(f"const {code.type.c} {name} = {code.text};")
        return Code(name, code.type)

    def _store(self, target: ast.expr, code: Code) -> None:
        """Assign an expression to a variable, an array, one of its elements, or a field."""
        match target:
            case ast.Name(id=name):
                if code.type.kind == "array" and name not in self._locals and code.text == "{0}":
                    self._local(name, code.type)  # its declaration makes the zeros
                    return
                self._local(name, code.type, is_alias=True)
                declared = self._locals[name]
                if declared in (INT, INDEX) and code.type == REAL:
                    raise self._fail(target, f"{name}, first a whole number and then a real one,")
                text = self._as(code, declared).text
                text = f"({INDEX.c})({text})" if declared == INDEX else text
                self._add(f"{_safe(name)} = {text};")
            case ast.Subscript(slice=ast.Slice(lower=None, upper=None)):
                array = self._code(target.value)
                index = self._new_name("k")
                size, kept = math.prod(array.type.shape), self._in_variable(self._as(code, REAL))
                self._add(f"for (int {index} = 0; {index} < {size}; {index}++) {{")
                self._add(f"    {array.text}[{index}] = {kept.text};")
                self._add("}")
            case ast.Subscript() | ast.Attribute():
                place = self._code(target)
                value = self._as(code, place.type).text
                if isinstance(target, ast.Attribute) and place.type in (INT, BOOL):
                    owner = self._code(target.value).type.name
                    value = f"({self._functions.integers.get((owner, target.attr), 'int64_t')})({value})"
                self._add(f"{place.text} = {value};")
            case _:
                raise self._fail(target)

    # --- expressions -----------------------------------------------------------------------------

    def _as(self, code: Code, wanted: Type) -> Code:
        """Convert a number to another type."""
        if wanted in (code.type, INDEX) or code.type.kind in ("tuple", "record", "array"):
            return code
        if wanted == REAL and code.type in (INT, BOOL):
            if code.value is not None:
                return Code(literal(float(code.value), self._bits), REAL, float(code.value))
            return Code(f"(real)({code.text})", REAL)
        if wanted == INT and code.type == BOOL:
            return Code(f"(int64_t)({code.text})", INT)
        if wanted == BOOL:
            return Code(f"{code.text} != 0", BOOL)
        if wanted == COMPLEX:
            zero = literal(0.0, self._bits)
            return Code(f"complex_of({self._as(code, REAL).text}, {zero})", COMPLEX)
        raise NotImplementedError(
            f"{self._function.__qualname__}: {code.text} is {code.type.kind}, not {wanted.kind}"
        )

    def _truth(self, node: ast.expr) -> str:
        return self._as(self._code(node), BOOL).text

    def _constant(self, value: Any, node: ast.AST) -> Code:
        """Literal of a number; `node` is where it stands, for the error of anything else."""
        if isinstance(value, bool | np.bool_):
            return Code("true" if value else "false", BOOL, bool(value))
        if isinstance(value, int | np.integer):
            text = str(value) if -(2**31) < value < 2**31 else f"INT64_C({value})"
            return Code(text, INT, int(value))
        if isinstance(value, float):
            return Code(literal(value, self._bits), REAL, value)
        if isinstance(value, complex):
            parts = ", ".join(literal(part, self._bits) for part in (value.real, value.imag))
            return Code(f"complex_of({parts})", COMPLEX)
        raise self._fail(node)

    def _code(self, node: ast.expr, wanted: Type | None = None) -> Code:
        """Expression in C; a tuple has the `wanted` type."""
        match node:
            case ast.Constant(value=value):
                return self._constant(value, node)
            case ast.Name(id=name) if name in self._unrolled:
                return self._constant(self._unrolled[name], node)
            case ast.Name(id=name) if name in self._locals:
                c_type = self._locals[name]
                return Code(_safe(name), INT if c_type == INDEX else c_type)
            case ast.Name(id=name):
                return self._constant(self._globals.get(name), node)
            case ast.Attribute():
                return self._attribute(node)
            case ast.Subscript():
                return self._subscript(node)
            case ast.BinOp(left=left, op=op, right=right):
                return self._arithmetic(node, op, self._code(left), self._code(right))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return Code(f"!({self._truth(operand)})", BOOL)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                code = self._code(operand)
                if code.value is not None:
                    return self._constant(-code.value, node)
                return Code(f"-({code.text})", INT if code.type == BOOL else code.type)
            case ast.BoolOp(op=op, values=values):
                sign = " && " if isinstance(op, ast.And) else " || "
                return Code(sign.join(f"({self._truth(value)})" for value in values), BOOL)
            case ast.Compare():
                return self._comparison(node)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return self._choice(test, body, orelse)
            case ast.Tuple(elts=elements):
                return self._tuple([self._code(element) for element in elements], wanted)
            case ast.Call():
                return self._call(node)
        raise self._fail(node)

    def _attribute(self, node: ast.Attribute) -> Code:
        """Constant of a module, part of a complex number, or field of a tuple or record."""
        if isinstance(node.value, ast.Name) and node.value.id not in self._locals:
            return self._constant(getattr(self._globals[node.value.id], node.attr), node)
        owner = self._code(node.value)
        if owner.type == COMPLEX:
            part = {"real": "re", "imag": "im"}[node.attr]
            return Code(f"({owner.text}).{part}", REAL)
        # Some fields have the same value in every filter that is exported.
        replaced: Code | None = self._functions.constants.get((owner.type.name, node.attr))
        if replaced is not None:
            return replaced
        field_type = owner.type.field(node.attr)
        # Records are pointers in C, tuples are values.
        text = f"{owner.text}{'->' if owner.type.kind == 'record' else '.'}{node.attr}"
        return Code(f"(&{text})" if field_type.kind == "record" else text, field_type)

    def _subscript(self, node: ast.Subscript) -> Code:
        """Part of a tuple, element of an array, or the rest of its axes as an array."""
        owner = self._code(node.value)
        if owner.type.kind == "tuple":
            place = self._code(node.slice).value
            if place is None:
                raise self._fail(node)
            name, field_type = owner.type.fields[place]
            return Code(f"{owner.text}.{name}", field_type)
        axes = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        places = [self._code(axis) for axis in axes]
        text = ""
        for place, size in zip(places, owner.type.shape, strict=False):
            text = f"({text}) * {size} + {place.text}" if text else place.text
        rest_of_shape = owner.type.shape[len(places) :]
        if rest_of_shape:
            text = f"({owner.text} + ({text}) * {math.prod(rest_of_shape)})"
            return Code(text, owner.type._replace(shape=rest_of_shape))
        element = REAL if owner.type.name == "real" else INT
        return Code(f"{owner.text}[{text}]", element)

    def _arithmetic(self, node: ast.AST, op: ast.operator, left: Code, right: Code) -> Code:
        """Arithmetic on two expressions; its value if both are constants."""
        if isinstance(op, ast.Pow):
            return self._power(node, left, right)
        if type(op) not in ARITHMETIC:
            raise self._fail(node)
        if left.value is not None and right.value is not None:
            return self._constant(COMPUTED[type(op)](left.value, right.value), node)
        # As in Python, the wider type of both; but quotients are real, and bools are integers.
        least = REAL if isinstance(op, ast.Div) else INT
        common = max(left.type, right.type, least, key=NUMBERS.index)
        a, b = self._as(left, common).text, self._as(right, common).text
        if common == COMPLEX:
            return Code(f"complex_{COMPLEX_FUNCTIONS[type(op)]}({a}, {b})", common)
        return Code(f"({a} {ARITHMETIC[type(op)]} {b})", common)

    def _power(self, node: ast.AST, base: Code, power: Code) -> Code:
        if base.value is not None and power.value is not None:
            return self._constant(base.value**power.value, node)
        base = self._as(base, REAL)
        if power.value == 2:
            kept = self._in_variable(base) if not base.text.isidentifier() else base
            return Code(f"({kept.text} * {kept.text})", REAL)
        name = function_name("pow", self._bits)
        return Code(f"{name}({base.text}, {self._as(power, REAL).text})", REAL)

    def _comparison(self, node: ast.Compare) -> Code:
        """Comparison of two numbers, or a chain of them as in `a < b < c`."""
        operands = [self._code(operand) for operand in (node.left, *node.comparators)]
        pairs = []
        for op, a, b in zip(node.ops, operands, operands[1:], strict=False):
            common = max(a.type, b.type, INT, key=NUMBERS.index)
            if common == COMPLEX:
                raise self._fail(node)
            left, right = self._as(a, common).text, self._as(b, common).text
            pairs.append(f"{left} {RELATION[type(op)]} {right}")
        return Code(pairs[0] if len(pairs) == 1 else f"({') && ('.join(pairs)})", BOOL)

    def _choice(self, test: ast.expr, body: ast.expr, orelse: ast.expr) -> Code:
        """Conditional expression; its two numbers get the wider of their types."""
        first, other = self._code(body), self._code(orelse)
        common = first.type
        if common in NUMBERS:
            common = max(common, other.type, key=NUMBERS.index)
        yes, no = self._as(first, common).text, self._as(other, common).text
        return Code(f"(({self._truth(test)}) ? {yes} : {no})", common)

    def _tuple(self, values: Sequence[Code], wanted: Type | None = None) -> Code:
        """Assign values to a new tuple, of the `wanted` type or the types of the values."""
        if wanted is None or wanted.kind != "tuple":
            fields = [(f"_{k}", value.type) for k, value in enumerate(values)]
            wanted = self._functions.tuple_type(fields)
        name = self._new_name("t")
        self._declared.append(f"    {wanted.name} {name};")
        for (field, c_type), value in zip(wanted.fields, values, strict=True):
            self._add(f"{name}.{field} = {self._as(value, c_type).text};")
        return Code(name, wanted)

    def _call(self, node: ast.Call) -> Code:
        """Call of a method, of a function of this package, or of a builtin."""
        if isinstance(node.func, ast.Attribute):
            return self._method(node, node.func)
        if node.keywords:
            raise self._fail(node)
        name = _name_of(node.func)
        args: list[Code] = []
        for arg in node.args:
            if isinstance(arg, ast.Starred):
                whole = self._in_variable(self._code(arg.value))
                fields = whole.type.fields
                args += [Code(f"{whole.text}.{field}", c_type) for field, c_type in fields]
            else:
                args.append(self._code(arg))
        if name in self._globals:
            return self._call_of(node, self._globals[name], args)
        match name:
            case "abs":
                return self._absolute(args[0])
            case "min" | "max":
                return self._extreme(name, args)
            case "int":
                number = args[0]
                is_real = number.type == REAL
                return Code(f"(int64_t)({number.text})", INT) if is_real else self._as(number, INT)
            case "float":
                return self._as(args[0], REAL)
            case "complex":
                parts = ", ".join(self._as(arg, REAL).text for arg in args)
                return Code(f"complex_of({parts})", COMPLEX)
            case "len":
                return self._constant(args[0].type.shape[0], node)
        raise self._fail(node)

    def _call_of(self, node: ast.Call, called: Any, args: Sequence[Code]) -> Code:
        """Call of a named tuple's type, or of a function of this package."""
        if isinstance(called, type) and issubclass(called, tuple):
            return self._tuple(args, self._functions.of_annotation(called))
        if not str(getattr(called, "__module__", "")).startswith(LIBRARY):
            raise self._fail(node)
        parameters = list(inspect.signature(called).parameters.values())
        omitted = [[*parameter.default] for parameter in parameters[len(args) :]]
        defaults = [self._tuple([self._constant(k, node) for k in numbers]) for numbers in omitted]
        all_args = [*args, *defaults]
        name, result = self._functions.name_and_result(called, [arg.type for arg in all_args])
        hints, texts = get_type_hints(called), []
        for parameter, arg in zip(parameters, all_args, strict=True):
            annotated = self._functions.of_annotation(hints.get(parameter.name))
            is_number = annotated is not None and annotated in NUMBERS
            texts.append(self._as(arg, annotated).text if is_number else arg.text)
        return Code(f"{name}({', '.join(texts)})", result)

    def _method(self, node: ast.Call, called: ast.Attribute) -> Code:
        """Call of `np.empty`, `np.zeros`, a function of `math`, or `conjugate`."""
        owner = _name_of(called.value)
        if owner == "np" and called.attr in ("empty", "zeros"):
            shape = node.args[0]
            sizes = shape.elts if isinstance(shape, ast.Tuple) else [shape]
            c_type = Type("array", "real", shape=tuple(self._code(size).value for size in sizes))
            return Code("{0}", c_type)  # an array of zeros
        if owner == "math" and called.attr in OF_MATH:
            name = function_name(called.attr, self._bits)
            reals = [self._as(self._code(arg), REAL).text for arg in node.args]
            return Code(f"{name}({', '.join(reals)})", REAL)
        if called.attr == "conjugate":
            number = self._in_variable(self._code(called.value))
            return Code(f"complex_of({number.text}.re, -{number.text}.im)", COMPLEX)
        raise self._fail(node)

    def _absolute(self, code: Code) -> Code:
        """Absolute value of a number."""
        if code.type == INT:
            return Code(f"larger_int({code.text}, -({code.text}))", INT)
        return Code(f"{function_name('fabs', self._bits)}({self._as(code, REAL).text})", REAL)

    def _extreme(self, name: str, args: Sequence[Code]) -> Code:
        """Smallest or largest of numbers, by the builtin "min" or "max"."""
        common = max(INT, *(arg.type for arg in args), key=NUMBERS.index)
        called = {"min": "smaller", "max": "larger"}[name] + ("_int" if common == INT else "")
        text = self._as(args[0], common).text
        for arg in args[1:]:
            text = f"{called}({text}, {self._as(arg, common).text})"
        return Code(text, common)


def _safe(name: str) -> str:
    """Name of a variable in C, changed if C, C++ or `math.h` reserve it."""
    return f"{name}_" if name in (*OF_MATH, *RESERVED) else name


def _name_of(node: ast.AST) -> str:
    return node.id if isinstance(node, ast.Name) else ""
