"""Vector code of traced numbers, with one filter in each lane.

A kernel reads and writes rows of one flat workspace: row r has a number of each lane, at
`[r * width + lane]`. Kernels are emitted in LLVM's intermediate representation, with vectors as wide as
the machine's registers.
"""

from collections.abc import Sequence
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir

from icreckon.estimator.tracing.kernel import ARRAYS, FLAG_BITS, Kernel, Store
from icreckon.estimator.tracing.trace import IN_ORDER, Traced, reachable

BOOL, INT, LONG = ir.IntType(1), ir.IntType(32), ir.IntType(64)
# Multiply-add may round once instead of twice; no other change of rounding is allowed.
LOOSE = ("contract",)
# A number of the workspace is loaded again after this many operations. The machine has too few registers
# for all numbers, and a copy on the stack would cost a write as well.
RELOAD_AFTER = 150
INTRINSICS = {"sqrt": "llvm.sqrt", "abs": "llvm.fabs", "round": "llvm.rint"}
MIDDLE_ROW = 128  # rows are counted from this one: near ones have shorter instructions


def lanes_of_machine(bits: int) -> int:
    """Number of lanes of the machine's vector registers, by bits of a number."""
    features = llvm.get_host_cpu_features()
    for feature, width in (("avx512f", 512), ("avx2", 256)):
        if features.get(feature):
            return width // bits
    return 128 // bits


def emit(module: Any, symbol: str, kernel: Kernel, width: int, bits: int = 64) -> None:
    """Emit a kernel as function `symbol` of `ARRAYS`, which returns its flags."""
    number = ir.DoubleType() if bits == 64 else ir.FloatType()
    kind = ir.FunctionType(LONG, [number.as_pointer()] * len(ARRAYS))
    _Emitter(ir.Function(module, kind, name=symbol), kernel, width, number).emit()


