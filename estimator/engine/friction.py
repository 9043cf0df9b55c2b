"""Substep of the friction model in the workspace of lanes."""

from __future__ import annotations

from icreckon.estimator.base import state as s
from icreckon.estimator.engine.lane import FilterShape, Lane
from icreckon.estimator.engine.layout import Layout
from icreckon.estimator.friction.kernel import SubstepPlaces
from icreckon.estimator.friction.layout import (
    BODY_CONSTANTS,
    CARRIED,
    PARAMETERS,
    STARTED,
    SUBSTEP_CONSTANTS,
)
from icreckon.estimator.friction.loads import PAIR_COLUMNS
from icreckon.estimator.friction.step import FrictionRows, substep
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.emit import Kernel


def motion_kernel(name: str, shape: FilterShape) -> Kernel:
    """Make the kernel of a substep of the motion model, see `MotionModel.begin_step`."""
    lane = Lane(shape)
    constants = {one: lane.constant(one) for one in (*SUBSTEP_CONSTANTS, *BODY_CONSTANTS)}
    memory = [lane.row(f"memory{k}") for k in range(shape.model.memory)]
    before = FrictionRows(memory, [lane.row(one) for one in CARRIED])
    scale, first = 1.0 + lane.x[s.TRACK_SCALE], s.PARAMETERS.start
    after = substep(
        before,
        [lane.x[first + k] for k in range(PARAMETERS)],
        (scale * lane.input("mean_left"), scale * lane.input("mean_right")),
        constants,
        trace.Table("constants", len(lane.layout.constants), PAIR_COLUMNS, constants["pairs"]),
        sheared=shape.model.sheared,
        estimated=[i - first for i in lane.layout.parameters],
    )
    lane.stores.update({f"memory{k}": value for k, value in enumerate(after.memory)})
    lane.stores.update(zip(CARRIED, after.carried, strict=True))
    return lane.kernel(name)


def substep_places(layout: Layout) -> SubstepPlaces:
    """Places that the loop over substeps reads and writes itself."""
    places = layout.constants
    of_substep = (places[name] for name in SUBSTEP_CONSTANTS)
    return SubstepPlaces(layout.rows[f"memory{STARTED}"], places["load_lag"], *of_substep)
