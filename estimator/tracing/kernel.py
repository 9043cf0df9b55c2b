"""Kernel in numbers: what it stores and returns."""

from collections.abc import Sequence
from typing import Any, NamedTuple

# Arrays of every kernel: workspace of the lanes, inputs of a step, and constants of all lanes.
ARRAYS = ("lanes", "inputs", "constants")
FLAG_BITS = 16


class Store(NamedTuple):
    """Output of a kernel: a traced number, and the row that it is written to."""

    array: str
    row: int
    value: Any


class Kernel(NamedTuple):
    """Kernel in traced numbers."""

    name: str  # name of the kernel
    # number of rows of each of `ARRAYS`; number of constants, which all lanes share
    rows: tuple[int, int, int]
    stores: Sequence[Store]  # outputs of the kernel
    # truth values that the kernel returns, `FLAG_BITS` for each: bit k is that of lane k
    flags: Sequence[Any] = ()
    # changes of the filter that it reports, see `icreckon.estimator.filter.changes`
    events: Sequence[Any] = ()


def call_kernel(kernel: Any, lanes: Any, inputs: Any, constants: Any) -> int:
    """Call a kernel with its `ARRAYS`, and return its flags.

    It is a function of these; in compiled code the address of its machine code.
    """
    flags: int = kernel(lanes, inputs, constants)
    return flags
