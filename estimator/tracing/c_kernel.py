"""Kernels of traced numbers as C99, for one lane."""

import math
from collections import defaultdict
from collections.abc import Iterable

from icreckon.estimator.tracing.kernel import FLAG_BITS, Kernel
from icreckon.estimator.tracing.trace import IN_ORDER, Loop, Traced, reachable

OPERATORS = {"add": "+", "sub": "-", "mul": "*", "and": "&&", "or": "||"}
FUNCTIONS = {"sqrt": "sqrt", "abs": "fabs", "round": "rint", "exp": "exp"}


def literal(value: float, bits: int) -> str:
    """Number in C, of the given bits."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return repr(float(value)) + "f" * (bits == 32)


def function_name(name: str, bits: int) -> str:
    """Name of a function of `math.h`, for numbers of the given bits."""
    return name if bits == 64 else f"{name}f"


def kernel_in_c(kernel: Kernel, bits: int) -> str:
    """C function of `lanes`, `inputs` and `constants` that returns the kernel's flags.

    The function has the kernel's name, and numbers of 64 or 32 `bits`. A kernel that stores into an array
    `found` has it as its fourth argument.
    """
    return _Writer(kernel, bits).function()


class _Writer:
    """Writer of one kernel."""

    def __init__(self, kernel: Kernel, bits: int) -> None:
        self._kernel, self._bits = kernel, bits
        self._names: dict[Traced, str] = {}
        self._lines: list[str] = []
        self._indent = "    "

    def function(self) -> str:
        """Write the function, which returns the flags."""
        self._write_nodes()
        flags = [
            f"((uint32_t){self._name(flag)} << {place * FLAG_BITS})"
            for place, flag in enumerate(self._kernel.flags)
        ]
        parameters = "real *lanes, const real *restrict inputs, const real *restrict constants"
        if any(store.array == "found" for store in self._kernel.stores):
            parameters += ", real *restrict found"
        unused = [f"    (void){array};" for array in ("lanes", "inputs", "constants")]
        body = [*unused, *self._lines, f"    return {' | '.join(flags) or '0'};"]
        head = f"static uint32_t {self._kernel.name}({parameters})"
        return "\n".join([head, "{", *body, "}", ""])

    def _write_nodes(self) -> None:
        """Write the nodes in order, and each store after the nodes that it needs."""
        stores, flags = self._kernel.stores, self._kernel.flags
        outputs = [store.value for store in stores] + list(flags)
        waiting = defaultdict(list)
        for store in stores:
            waiting[store.value].append(store)
        loads = {
            node.extra: node for node in reachable(outputs, with_bodies=True) if node.op == "load"
        }
        nodes = reachable(outputs)
        last_uses = _last_uses(nodes, flags)
        for node in sorted(nodes, key=IN_ORDER):
            self._name(node)
            for store in waiting.get(node, ()):
                overwritten = loads.get((store.array, store.row))
                if overwritten is not None and last_uses.get(overwritten, -1) > node.number:
                    self._keep(overwritten)
                self._add(f"{store.array}[{store.row}] = {self._name(node)};")

    def _add(self, line: str) -> None:
        self._lines.append(self._indent + line)

    def _name(self, node: Traced) -> str:
        """Expression of a node that has been computed, or of one that needs no line."""
        if node in self._names:
            return self._names[node]
        match node.op:
            case "constant":
                if node.truth:
                    return "true" if node.extra else "false"
                return literal(node.extra, self._bits)
            case "load" | "scalar":
                array, row = node.extra
                return f"{array}[{row}]"
            case "loop":
                self._loop(node)
                return ""
        return self._keep(node)

    def _keep(self, node: Traced) -> str:
        """Compute a node in a line of its own."""
        kind = "bool" if node.truth else "real"
        code = self._name(node) if node.op == "load" else self._code(node)
        self._names[node] = name = f"v{node.number}"
        self._add(f"const {kind} {name} = {code};")
        return name

    def _code(self, node: Traced) -> str:
        """Expression of an operation on nodes that are computed."""
        args = [self._name(arg) for arg in node.args]
        match node.op:
            case "neg":
                return f"-({args[0]})"
            case "not":
                return f"!{args[0]}"
            case "compare":
                return f"{args[0]} {node.extra} {args[1]}"
            case "select":
                return f"{args[0]} ? {args[1]} : {args[2]}"
            case "reciprocal":
                return f"{literal(1.0, self._bits)} / {args[0]}"
        if node.op in OPERATORS:
            return f"{args[0]} {OPERATORS[node.op]} {args[1]}"
        return f"{function_name(FUNCTIONS[node.op], self._bits)}({args[0]})"

    def _loop(self, loop_node: Traced) -> None:
        """Write a loop; its carried values are variables, and its results after it."""
        loop: Loop
        loop, most = loop_node.extra
        needed, *first_values = [self._name(arg) for arg in loop_node.args]
        names = [f"l{loop_node.number}_{k}" for k in range(len(first_values))]
        again = f"l{loop_node.number}_again"
        for name, value in zip(names, first_values, strict=True):
            self._add(f"real {name} = {value};")
        self._add(f"bool {again} = {needed};")
        round_ = f"l{loop_node.number}_round"
        self._add(f"for (int {round_} = 0; {again} && {round_} < {most}; {round_}++) {{")
        outer, self._indent = self._indent, self._indent + "    "
        names_before = dict(self._names)
        self._names.update(zip(loop.carried, names, strict=True))
        inside = reachable([*loop.results, loop.again]) - set(names_before) - set(loop.carried)
        for node in sorted(inside, key=IN_ORDER):
            self._name(node)
        results = [self._name(result) for result in loop.results]
        for k, result in enumerate(results):
            self._add(f"const real {names[k]}_next = {result};")
        self._add(f"{again} = {self._name(loop.again)};")
        for name in names:
            self._add(f"{name} = {name}_next;")
        self._indent = outer
        self._add("}")
        self._names = names_before
        self._names[loop_node] = ""
        for name, result_node in zip([*names, again], _results_of(loop_node), strict=True):
            if result_node is not None:
                self._names[result_node] = name


def _results_of(loop_node: Traced) -> list[Traced | None]:
    """Results of a loop, in their order; None for those that are not used."""
    results: list[Traced | None] = [None] * len(loop_node.args)
    for node in Traced._nodes.values():
        if node.op == "result" and node.args[0] is loop_node:
            results[node.extra] = node  # the place of a result is its `extra`
    return results


def _last_uses(nodes: Iterable[Traced], flags: Iterable[Traced]) -> dict[Traced, int]:
    """Node -> number of the newest node that needs it, also in the body of a loop."""
    last_uses: dict[Traced, int] = {}
    top = set(nodes)
    for node in top:
        for needed in (*node.args, *(_needs_of_body(node, top) if node.op == "loop" else ())):
            last_uses[needed] = max(last_uses.get(needed, -1), node.number)
    for flag in flags:
        last_uses[flag] = 2**62  # the return statement
    return last_uses


def _needs_of_body(loop_node: Traced, top: set[Traced]) -> set[Traced]:
    """Nodes that the rounds of a loop read, down to those that are computed before it."""
    loop, _ = loop_node.extra
    seen, to_visit = {loop_node}, [*loop.results, loop.again]
    while to_visit:
        node = to_visit.pop()
        is_new = node not in seen
        seen.add(node)
        if is_new and not (node in top and node.number < loop_node.number):
            to_visit += node.args
            if node.op == "loop":
                inner, _ = node.extra
                to_visit += [*inner.results, inner.again]
    return seen
