"""Compiled steps of friction models: of many in lanes, and of one.

Import it inside functions only, or from other kernels: numba takes half a second to load.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.sizes import WRONG_SIZE
from icreckon.estimator.friction.layout import (
    BODY_CONSTANTS,
    CARRIED,
    INPUTS,
    MEMORY,
    STARTED,
    SUBSTEP_CONSTANTS,
)
from icreckon.estimator.friction.loads import PAIR_COLUMNS
from icreckon.estimator.friction.step import FrictionRows, substep
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.emit import Kernel, Store, kernel_on_demand
from icreckon.estimator.tracing.jit_kernel import entry

# Longest substep [s].
LONGEST_SUBSTEP = 0.0101
# Time after which earlier motion has no effect [s]: a longer step counts as one of this length, and so
# does the first, before which the vehicle has been moving at its track speeds.
SETTLING = 2.0
# Indices of turns are averaged over this time [s].
AVERAGING = 0.5
# Rows, inputs and constants of one model alone.
ONE_ROWS = MEMORY + len(CARRIED) + INPUTS
ONE_CONSTANTS = (*SUBSTEP_CONSTANTS, *BODY_CONSTANTS)


class SubstepPlaces(NamedTuple):
    """Places that the loop over substeps reads and writes itself.

    Attributes:
        started: row of the flag for the first step.
        load_lag: place of the load lag T among the constants.
        pairs: place of the number of pairs of contact points, which follow behind all constants.
        constant_count: number of constants, without these points.
        h: places of `layout.SUBSTEP_CONSTANTS`, as are the others.
        keep: as `h`.
        is_first: as `h`.
        turn_share: as `h`.
    """

    started: int
    load_lag: int
    pairs: int
    constant_count: int
    h: int
    keep: int
    is_first: int
    turn_share: int


def friction_steps(
    kernel: Any, places: SubstepPlaces, compiler: Callable[[Callable[..., Any]], Any]
) -> Any:
    """Compile the loop over the substeps of a step of all lanes.

    Args:
        kernel: kernel of a substep.
        places: places in its arrays.
        compiler: one of `icreckon.estimator.tracing.jit_kernel`, with a digest of the kernel.
    """
    started, load_lag, pairs, constant_count, place_of_h, keep, is_first, turn_share = places

    def integrate_friction(lanes: Floats, inputs: Floats, constants: Floats, dt: float) -> None:
        """Integrate a step of all lanes at constant track speeds.

        The first step begins at rest and takes `SETTLING` seconds; all lanes make it together.

        Raises:
            ValueError: there are not as many contact points as the constants say.
        """
        if len(constants) != constant_count + PAIR_COLUMNS * constants[pairs]:
            raise ValueError(WRONG_SIZE)
        if lanes[started, 0] == 0.0 or dt > SETTLING:
            dt = SETTLING
        substeps = int(max(1.0, np.ceil(dt / LONGEST_SUBSTEP)))
        h = dt / substeps
        constants[place_of_h], constants[keep] = h, np.exp(-h / constants[load_lag])
        for k in range(substeps):
            constants[is_first] = 1.0 if k == 0 else 0.0
            is_last = k == substeps - 1
            constants[turn_share] = 1.0 - np.exp(-dt / AVERAGING) if is_last else 0.0
            kernel(lanes, inputs, constants)

    return compiler(integrate_friction)


class OneModel:
    """Arrays that the compiled step of one friction model works on.

    Args:
        constants: values of `layout.BODY_CONSTANTS`.
        pairs: pairs of contact points (k, `PAIR_COLUMNS`).
        sheared: friction builds up with the shear displacement.
    """

    def __init__(self, constants: Mapping[str, float], pairs: Floats, *, sheared: bool) -> None:
        self._sheared = sheared
        self._lane, self._inputs = np.zeros((ONE_ROWS, 1)), np.zeros((2, 1))
        of_body = [constants[name] for name in BODY_CONSTANTS]
        self._constants = np.array([0.0] * len(SUBSTEP_CONSTANTS) + of_body + list(pairs.ravel()))

    def step(
        self, memory: Floats, inputs: Sequence[float], speeds: tuple[float, float], dt: float
    ) -> Floats:
        """Return the memory (MEMORY,) after a step.

        Args:
            memory: the memory before.
            inputs: (INPUTS,) present estimate of parameters and gravity.
            speeds: speeds of the left and the right track [m/s].
            dt: length of the step [s].
        """
        lane, of_speeds = self._lane, self._inputs
        lane[:MEMORY, 0], lane[-INPUTS:, 0] = memory, inputs
        of_speeds[0, 0], of_speeds[1, 0] = speeds
        _one_step(self._sheared)(lane, of_speeds, self._constants, dt)
        return lane[:MEMORY, 0].copy()


@cache
def _one_step(sheared: bool) -> Any:
    """Compile the step of one model."""
    name = "sheared_friction" if sheared else "friction"
    kernel = kernel_on_demand(name, partial(_one_kernel, name, sheared=sheared), 1)
    places = {name: place for place, name in enumerate(ONE_CONSTANTS)}
    substeps = [places[name] for name in SUBSTEP_CONSTANTS]

    def compiler(function: Callable[..., Any]) -> Any:
        return entry(function, name)

    of_loop = SubstepPlaces(
        STARTED, places["load_lag"], places["pairs"], len(ONE_CONSTANTS), *substeps
    )
    return friction_steps(kernel, of_loop, compiler)


def _one_kernel(name: str, *, sheared: bool) -> Kernel:
    trace.start()
    rows = [trace.lane_input("lanes", row) for row in range(ONE_ROWS)]
    constants = {
        name: trace.uniform_input("constants", place) for place, name in enumerate(ONE_CONSTANTS)
    }
    pairs = trace.Table("constants", len(ONE_CONSTANTS), PAIR_COLUMNS, constants["pairs"])
    before = FrictionRows(rows[:MEMORY], rows[MEMORY:-INPUTS])
    speeds = trace.lane_input("inputs", 0), trace.lane_input("inputs", 1)
    after = substep(before, rows[-INPUTS:], speeds, constants, pairs, sheared=sheared)
    changed = zip(rows, (*after.memory, *after.carried), strict=False)
    stores = [
        Store("lanes", row, trace.lift(value))
        for row, (old, value) in enumerate(changed)
        if value is not old
    ]
    return Kernel(name, (ONE_ROWS, 2, len(ONE_CONSTANTS)), stores)
