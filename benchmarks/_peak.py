"""What the machine's floating-point units do at most."""

from __future__ import annotations

import time
from typing import Any

from numba import njit

from icreckon.estimator.engine.constants import aligned
from icreckon.estimator.tracing.jit_kernel import jit
from icreckon.estimator.tracing.kernel import Kernel, Store, call_kernel
from icreckon.estimator.tracing.machine_code import compiled_library
from icreckon.estimator.tracing.trace import lane_input, start

# Chains of multiply-adds that do not wait for each other, and the length of each.
CHAINS, LENGTH = 24, 40


def peak_flops(width: int, repeat: int = 20) -> float:
    """Additions and multiplications per CPU second on one core, in vectors of so many numbers."""
    start()
    values = [lane_input("lanes", chain) for chain in range(CHAINS)]
    for _ in range(LENGTH):
        values = [
            value * other + value
            for value, other in zip(values, values[1:] + values[:1], strict=True)
        ]
    stores = [Store("lanes", chain, value) for chain, value in enumerate(values)]
    peak = Kernel("peak", (CHAINS, 0, 0), stores)
    library = compiled_library(peak, f"peak.{width}", width)
    kernel, call = library.get_pointer_to_function(library.name), jit(call_kernel)

    @njit
    def many(lanes: Any, count: int) -> None:
        for _ in range(count):
            call(kernel, lanes, lanes, lanes)

    lanes = aligned(CHAINS * width)
    lanes[:] = 1e-3
    many(lanes, 1)
    best, count = 0.0, 2000
    for _ in range(repeat):
        begin = time.process_time()
        many(lanes, count)
        best = max(best, 2.0 * CHAINS * LENGTH * width * count / (time.process_time() - begin))
    return best
