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
    rows: tuple[int, int, int]  # numbers of rows of lanes and inputs, and of shared constants
    stores: Sequence[Store]  # outputs of the kernel
    flags: Sequence[Any] = ()  # truth values it returns, `FLAG_BITS` each: bit k is of lane k
    events: Sequence[Any] = ()  # changes that it reports, see `filter.changes`


def call_kernel(kernel: Any, lanes: Any, inputs: Any, constants: Any) -> int:
    """Call a kernel (or its address, in compiled code); return its flags."""
    flags: int = kernel(lanes, inputs, constants)
    return flags
