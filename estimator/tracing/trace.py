"""Traced numbers, whose operations are recorded and compiled for many lanes.

A `Traced` stands for one number of each lane. Functions of numbers (for example those of
`icreckon.estimator.motion.index_model`) are run once with traced numbers for arguments, through
`icreckon.estimator.tracing.elementary.traced`, and their operations become a graph. The graph contains
each expression once. Constant zeros and ones are left out as it is built: a Jacobian's zeros cost
nothing.

The functions of this module take plain numbers, too (`numpy.float64`, which follows IEEE 754 as machine
code does). So a function of traced numbers can be executed in Python, step by step in a debugger.
"""

from __future__ import annotations

import builtins
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar, NamedTuple, TypeAlias, cast

import numpy as np

IN_ORDER = operator.attrgetter("number")  # order in which numbers were made
COMMUTATIVE = {"add", "mul", "and", "or"}  # operations whose arguments may be exchanged
RELATIONS: dict[str, Callable[[float, float], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
    "==": operator.eq,
}
Real: TypeAlias = Any  # a traced or a plain number
Truth: TypeAlias = Any  # a traced or a plain truth value
Operator: TypeAlias = "Callable[[Traced, Any], Traced]"


def _both_ways(operation: Callable[[Traced, Traced], Traced]) -> tuple[Operator, Operator]:
    """Make the methods of an operator with a traced number on the left, on the right."""
    return lambda a, b: operation(a, lift(b)), lambda b, a: operation(lift(a), b)


def _comparison(relation: str) -> Operator:
    return lambda a, b: _compare(relation, a, lift(b))


class Traced:
    """A number or truth value in each lane."""

    __slots__ = ("args", "extra", "number", "op", "truth", "uniform")
    # NumPy's arrays leave operations with traced numbers to this class.
    __array_ufunc__ = None
    _nodes: ClassVar[dict[Any, Traced]] = {}
    _known: ClassVar[Mapping[tuple[str, int], float]] = {}
    has_exp: ClassVar[bool] = False  # the target has a function of the exponential
    bits: ClassVar[int] = 64  # number of bits of all numbers of the graph

    op: str  # operation that it results from
    args: tuple[Traced, ...]  # arguments of the operation
    extra: Any  # value of a constant, place of an input, or another property of the operation
    number: int  # place in the order of creation
    uniform: bool  # it is the same in all lanes
    truth: bool  # it is a truth value

    @property
    def real(self) -> Traced:
        """Real part, the number itself."""
        return self

    @property
    def constant(self) -> float | None:
        """Value of a constant; None for any other number."""
        return cast(float, self.extra) if self.op == "constant" else None

    __add__, __radd__ = _both_ways(lambda a, b: _add(a, b))  # noqa: PLW0108 - it is defined below
    __sub__, __rsub__ = _both_ways(lambda a, b: _subtract(a, b))  # noqa: PLW0108 - it is defined below
    __mul__, __rmul__ = _both_ways(lambda a, b: _multiply(a, b))  # noqa: PLW0108 - it is defined below
    __truediv__, __rtruediv__ = _both_ways(lambda a, b: _multiply(a, _reciprocal(b)))
    __gt__, __ge__ = _comparison(">"), _comparison(">=")
    __lt__, __le__ = _comparison("<"), _comparison("<=")
    __eq__ = _comparison("==")  # type: ignore[assignment]

    def __neg__(self) -> Traced:
        return _negate(self)

    def __abs__(self) -> Traced:
        return _unary("abs", self, abs)

    def __pow__(self, power: float) -> Traced:
        if power == 0.5:
            return _unary("sqrt", self, math.sqrt)
        if power == 2:
            return self * self
        raise NotImplementedError(f"a traced number to the power of {power!r}")

    def __and__(self, other: Any) -> Traced:
        return _logical("and", self, other)

    def __or__(self, other: Any) -> Traced:
        return _logical("or", self, other)

    __rand__, __ror__ = __and__, __or__

    def __invert__(self) -> Traced:
        return _make("not", (self,), truth=True)

    __hash__ = object.__hash__

    def __bool__(self) -> bool:
        raise TypeError("a traced truth value cannot decide a branch: use select")


def start(bits: int = 64) -> None:
    """Start a new graph, the only one, of numbers of 64 or 32 `bits`."""
    Traced._nodes, Traced.bits = {}, bits


@contextmanager
def for_c(known: Mapping[tuple[str, int], float]) -> Iterator[None]:
    """Make graphs for C; constants replace known uniform inputs, by array and index."""
    Traced._known, Traced.has_exp = known, True
    try:
        yield
    finally:
        Traced._known, Traced.has_exp = {}, False


def lift(value: Any) -> Traced:
    """Make a traced number of a plain one."""
    if isinstance(value, Traced):
        return value
    # Zeros of both signs are one node: it is 0.0, which costs less than -0.0.
    return _make("constant", (), float(value) + 0.0, uniform=True)


def lane_input(array: str, row: int) -> Traced:
    """Input of each lane: a row of an array."""
    return _make("load", (), (array, row))


def uniform_input(array: str, index: int) -> Traced:
    """Input that is the same in all lanes, from an array."""
    value = Traced._known.get((array, index))
    return _make("scalar", (), (array, index), uniform=True) if value is None else lift(value)


def select(condition: Any, yes: Any, no: Any) -> Any:
    """Choose one of two values by a truth value."""
    if not isinstance(condition, Traced):
        return yes if condition else no
    yes, no = lift(yes), lift(no)
    return yes if yes is no else _make("select", (condition, yes, no))


def minimum(first: Any, second: Any) -> Any:
    """Smaller of two numbers, the first if they are equal."""
    if not (isinstance(first, Traced) or isinstance(second, Traced)):
        return builtins.min(first, second)
    return select(lift(second) < first, second, first)


def maximum(first: Any, second: Any) -> Any:
    """Larger of two numbers, the first if they are equal."""
    if not (isinstance(first, Traced) or isinstance(second, Traced)):
        return builtins.max(first, second)
    return select(lift(second) > first, second, first)


def rounded(value: Any) -> Any:
    """Nearest whole number."""
    return _unary("round", value, round) if isinstance(value, Traced) else np.rint(value)


def function_of_exp(exponent: Traced) -> Traced:
    """Exponential by the target's own function, see `Traced.has_exp`."""
    return _unary("exp", exponent, math.exp)


def power_of_two(exponent: Traced) -> Traced:
    """Two to the power of a whole number, if that is a normal number."""
    return _unary("power_of_two", exponent, lambda value: 2.0**value)


def truth_as_number(value: Any) -> Any:
    """Real of a truth value: 1 or 0."""
    return select(value, 1.0, 0.0)


def is_zero(value: Any) -> bool:
    """Return True if a number is zero in every lane and always: the constant zero."""
    if isinstance(value, Traced):
        return value.constant == 0.0
    return type(value) is float and value == 0.0


class Loop(NamedTuple):
    """Loop of rounds while any lane needs one."""

    carried: list[Traced]  # values at the start of a round
    results: list[Traced]  # the same values at its end
    again: Traced  # truth value of each lane: it needs another round


def repeat(
    needed: Any,
    initial: Sequence[Any],
    a_round: Callable[..., tuple[Sequence[Any], Any]],
    most: int,
) -> list[Any]:
    """Repeat a round while any lane needs one, up to a highest number of rounds.

    All lanes take part in each round, so `a_round` must not change the results of lanes that need none.
    From the values it makes those after a round, and the truth value of another round.

    Returns:
        The final values, and the truth value of one more round.
    """
    if not isinstance(needed, Traced):
        plain_values = initial
        for _ in range(most):
            if needed:
                plain_values, needed = a_round(*plain_values)
        return [*plain_values, needed]
    begin = [lift(value) for value in initial]
    carried = [_fresh("carried", index) for index in range(len(begin))]
    results, again = a_round(*carried)
    loop = Loop(carried, [lift(value) for value in results], again)
    node = _fresh("loop", (loop, most), (lift_truth(needed), *begin))
    values = [_make("result", (node,), index) for index in range(len(begin))]
    return [*values, _make("result", (node,), len(begin), truth=True)]


def lift_truth(value: Any) -> Traced:
    """Make a traced truth value of a plain one."""
    if isinstance(value, Traced):
        return value
    return _make("constant", (), float(value), uniform=True, truth=True)


def both(first: Any, second: Any) -> Any:
    """Truth value that both are true; None stands for True."""
    if first is None or second is None:
        return second if first is None else first
    return first & second


def where_needed(
    needed: Any, usual: Sequence[Any], instead: Callable[[], Sequence[Any]]
) -> list[Any]:
    """Values of `instead` in lanes that need them, computed only if there are such."""
    if not isinstance(needed, Traced):
        return list(instead() if needed else usual)

    def a_round(*values: Traced) -> tuple[Sequence[Traced], Traced]:
        chosen = [select(needed, *pair) for pair in zip(instead(), values, strict=True)]
        return chosen, lift_truth(False)

    return repeat(needed, usual, a_round, 1)[:-1]


def reachable(wanted: Iterable[Traced], *, with_bodies: bool = False) -> set[Traced]:
    """Nodes that some numbers depend on, with or without those in the bodies of loops."""
    nodes: set[Traced] = set()
    to_visit = list(wanted)
    while to_visit:
        node = to_visit.pop()
        if node not in nodes:
            nodes.add(node)
            to_visit.extend(node.args)
            if with_bodies and node.op == "loop":
                loop, _ = node.extra
                to_visit += [*loop.results, loop.again]
    return nodes


# --- graph ----------------------------------------------------------------------------------------


def _make(
    op: str,
    args: tuple[Traced, ...],
    extra: Any = None,
    *,
    uniform: bool = False,
    truth: bool = False,
) -> Traced:
    """Make a number, or find the equal one; uniform arguments make it uniform."""
    numbers = [arg.number for arg in args]
    key = (op, tuple(sorted(numbers) if op in COMMUTATIVE else numbers), extra, truth)
    node = Traced._nodes.get(key)
    if node is None:
        uniform = uniform or (bool(args) and all(arg.uniform for arg in args))
        node = Traced._nodes[key] = _new(op, args, extra, uniform, truth)
    return node


def _fresh(op: str, extra: Any, args: tuple[Traced, ...] = ()) -> Traced:
    """Make a number that is equal to no other."""
    node = _new(op, args, extra, False, False)
    Traced._nodes["fresh", node.number] = node
    return node


def _new(op: str, args: tuple[Traced, ...], extra: Any, uniform: bool, truth: bool) -> Traced:
    """Make a number with the next place in the order of creation."""
    node = object.__new__(Traced)
    node.op, node.args, node.extra = op, args, extra
    node.uniform, node.truth = uniform, truth
    node.number = len(Traced._nodes)
    return node


def _add(a: Traced, b: Traced) -> Traced:
    if a.constant is not None and b.constant is not None:
        return lift(a.constant + b.constant)
    if a.constant == 0.0:
        return b
    if b.constant == 0.0:
        return a
    if b.op == "neg":
        return _subtract(a, b.args[0])
    if a.op == "neg":
        return _subtract(b, a.args[0])
    return _make("add", (a, b))


def _subtract(a: Traced, b: Traced) -> Traced:
    if a.constant is not None and b.constant is not None:
        return lift(a.constant - b.constant)
    if b.constant == 0.0:
        return a
    if a.constant == 0.0:
        return _negate(b)
    if a is b:
        return lift(0.0)
    if b.op == "neg":
        return _add(a, b.args[0])
    return _make("sub", (a, b))


def _negate(a: Traced) -> Traced:
    if a.constant is not None:
        return lift(-a.constant)
    if a.op == "neg":
        return a.args[0]
    if a.op == "sub":
        return _make("sub", (a.args[1], a.args[0]))
    return _make("neg", (a,))


def _multiply(a: Traced, b: Traced) -> Traced:
    if a.truth:
        a = truth_as_number(a)
    if b.truth:
        b = truth_as_number(b)
    if a.constant is not None and b.constant is not None:
        return lift(a.constant * b.constant)
    if b.constant is not None:
        a, b = b, a
    if a.constant is not None:
        if a.constant == 0.0:
            return a
        if a.constant == 1.0:
            return b
        if a.constant == -1.0:
            return _negate(b)
        if a.constant < 0.0:
            return _negate(_multiply(lift(-a.constant), b))
    if a.op == "neg":
        return _negate(_multiply(a.args[0], b))
    if b.op == "neg":
        return _negate(_multiply(a, b.args[0]))
    # A number times a choice between 0 and 1 is a choice, which costs no product.
    for flag, other in ((a, b), (b, a)):
        if flag.op == "select" and {flag.args[1].constant, flag.args[2].constant} == {0.0, 1.0}:
            condition, yes, _ = flag.args
            chosen = (other, 0.0) if yes.constant == 1.0 else (0.0, other)
            return cast(Traced, select(condition, *chosen))
    return _make("mul", (a, b))


def _reciprocal(a: Traced) -> Traced:
    if a.constant is not None:
        return lift(1.0 / a.constant)
    if a.op == "neg":
        return _negate(_reciprocal(a.args[0]))
    return _make("reciprocal", (a,))


def _unary(op: str, a: Traced, plain_function: Callable[[float], float]) -> Traced:
    if a.constant is not None:
        return lift(plain_function(a.constant))
    if op == "abs" and a.op == "neg":
        a = a.args[0]
    return _make(op, (a,))


def _compare(relation: str, a: Traced, b: Traced) -> Traced:
    if a.constant is not None and b.constant is not None:
        return lift_truth(RELATIONS[relation](a.constant, b.constant))
    return _make("compare", (a, b), relation, truth=True)


def _logical(op: str, a: Any, b: Any) -> Traced:
    a, b = lift_truth(a), lift_truth(b)
    for constant, other in ((a, b), (b, a)):
        if constant.constant is not None:
            # False and x is False, True or x is True.
            decides = (constant.constant == 0.0) == (op == "and")
            return cast(Traced, constant if decides else other)
    return _make(op, (a, b), truth=True)
