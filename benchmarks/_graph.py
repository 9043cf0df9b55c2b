"""The traced step of the filter worked out by another array library: NumPy, or JAX."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from icreckon.estimator.tracing.emit import reachable
from icreckon.estimator.tracing.kernel import Kernel
from icreckon.estimator.tracing.trace import Traced

OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "negate": lambda a: -a,
    "reciprocal": lambda a: 1.0 / a,
    "and": lambda a, b: a & b,
    "or": lambda a, b: a | b,
    "not": lambda a: ~a,
}
COMPARISONS: dict[str, Callable[..., Any]] = {
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    "==": lambda a, b: a == b,
}


def step_function(
    kernel: Kernel,
    xp: Any,
    while_loop: Callable[[Any, Any, Any, int], Any],
) -> Callable[[list[Any], list[Any], Any], dict[int, Any]]:
    """A function of the rows of the workspace, those of the inputs, and the constants.

    Args:
        kernel: what to work out.
        xp: numpy or jax.numpy.
        while_loop: does rounds: (needed, carried, a_round, most) -> carried and whether any needs more.

    Returns:
        The function, which returns row of the workspace -> new value.
    """
    order = sorted(
        reachable([store.value for store in kernel.stores]), key=lambda node: node.number
    )

    def work_out(nodes: list[Traced], values: dict[Traced, Any], inputs: dict[str, Any]) -> None:
        for node in nodes:
            if node not in values:
                values[node] = operate(node, values, inputs)

    def operate(node: Traced, values: dict[Traced, Any], inputs: dict[str, Any]) -> Any:
        match node.op:
            case "constant":
                return bool(node.extra) if node.truth else node.extra
            case "load" | "scalar":
                array, place = node.extra
                return inputs[array][place]
            case "loop":
                return rounds(node, values, inputs)
            case "result":
                return values[node.args[0]][node.extra]
        args = [values[arg] for arg in node.args]
        match node.op:
            case "select":
                return xp.where(*args)
            case "compare":
                return COMPARISONS[node.extra](*args)
            case "sqrt":
                return xp.sqrt(args[0])
            case "abs":
                return xp.abs(args[0])
            case "round":
                return xp.rint(args[0])
            case "power_of_two":
                return 2.0 ** args[0]
            case "not" if args[0] is True or args[0] is False:
                return not args[0]
        return OPERATIONS[node.op](*args)

    def rounds(node: Traced, values: dict[Traced, Any], inputs: dict[str, Any]) -> Any:
        loop, most = node.extra
        needed, *begin = [values[arg] for arg in node.args]
        inside = reachable([*loop.results, loop.again]) - set(values) - set(loop.carried)
        nodes = sorted(inside, key=lambda one: one.number)

        def a_round(carried: Any) -> Any:
            local = values | dict(zip(loop.carried, carried, strict=True))
            work_out(nodes, local, inputs)
            return [local[result] for result in loop.results], local[loop.again]

        return while_loop(needed, begin, a_round, most)

    def function(lanes: list[Any], inputs: list[Any], constants: Any) -> dict[int, Any]:
        arrays = {"lanes": lanes, "inputs": inputs, "constants": constants}
        values: dict[Traced, Any] = {}
        work_out(order, values, arrays)
        return {store.row: values[store.value] for store in kernel.stores}

    return function


def numpy_while_loop(needed: Any, carried: Any, a_round: Any, most: int) -> Any:
    """Rounds on plain arrays."""
    again = needed
    for _ in range(most):
        if not np.any(again):
            break
        carried, again = a_round(carried)
    return [*carried, again]


def flops(kernel: Kernel) -> int:
    """Additions and multiplications of a step in one lane; those of a loop count once."""
    nodes = reachable([store.value for store in kernel.stores])
    loops = [node.extra[0] for node in nodes if node.op == "loop" and node.extra[1] > 1]
    inside = {node for loop in loops for node in reachable([*loop.results, loop.again])}
    return sum(node.op in {"add", "sub", "mul"} for node in nodes | inside)
