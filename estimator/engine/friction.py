"""Step of the friction motion model in the workspace of lanes.

The memory of index models is advanced by `icreckon.estimator.engine.model.advanced_memory`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.engine.lane import FilterShape, Lane
from icreckon.estimator.engine.layout import Layout
from icreckon.estimator.friction.kernel import SubstepPlaces, friction_steps
from icreckon.estimator.friction.layout import (
    BODY_CONSTANTS,
    CARRIED,
    INPUTS,
    PARAMETERS,
    STARTED,
    SUBSTEP_CONSTANTS,
)
from icreckon.estimator.friction.loads import PAIR_COLUMNS
from icreckon.estimator.friction.step import FrictionRows, substep
from icreckon.estimator.motion.motion_model import gravity_in, track_factors
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.emit import Kernel, kernel_on_demand
from icreckon.estimator.tracing.jit_kernel import inner, jit


def motion_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of a substep of the motion model, see `MotionModel.begin_step`."""
    lane = Lane(shape)
    constants = {one: lane.constant(one) for one in (*SUBSTEP_CONSTANTS, *BODY_CONSTANTS)}
    memory = [lane.row(f"memory{k}") for k in range(shape.model.memory)]
    before = FrictionRows(memory, [lane.row(one) for one in CARRIED])
    (of_left, of_right), first = track_factors(lane.x), s.PARAMETERS.start
    of_gravity = range(PARAMETERS, INPUTS) if s.GRAVITY_X in lane.layout.states else ()
    after = substep(
        before,
        [*(lane.x[first + k] for k in range(PARAMETERS)), *gravity_in(lane.x)],
        (of_left * lane.input("mean_left"), of_right * lane.input("mean_right")),
        constants,
        trace.Table("constants", len(lane.layout.constants), PAIR_COLUMNS, constants["pairs"]),
        sheared=shape.model.sheared,
        estimated=[*(i - first for i in lane.layout.parameters), *of_gravity],
    )
    lane.stores.update({f"memory{k}": value for k, value in enumerate(after.memory)})
    lane.stores.update(zip(CARRIED, after.carried, strict=True))
    return lane.kernel(name)


def motion_steps(shape: FilterShape, width: int, shape_digest: str) -> Any:
    """Compile the function that advances the motion models of all lanes by a step.

    Args:
        shape: shape of the filters.
        width: number of lanes.
        shape_digest: digest of both.
    """
    if shape.model.kind != "friction":
        return jit(advance_nothing)
    make = partial(motion_kernel, "motion", shape)
    kernel = kernel_on_demand("motion", make, width, shape.bits)
    return friction_steps(kernel, substep_places(shape.layout), inner(shape_digest))


def advance_nothing(lanes: Floats, inputs: Floats, constants: Floats, dt: float) -> None:
    """Advance motion models without memory by a step, which does not change them."""


def substep_places(layout: Layout) -> SubstepPlaces:
    """Places that the loop over substeps reads and writes itself."""
    places = layout.constants
    of_substep = (places[name] for name in SUBSTEP_CONSTANTS)
    started, pairs = layout.rows[f"memory{STARTED}"], places["pairs"]
    return SubstepPlaces(started, places["load_lag"], pairs, len(places), *of_substep)