class _Emitter:
    """Emitter of one kernel into a function, for numbers of an LLVM type (`number`)."""

    def __init__(self, function: Any, kernel: Kernel, width: int, number: Any) -> None:
        self.kernel, self.width, self.number = kernel, width, number
        self.vector, self.truths = ir.VectorType(number, width), ir.VectorType(BOOL, width)
        self.builder = ir.IRBuilder(function.append_basic_block("begin"))
        self.pointers = dict(zip(ARRAYS, function.args, strict=True))
        self.rows = dict(zip(ARRAYS, kernel.rows, strict=True))  # number of rows of each array
        self.values: dict[Traced, Any] = {}  # emitted nodes
        self.wide: dict[Traced, Any] = {}  # values of one number for all lanes, as vectors
        self.loads: dict[
            Traced, tuple[int, Any]
        ] = {}  # operations // RELOAD_AFTER, and loaded value
        self.written: set[tuple[str, int]] = set()  # arrays and rows that were stored
        self.operations = 0  # number of emitted nodes
        self.in_loop = False
        self.align = width * (8 if number == ir.DoubleType() else 4)  # alignment of a row [bytes]

    def emit(self) -> None:
        """Emit the kernel: each number is stored as soon as it is computed."""
        kernel = self.kernel
        for name, pointer in self.pointers.items():
            self.pointers[name] = self.builder.gep(pointer, [LONG(MIDDLE_ROW * self.width)])
        self._hide_pointers()
        wanted = [store.value for store in kernel.stores] + list(kernel.flags)
        nodes = reachable(wanted)
        waiting: dict[Traced, list[Store]] = {}
        for store in kernel.stores:
            waiting.setdefault(store.value, []).append(store)
        loads = {node.extra: node for node in nodes if node.op == "load"}
        for node in sorted(nodes, key=IN_ORDER):
            if node.op != "load" or node in waiting:
                self._compute(node)
            for store in waiting.get(node, ()):
                # Loaded now: the initial number of this row is overwritten.
                if (initial := loads.get((store.array, store.row))) is not None:
                    self._compute(initial)
                self._store(store)
        flags = LONG(0)
        for place, flag in enumerate(kernel.flags):
            bits = self.builder.shl(self._bits(flag), LONG(place * FLAG_BITS))
            flags = self.builder.or_(flags, bits)
        self.builder.ret(flags)

    def _compute(self, node: Traced) -> Any:
        """Value of a node, which is emitted if it is new."""
        if node.op == "load":
            return self._load(node)
        value = self.values.get(node)
        if value is None:
            self.operations += 1
            if self.operations % RELOAD_AFTER == 0 and not self.in_loop:
                self._hide_pointers()
            value = self.values[node] = self._code(node)
        return value

    def _load(self, node: Traced) -> Any:
        """Row of the workspace, which is loaded again after `RELOAD_AFTER` operations."""
        loaded_in, value = self.loads.get(node, (-1, None))
        period = self.operations // RELOAD_AFTER
        # A row that was stored has another number now.
        if value is None or (loaded_in != period and node.extra not in self.written):
            value = self.builder.load(self._address(*node.extra), align=self.align)
            self.loads[node] = period, value
        return value

    def _hide_pointers(self) -> None:
        """Hide from the optimiser that the pointers are unchanged, so that it loads again."""
        for name, pointer in self.pointers.items():
            kind = ir.FunctionType(pointer.type, [pointer.type])
            self.pointers[name] = self.builder.asm(kind, "", "=r,0", [pointer], side_effect=True)

    def _code(self, node: Traced) -> Any:
        """Emit the instructions of a node that is no load; return its value."""
        b = self.builder
        match node.op:
            case "constant":
                return BOOL(int(node.extra)) if node.truth else self.number(node.extra)
            case "scalar":
                array, index = node.extra
                self._require_inside(array, index)
                place = index - MIDDLE_ROW * self.width
                return b.load(b.gep(self.pointers[array], [LONG(place)]))
            case "loop":
                return self._loop(node)
            case "result":
                return self._compute(node.args[0])[node.extra]
        args = [self._compute(arg) if node.uniform else self._widened(arg) for arg in node.args]
        match node.op:
            case "add" | "sub" | "mul" | "neg":
                return getattr(b, f"f{node.op}")(*args, flags=LOOSE)
            case "select":
                return b.select(*args)
            case "and" | "or" | "not":
                return getattr(b, f"{node.op}_")(*args)
            case "compare":
                return b.fcmp_ordered(node.extra, *args)
            case "reciprocal":
                one = [1.0] * self.width if args[0].type == self.vector else 1.0
                return b.fdiv(args[0].type(one), *args)
            case "power_of_two":
                return self._power_of_two(*args)
        return self._call(INTRINSICS[node.op], args)

    def _call(self, name: str, args: list[Any]) -> Any:
        """Call an intrinsic of LLVM, for vectors or single numbers as the arguments are."""
        kind = args[0].type
        number = "f64" if self.number == ir.DoubleType() else "f32"
        suffix = f"v{self.width}{number}" if kind == self.vector else number
        called = f"{name}.{suffix}"
        module = self.builder.module
        function = module.globals.get(called)
        if function is None:
            function = ir.Function(module, ir.FunctionType(kind, [kind] * len(args)), name=called)
        return self.builder.call(function, args)

    def _power_of_two(self, exponent: Any) -> Any:
        """Compute 2 to the power of a whole number by the bits of its format (IEEE 754)."""
        bits, fraction, bias = (64, 52, 1023) if self.number == ir.DoubleType() else (32, 23, 127)
        # The sum has the biased exponent in its lowest bits, from where it is shifted to its place.
        integer, added, kind = ir.IntType(bits), float(2**fraction + bias), exponent.type
        if kind == self.vector:
            as_integer = ir.VectorType(integer, self.width)
            shift, offset = as_integer([fraction] * self.width), kind([added] * self.width)
        else:
            as_integer, shift, offset = integer, integer(fraction), kind(added)
        b = self.builder
        return b.bitcast(b.shl(b.bitcast(b.fadd(exponent, offset), as_integer), shift), kind)

    def _widened(self, node: Traced) -> Any:
        """Vector of a value in all lanes."""
        value = self._compute(node)
        if value.type in (self.vector, self.truths):
            return value
        if node not in self.wide:
            kind = self.truths if node.truth else self.vector
            if node.constant is None:
                b = self.builder
                first = b.insert_element(kind(ir.Undefined), value, INT(0))
                everywhere = ir.VectorType(INT, self.width)([0] * self.width)
                self.wide[node] = b.shuffle_vector(first, kind(ir.Undefined), everywhere)
            else:
                self.wide[node] = kind([value.constant] * self.width)
        return self.wide[node]

    def _require_inside(self, array: str, row: int) -> None:
        """Reject a row beyond an array, which the machine code would read all the same."""
        rows = self.rows[array]
        if not 0 <= row < rows:
            raise ValueError(
                f"kernel {self.kernel.name!r} addresses row {row} of {array!r}, which has {rows}"
            )

    def _address(self, array: str, row: int) -> Any:
        """Pointer to the numbers of all lanes in a row."""
        self._require_inside(array, row)
        b = self.builder
        place = b.gep(self.pointers[array], [LONG((row - MIDDLE_ROW) * self.width)])
        return b.bitcast(place, self.vector.as_pointer())

    def _store(self, store: Store) -> None:
        value = self._widened(store.value)
        self.written.add((store.array, store.row))
        self.builder.store(value, self._address(store.array, store.row), align=self.align)

    def _bits(self, flag: Traced) -> Any:
        """Whole number whose bit k is the flag of lane k."""
        b = self.builder
        lanes = b.bitcast(self._widened(flag), ir.IntType(self.width))
        return b.zext(lanes, LONG)

    def _any(self, flag: Any) -> Any:
        """Truth value that a flag is true in any lane."""
        b = self.builder
        kind = ir.IntType(self.width)
        return b.icmp_unsigned("!=", b.bitcast(flag, kind), kind(0))

    def _loop(self, node_of_loop: Traced) -> list[Any]:
        """Emit the rounds of a loop; return its final values."""
        loop, most = node_of_loop.extra
        b = self.builder
        needed, *first_values = [self._widened(arg) for arg in node_of_loop.args]
        # Values that only the rounds need are computed there; the optimiser moves constant ones out.
        inside = reachable([*loop.results, loop.again]) - set(self.values) - set(loop.carried)
        if most > 1:
            self._compute_loops_of(inside, loop.carried)
        before = b.block
        body, after = b.append_basic_block("round"), b.append_basic_block("settled")
        b.cbranch(self._any(needed), body, after)
        b.position_at_end(body)
        outside = dict(self.values), dict(self.wide), dict(self.loads), self.in_loop
        counter, self.in_loop = self._phi((INT(0), before)), True
        carried = [self._phi((value, before)) for value in first_values]
        self.values.update(zip(loop.carried, carried, strict=True))
        for node in sorted(inside, key=IN_ORDER):
            self._compute(node)
        results = [self._widened(result) for result in loop.results]
        again, rounds, end = self._widened(loop.again), b.add(counter, INT(1)), b.block
        for phi, result in zip([counter, *carried], [rounds, *results], strict=True):
            phi.add_incoming(result, end)
        more = b.and_(self._any(again), b.icmp_signed("<", rounds, INT(most)))
        b.cbranch(more, body, after)
        b.position_at_end(after)
        # Values that were computed inside a round do not exist outside.
        self.values, self.wide, self.loads, self.in_loop = outside
        pairs = zip([*first_values, needed], [*results, again], strict=True)
        return [self._phi((value, before), (result, end)) for value, result in pairs]

    def _phi(self, *incoming: tuple[Any, Any]) -> Any:
        """Value that depends on the block before: pairs of a value and a block."""
        phi = self.builder.phi(incoming[0][0].type)
        for value, block in incoming:
            phi.add_incoming(value, block)
        return phi

    def _compute_loops_of(self, nodes: set[Traced], varying: Sequence[Traced]) -> None:
        """Compute loops without varying numbers, which the optimiser would not move out."""
        for node in sorted(nodes, key=IN_ORDER):
            if node.op == "loop" and reachable([node], with_bodies=True).isdisjoint(varying):
                self._compute(node)
