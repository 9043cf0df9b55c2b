"""The motion models for compiled code: which one it is and its numbers, as plain arrays.

Another model can be compiled in by one more kind: its numbers in `numbers_of`, and its functions in
`linearise` and `steering_efficiency`, which return what those of `MotionModel` do. Models that are none
of these kinds work, too; the filter then asks them in Python.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.bounds import ETA0
from icreckon.estimator.motion.friction_layout import MEMORY
from icreckon.estimator.motion.friction_model import FrictionMotion
from icreckon.estimator.motion.friction_model import linearise as linearise_friction
from icreckon.estimator.motion.index_model import InertiaMotion
from icreckon.estimator.motion.index_model import linearise as linearise_inertia
from icreckon.estimator.motion.motion_model import MotionModel, VehicleConstants

INERTIA, FRICTION = range(2)


class ModelNumbers(NamedTuple):
    """A motion model as numbers.

    Attributes:
        kind: which one it is.
        constants: (k,) L, M, x_CM, y_CM, and those of its kind.
        bounds: (n, 9) of the parameters.
    """

    kind: int
    constants: Floats
    bounds: Floats


def numbers_of(model: MotionModel) -> ModelNumbers | None:
    """The numbers of a model, None for one that is not compiled."""
    match model:
        case InertiaMotion(vehicle, form, slip_in_inertia):
            options = float(form == "literal"), float(slip_in_inertia)
            return ModelNumbers(INERTIA, np.array([*vehicle, *options]), model.bounds)
        case FrictionMotion():
            return ModelNumbers(FRICTION, np.array([*model.vehicle, model.eta]), model.bounds)
    return None


def fits_model(kind: int, constants: Floats, bounds: Floats, memory: Floats) -> bool:
    """Compare the sizes of a model's arrays with what its kind needs."""
    if len(bounds) and bounds.shape[1] != 9:
        return False
    if kind == INERTIA:
        return len(constants) == 6
    return len(constants) == 5 and len(memory) == MEMORY


def linearise(
    kind: int,
    constants: Floats,
    memory: Floats,
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
    return linearise_friction(V_l, V_r, parameters, slip, vehicle, memory)


def steering_efficiency(kind: int, constants: Floats, parameters: Floats) -> Any:
    """See `MotionModel.steering_efficiency`."""
    if kind == INERTIA:
        return parameters[ETA0]
    return constants[4]
