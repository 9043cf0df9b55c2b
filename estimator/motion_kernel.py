"""The motion models for compiled code: which one it is and its numbers, as plain arrays.

Another model can be compiled in by one more kind: its numbers in `numbers_of`, and its function in
`linearise`, which returns what `MotionModel.linearise` does, as tuples. Models that are none of these
kinds work, too; the filter then asks them in Python.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from estimator.frames import Floats
from estimator.friction_map import Table
from estimator.friction_motion import FrictionMotion
from estimator.friction_motion import linearise as linearise_friction
from estimator.kinematics import IndexValues
from estimator.motion import InertiaMotion
from estimator.motion import linearise as linearise_inertia
from estimator.motion_model import MotionModel, VehicleConstants

INERTIA, FRICTION = range(2)
NO_TABLE: Floats = np.zeros((0, 48))


class ModelNumbers(NamedTuple):
    """A motion model as numbers.

    Attributes:
        kind: which one it is.
        constants: (k,) L, M, x_CM, y_CM, and those of its kind.
        table: (n, 48) of the friction map.
    """

    kind: int
    constants: Floats
    table: Floats


def numbers_of(model: MotionModel) -> ModelNumbers | None:
    """The numbers of a model, None for one that is not compiled."""
    match model:
        case InertiaMotion(vehicle, form, slip_in_inertia):
            options = float(form == "literal"), float(slip_in_inertia)
            return ModelNumbers(INERTIA, np.array([*vehicle, *options]), NO_TABLE)
        case FrictionMotion(vehicle, found):
            table, reference = found.table, found.reference
            constants = np.array([*vehicle, table.cells_per_s, *reference])
            return ModelNumbers(FRICTION, constants, table.coefficients)
    return None


def linearise(
    kind: int,
    constants: Floats,
    table: Floats,
    memory: Floats,  # noqa: ARG001 - no kind remembers
    V_l: float,
    V_r: float,
    parameters: Any,
    slip: Any,
) -> Any:
    """See `MotionModel.linearise`."""
    vehicle = VehicleConstants(constants[0], constants[1], constants[2], constants[3])
    if kind == INERTIA:
        is_literal, slip_in_inertia = constants[4] != 0.0, constants[5] != 0.0
        return linearise_inertia(V_l, V_r, parameters, slip, vehicle, is_literal, slip_in_inertia)
    reference = IndexValues(constants[5], constants[6], constants[7])
    numbers = Table(table, constants[4])
    return linearise_friction(V_l, V_r, parameters, slip, vehicle, numbers, reference)
